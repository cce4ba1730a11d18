"""What messages say of exceptions that a user's code raised: type, text, file and line."""

import importlib.util
import sys

import pytest

from angler_mjx.errors import ConfigError, UnsupportedError, describe_error, report_user_errors

FILES = {
    "planner.py": """import numpy as np
import aside


def by_itself():
    return {}["start"]


def in_a_library():
    return np.linalg.inv(np.zeros((2, 2)))


def beside():
    return aside.depth(0)


def silent():
    raise ValueError


def long():
    raise ValueError("far\\n " * 1000)
""",
    "aside.py": """def depth(metres):
    return 1 / metres
""",
}
"""A user's file, and one that it imports."""


@pytest.fixture
def planner(tmp_path, monkeypatch):
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "aside", raising=False)
    spec = importlib.util.spec_from_file_location("planner_of_a_test", tmp_path / "planner.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("function", "words"),
    [
        ("by_itself", "KeyError: 'start' (planner.py:6)"),
        ("in_a_library", "LinAlgError: Singular matrix (planner.py:10)"),
        ("beside", "ZeroDivisionError: division by zero (aside.py:2)"),
        ("silent", "ValueError (planner.py:18)"),
    ],
)
def test_the_innermost_line_in_a_users_file_is_named(planner, function, words):
    with pytest.raises(Exception) as caught:
        getattr(planner, function)()
    assert describe_error(caught.value) == words


def test_a_text_without_end_is_cut_before_the_line(planner):
    with pytest.raises(ValueError, match="far") as caught:
        planner.long()
    said = describe_error(caught.value, max_characters=20)
    assert said == "ValueError: far far far far far (planner.py:22)"


def test_what_angler_itself_raises_passes_through(planner):
    with pytest.raises(UnsupportedError, match="no such extra"), report_user_errors("planner X"):
        raise UnsupportedError("no such extra")
    with (
        pytest.raises(ConfigError, match=r"^planner X: plan_batch raised KeyError: .*py:6\)$"),
        report_user_errors("planner X: plan_batch"),
    ):
        planner.by_itself()
