"""Three robots and a terminal for the tests of this folder."""

import contextlib

import pytest

from .by_hand import robot_info
from .terminals import Terminal


@pytest.fixture
def robots():
    """Three of a kind."""
    return [robot_info(i) for i in range(3)]


@pytest.fixture
def start():
    """Starts programs on terminals of their own, and clears them away."""
    with contextlib.ExitStack() as stack:

        def begin(program):
            terminal = Terminal(program)
            stack.callback(terminal.close)
            return terminal

        yield begin
