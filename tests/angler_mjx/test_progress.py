"""Progress: silent by default, and shown by one bar."""

import re

import pytest

from angler_mjx import progress
from angler_mjx.cli.shared.progress import ProgressBar
from angler_mjx.progress import Progress


def work(receiver):
    receiver.describe("compiling")
    receiver.report("compiled in 1.0 s [not markup]")
    receiver.start(4, 1, "flights")
    receiver.advance(0.5, 1000)
    receiver.advance(1.5, 1000)


def test_progress_is_silent_unless_it_is_overridden(capsys):
    work(Progress())
    assert capsys.readouterr() == ("", "")


def test_the_bar_shows_steps_lines_and_amounts_on_stderr(capsys):
    with ProgressBar() as bar:
        work(bar)
    shown = capsys.readouterr()
    assert shown.out == ""
    assert "compiling" in shown.err
    assert "compiled in 1.0 s [not markup]" in shown.err
    assert re.search(r"3/4\s+flights", shown.err)


def test_a_quiet_bar_shows_nothing(capsys):
    with ProgressBar(quiet=True) as bar:
        work(bar)
    assert capsys.readouterr() == ("", "")


def test_the_name_of_0_1_is_read():
    with pytest.warns(DeprecationWarning, match="Progress"):
        assert progress.SilentProgress is Progress
