"""Signals that request the end: the current step is finished before anything closes."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class StopRequest:
    """Request to stop, set by a signal; the current step is still finished."""

    def __init__(self) -> None:
        """Create a request that is not set."""
        self.requested = False
        self.closing = False
        """Whether the recording is being saved, which no signal interrupts."""

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal; a second one interrupts a step that does not end."""
        if self.requested and not self.closing:
            signal.default_int_handler(number, frame)
        self.requested = True


@contextmanager
def stop_on_signal() -> Iterator[StopRequest]:
    """Turn Ctrl-C, SIGTERM and a lost terminal (SIGHUP) into a request to stop."""
    stop = StopRequest()
    with _install_handler(stop):
        yield stop


class BreakRequest:
    """Interruption of the current work, by KeyboardInterrupt."""

    def __init__(self) -> None:
        """Create a request that is not set."""
        self._requested = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal."""
        self._requested = True
        signal.default_int_handler(number, frame)

    def check(self) -> None:
        """Raise the interruption again: a library's callback may have swallowed it."""
        if self._requested:
            raise KeyboardInterrupt


@contextmanager
def break_on_signal() -> Iterator[BreakRequest]:
    """Interrupt the current work on all three signals, so that its output is removed."""
    interrupt = BreakRequest()
    with _install_handler(interrupt):
        yield interrupt


@contextmanager
def _install_handler(handler: Callable[[int, FrameType | None], object]) -> Iterator[None]:
    before = {number: signal.signal(number, handler) for number in _SIGNALS}
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)
