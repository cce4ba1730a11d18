"""Signals that ask for the end: the step that is being made is finished before anything closes."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class StopRequest:
    """Whether a signal asked for the end: then the step that is being made is still finished."""

    def __init__(self) -> None:
        """Nobody did."""
        self.requested = False
        self.closing = False
        """Whether what was driven is being put away, which nothing breaks off."""

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Take a signal; a second one breaks off a step that does not end."""
        if self.requested and not self.closing:
            signal.default_int_handler(number, frame)
        self.requested = True


@contextmanager
def stop_on_signal() -> Iterator[StopRequest]:
    """Ctrl-C, SIGTERM and a lost terminal (SIGHUP) ask for the end instead of breaking off."""
    stop = StopRequest()
    with _install_handler(stop):
        yield stop


class BreakRequest:
    """Breaks off what is being done, by KeyboardInterrupt."""

    def __init__(self) -> None:
        """Nobody asked for it."""
        self._requested = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Take a signal."""
        self._requested = True
        signal.default_int_handler(number, frame)

    def check(self) -> None:
        """Raise it again: one that falls into a callback of a library is swallowed there."""
        if self._requested:
            raise KeyboardInterrupt


@contextmanager
def break_on_signal() -> Iterator[BreakRequest]:
    """All three break off what is being done, so that what was begun is taken away."""
    interrupt = BreakRequest()
    with _install_handler(interrupt):
        yield interrupt


@contextmanager
def _install_handler(handler: Callable[[int, FrameType | None], Any]) -> Iterator[None]:
    before = {number: signal.signal(number, handler) for number in _SIGNALS}
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)
