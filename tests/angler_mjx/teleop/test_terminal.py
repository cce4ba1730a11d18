"""A real terminal, by a pseudo-terminal: keys come through, and it is given back as it was."""

import signal
import termios

import pytest

from angler_mjx.teleop.terminal import parse_keys

from .terminals import assert_given_back

PROGRAM = """
import time
from angler_mjx.teleop.signals import stop_on_signal
from angler_mjx.teleop.terminal import Keyboard, Screen

with stop_on_signal() as stop, Screen() as screen, Keyboard() as keyboard:
    screen.paint(["ready"])
    seen = []
    while not stop.requested:
        seen += keyboard.read(0.0)
        screen.paint(["keys " + " ".join(map(repr, seen))])
        if "!" in seen:
            raise ValueError("on purpose")
        if "Q" in seen or "\\x03" in seen:
            break
        time.sleep(0.005)
"""


def test_keys_come_one_by_one_without_enter(start):
    terminal = start(PROGRAM)
    terminal.wait_for("ready")
    attributes = termios.tcgetattr(terminal.slave)
    assert not attributes[3] & (termios.ICANON | termios.ECHO)
    # Ctrl-Z, Ctrl-S and Ctrl-backslash are keys; an arrow key is one key, and so is an umlaut.
    terminal.type("i\t\x1a\x13\x1c\x1b[Aü")
    terminal.wait_for(r"keys 'i' '\t' '\x1a' '\x13' '\x1c' '\x1b' 'ü'")
    terminal.type("Q")
    assert terminal.end() == 0
    assert_given_back(terminal)


ENDS = {
    "ctrl-c": ("\x03", None, 0),
    "exception": ("!", None, 1),
    "sigterm": ("", signal.SIGTERM, 0),
    "sighup": ("", signal.SIGHUP, 0),
}


@pytest.mark.parametrize("end", ENDS)
def test_the_terminal_is_given_back_whatever_ends_the_program(start, end):
    key, number, code = ENDS[end]
    terminal = start(PROGRAM)
    terminal.wait_for("ready")
    if number is None:
        terminal.type(key)
    else:
        terminal.process.send_signal(number)
    assert terminal.end() == code
    assert_given_back(terminal)


def test_keys_of_several_characters_are_one():
    assert parse_keys("") == []
    assert parse_keys("iQ\t") == ["i", "Q", "\t"]
    # Up, F5, Ctrl-right, Alt-i, Escape alone, Escape twice.
    for sent in ("\x1bOA", "\x1b[15~", "\x1b[1;5C", "\x1bi", "\x1b"):
        assert parse_keys(f"k{sent}") == ["k", "\x1b"]
    assert parse_keys("\x1b\x1b") == ["\x1b", "\x1b"]
