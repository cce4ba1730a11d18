"""Programs compiled side by side: while XLA works on one, Python writes down the next.

XLA compiles without Python's lock, so a thread each is enough. What is compiled is what would be
compiled one after the other.
"""

import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self


@dataclass(frozen=True, kw_only=True)
class CompileTime:
    """Seconds from Python to machine code."""

    prepare_s: float = 0.0
    """Of one function, while others may have been compiled beside it; so are the next two."""
    reset_s: float = 0.0
    segment_s: float = 0.0
    total_s: float = 0.0
    """Of all of them, by the clock on the wall: less than their sum."""


@dataclass(frozen=True, kw_only=True)
class Program:
    """A program in the making."""

    written_s: float
    """What it took to trace and to write it down."""
    made: Future[tuple[Any, float]]

    def result(self) -> tuple[Any, float]:
        """The compiled function, and the seconds that it took from Python to machine code."""
        executable, compile_s = self.made.result()
        return executable, self.written_s + compile_s


class Together:
    """Compiles what is given to it, each in a thread of its own; leaving it waits for all."""

    def __init__(self, most: int) -> None:
        """With threads for ``most`` programs."""
        self._threads = ThreadPoolExecutor(most, thread_name_prefix="compile")

    def __enter__(self) -> Self:
        """Take programs from now on."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Wait; what has not begun is left out if something failed."""
        self._threads.shutdown(cancel_futures=error is not None)

    def begin(self, function: Any, *example: Any) -> Program:
        """Trace a jitted function for arguments of these shapes, and begin to compile it."""
        start = time.perf_counter()
        lowered = function.lower(*example)
        written_s = time.perf_counter() - start
        return Program(written_s=written_s, made=self._threads.submit(_timed, lowered))


def _timed(lowered: Any) -> tuple[Any, float]:
    start = time.perf_counter()
    executable = lowered.compile()
    return executable, time.perf_counter() - start
