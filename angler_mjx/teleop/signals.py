"""Signals that ask for the end: the step that is being made is finished before anything closes."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Stop:
    """Whether a signal asked for the end: then the step that is being made is still finished."""

    def __init__(self) -> None:
        """Nobody did."""
        self.asked = False
        self.closing = False
        """Whether what was driven is being put away, which nothing breaks off."""

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Take a signal; a second one breaks off a step that does not end."""
        if self.asked and not self.closing:
            signal.default_int_handler(number, frame)
        self.asked = True


@contextmanager
def stoppable() -> Iterator[Stop]:
    """Ctrl-C, SIGTERM and a lost terminal (SIGHUP) ask for the end instead of breaking off."""
    stop = Stop()
    with _handled(stop):
        yield stop


class Break:
    """Breaks off what is being done, by KeyboardInterrupt."""

    def __init__(self) -> None:
        """Nobody asked for it."""
        self._asked = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Take a signal."""
        self._asked = True
        signal.default_int_handler(number, frame)

    def check(self) -> None:
        """Raise it again: one that falls into a callback of a library is swallowed there."""
        if self._asked:
            raise KeyboardInterrupt


@contextmanager
def breakable() -> Iterator[Break]:
    """All three break off what is being done, so that what was begun is taken away."""
    interrupt = Break()
    with _handled(interrupt):
        yield interrupt


@contextmanager
def _handled(handler: Callable[[int, FrameType | None], Any]) -> Iterator[None]:
    before = {number: signal.signal(number, handler) for number in _SIGNALS}
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)
