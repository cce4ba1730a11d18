"""The Python examples of docs do what they show."""

import doctest
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


@pytest.mark.parametrize(
    ("page", "examples"),
    [
        ("docs/tutorials/first_run.md", 9),
        pytest.param(
            "docs/tutorials/own_policy.md", 9, marks=pytest.mark.nightly(by="sim/test_policy.py")
        ),
    ],
)
def test_the_python_examples(page, examples, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = doctest.testfile(str(ROOT / page), module_relative=False, encoding="utf-8")
    assert result.attempted >= examples
    assert result.failed == 0
