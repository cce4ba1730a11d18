"""Programs compiled side by side: while XLA works on one, Python writes down the next.

XLA compiles without Python's lock, so a thread each is enough. What is compiled is what would be
compiled one after the other.
"""

import gc
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

import jax

NO_AUTOTUNING = {"xla_gpu_autotune_level": 0}
"""For all programs: XLA's search for a faster form of its kernels takes a GPU long, and what it
finds is no faster. Drawing and planning (8 robots, 1,024 worlds on an H200) took 291 s instead of
14 s, a segment of a delivery on an H100 22 s instead of 18 s."""


class CompiledFunction:
    """A function compiled as a program of its own, or traced as a part of another program.

    JAX accepts compiler options for a whole program only and refuses a jitted function with options
    inside another trace. Calls with traced arguments therefore use a jitted function without
    options; calls with arrays run at once, also while another function is traced.
    """

    def __init__(self, function: Callable[..., Any], **options: Any) -> None:
        """Jit a function twice; nothing is traced yet.

        Args:
            function: to compile.
            **options: of `jax.jit`, other than compiler options.
        """
        self._part = jax.jit(function, **options)
        self._whole: Any = jax.jit(function, compiler_options=NO_AUTOTUNING, **options)
        self._run: Callable[..., Any] = self._whole

    def __call__(self, *arguments: Any) -> Any:
        """Results of the function; tracers where an argument is one."""
        if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(arguments)):
            return self._part(*arguments)
        with jax.core.eval_context():
            return self._run(*arguments)

    def lower(self, *example: Any) -> Any:
        """Return the program for arguments of these shapes, to be compiled ahead of time."""
        return self._whole.lower(*example)

    def shape(self, *example: Any) -> Any:
        """Return shapes and types of the results; the trace is the one that `lower` uses."""
        return self._whole.eval_shape(*example)

    def keep(self, executable: Callable[..., Any]) -> None:
        """Run an executable, made of `lower`, in calls with arrays from now on."""
        self._run = executable


@dataclass(frozen=True, kw_only=True)
class CompileTime:
    """Seconds from Python to machine code."""

    prepare_s: float = 0.0
    """Of one function, while others may have been compiled beside it; so are the next two."""
    reset_s: float = 0.0
    segment_s: float = 0.0
    total_s: float = 0.0
    """Of all of them, by the clock on the wall: less than their sum."""

    def by_program(self) -> dict[str, float]:
        """Return the seconds of each program by its name, without the total."""
        return {"prepare": self.prepare_s, "reset": self.reset_s, "segment": self.segment_s}


@dataclass(frozen=True, kw_only=True)
class PendingProgram:
    """A program in the making."""

    lowering_s: float
    """What it took to trace and to write it down."""
    made: Future[tuple[Any, float]]

    def result(self) -> tuple[Any, float]:
        """The compiled function, and the seconds that it took from Python to machine code."""
        executable, compile_s = self.made.result()
        return executable, self.lowering_s + compile_s


class ParallelCompiler:
    """Compiles what is given to it, each in a thread of its own; leaving it waits for all."""

    def __init__(self, max_threads: int) -> None:
        """With threads for ``max_threads`` programs."""
        self._threads = ThreadPoolExecutor(max_threads, thread_name_prefix="compile")

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

    def begin(self, function: Any, *example: Any) -> PendingProgram:
        """Trace a jitted function for arguments of these shapes, and begin to compile it."""
        start = time.perf_counter()
        with _COLLECTION_PAUSE.paused():
            lowered = function.lower(*example)
        written_s = time.perf_counter() - start
        return PendingProgram(
            lowering_s=written_s, made=self._threads.submit(_compile_timed, lowered)
        )


class _CollectionPause:
    """Python's cyclic garbage collection, paused while any thread traces a program.

    A trace makes millions of objects that live until it ends; visiting them again and again took
    23 % of the time to trace and lower the programs of `reef_fleet` (15.7 s instead of 12.1).
    """

    def __init__(self) -> None:
        self._lock, self._inside, self._was_enabled = threading.Lock(), 0, False

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Pause until the last thread has left, then restore what the caller had set."""
        with self._lock:
            if self._inside == 0:
                self._was_enabled = gc.isenabled()
                gc.disable()
            self._inside += 1
        try:
            yield
        finally:
            with self._lock:
                self._inside -= 1
                if self._inside == 0 and self._was_enabled:
                    gc.enable()


_COLLECTION_PAUSE = _CollectionPause()


def _compile_timed(lowered: Any) -> tuple[Any, float]:
    start = time.perf_counter()
    executable = lowered.compile()
    return executable, time.perf_counter() - start
