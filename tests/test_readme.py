"""The README's Python example does what it shows."""

import doctest
from pathlib import Path


def test_the_python_example(tmp_path, monkeypatch):
    readme = Path(__file__).parent.parent / "README.md"
    monkeypatch.chdir(tmp_path)
    result = doctest.testfile(str(readme), module_relative=False, encoding="utf-8")
    assert result.attempted >= 9
    assert result.failed == 0
