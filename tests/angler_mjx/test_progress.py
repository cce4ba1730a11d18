"""Progress: silent by default, and shown by one bar or by lines."""

import os
import pty
import re
import sys

import pytest

from angler_mjx import progress
from angler_mjx.cli.shared.progress import ProgressBar
from angler_mjx.progress import Progress, ProgressLines


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


CONTROL = "\x1b["


def test_a_bar_in_a_pipe_prints_no_control_codes_even_if_colour_is_forced(capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    with ProgressBar() as bar:
        work(bar)
    shown = capsys.readouterr().err
    assert CONTROL not in shown
    assert shown.count("flights") == 1


@pytest.mark.parametrize("is_kernel", [False, True])
def test_a_bar_is_redrawn_on_a_terminal_but_not_in_a_cell_of_a_notebook(monkeypatch, is_kernel):
    monkeypatch.setenv("TERM", "xterm-color")
    monkeypatch.setenv("FORCE_COLOR", "1")
    if is_kernel:
        monkeypatch.setenv("JPY_PARENT_PID", "1")
    else:
        monkeypatch.delenv("JPY_PARENT_PID", raising=False)
    reader, writer = pty.openpty()
    with os.fdopen(writer, "w") as terminal:
        monkeypatch.setattr(sys, "stderr", terminal)
        with ProgressBar() as bar:
            work(bar)
        terminal.flush()
        shown = os.read(reader, 100_000).decode()
    os.close(reader)
    assert "compiled in 1.0 s" in shown
    assert (CONTROL in shown) != is_kernel


def test_lines_have_seconds_and_amounts_not_more_than_once_a_second(capsys, monkeypatch):
    now_s = [100.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now_s[0])
    lines = ProgressLines()
    now_s[0] = 102.5
    lines.describe("compiling")
    lines.start(4, 1, "flights")
    for after_s, amount in ((103.0, 0.5), (103.6, 0.5), (104.0, 1.0), (120.0, 0.5)):
        now_s[0] = after_s
        lines.advance(amount, 1000)
    lines.report("done [not markup]")
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.splitlines() == [
        "[   2.5 s] compiling",
        "[   3.6 s] 2 of 4 flights",
        "[  20.0 s] 3.5 of 4 flights",
        "[  20.0 s] done [not markup]",
    ]


def test_the_name_of_0_1_is_read():
    with pytest.warns(DeprecationWarning, match="Progress"):
        assert progress.SilentProgress is Progress
