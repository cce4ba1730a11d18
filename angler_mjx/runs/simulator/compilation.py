"""Parallel compilation of programs: while XLA compiles one, Python traces the next.

XLA compiles without Python's lock, so one thread per program is enough. The programs are those that
sequential compilation would give. A program that is stored is neither traced nor compiled.
"""

import gc
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from types import TracebackType
from typing import Any, Protocol, Self, cast

import jax
from jax.sharding import Sharding

from angler_kernels.cuda.nvrtc import CudaCompilerError
from angler_mjx.errors import RunError
from angler_mjx.runs.simulator.shared_pause import SharedPause
from angler_mjx.runs.simulator.stored_programs import (
    ProgramStore,
    StoredProgram,
    load_stored,
)

NO_AUTOTUNING = {"xla_gpu_autotune_level": 0}
"""Compiler option for all programs: XLA's search for a faster form of its kernels takes long on a
GPU, and its results are no faster. Sampling and planning (8 robots, 1,024 worlds on an H200) took
291 s instead of 14 s, a segment of a delivery on an H100 22 s instead of 18 s."""


class _Jitted[R](Protocol):
    """Jitted function, as JAX declares it too loosely."""

    def __call__(self, *arguments: object) -> R:
        """Return the results."""
        ...

    def lower(self, *example: object) -> jax.stages.Lowered:
        """Return the program for arguments of these shapes."""
        ...

    def eval_shape(self, *example: object) -> R:
        """Return shapes and types of the results."""
        ...


class CompiledFunction[R]:
    """Function compiled as a program of its own, or traced as a part of another program.

    JAX accepts compiler options for a whole program only and refuses a jitted function with options
    inside another trace. Calls with traced arguments therefore use a jitted function without
    options; calls with arrays run at once, also while another function is traced.
    """

    def __init__(
        self,
        function: Callable[..., R],
        *,
        out_shardings: Sharding | None = None,
        donate_argnums: int | None = None,
        name: str = "",
        store: ProgramStore | None = None,
    ) -> None:
        """Jit a function twice; it is traced later.

        Args:
            function: function to compile.
            out_shardings: sharding of the results.
            donate_argnums: number of the argument whose memory the results take.
            name: of the program within its store.
            store: executables that were compiled before; None to compile each time.
        """
        self._name, self._store = name, store
        # None would mean replicated results.
        options = {} if out_shardings is None else {"out_shardings": out_shardings}
        jit = partial(jax.jit, function, donate_argnums=donate_argnums, **options)
        whole: _Jitted[R] = jit(compiler_options=NO_AUTOTUNING)
        self._part: Callable[..., R] = jit()
        self._whole = whole
        self._run: Callable[..., R] = whole if store is None else self._run_first
        self.kept: jax.stages.Compiled | None = None
        """Executable of `keep`."""

    def __call__(self, *arguments: object) -> R:
        """Return the results of the function; tracers where an argument is one."""
        if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(arguments)):
            return self._part(*arguments)
        with jax.core.eval_context(), _reporting_kernels():
            return self._run(*arguments)

    def _run_first(self, *arguments: object) -> R:
        """Load or compile a program for the shapes of the first call; others are jitted."""
        stored = self.find(*arguments)
        executable, _ = (
            _compile_timed(self, _lower_timed(self, *arguments)[0], *arguments)
            if stored is None
            else _load_timed(self, stored, *arguments)
        )

        def run(*arguments: object) -> R:
            try:
                return cast("R", executable(*arguments))
            except (TypeError, ValueError):  # of other shapes, or elsewhere
                return self._whole(*arguments)

        self._run = run
        return run(*arguments)

    def lower(self, *example: object) -> jax.stages.Lowered:
        """Return the program for arguments of these shapes, to be compiled ahead of time.

        Raises:
            RunError: a kernel does not compile; names the kernels to use instead.
        """
        with _reporting_kernels():
            return self._whole.lower(*example)

    def shape(self, *example: object) -> R:
        """Return shapes and types of the results; the trace is the one that `lower` uses."""
        stored = self.find(*example)
        return self._whole.eval_shape(*example) if stored is None else cast("R", stored.result)

    def find(self, *example: object) -> StoredProgram | None:
        """Return the stored program for arguments of these shapes; None where there is none."""
        return None if self._store is None else self._store.find(self._name, example)

    def compile(self, lowered: jax.stages.Lowered, *example: object) -> jax.stages.Compiled:
        """Compile what `lower` returned for arguments of these shapes, and store it."""
        if self._store is None:
            return lowered.compile()
        return self._store.compile(self._name, lowered, example)

    def keep(self, executable: jax.stages.Compiled) -> None:
        """Use an executable, made of `lower`, in calls with arrays from now on."""
        self.kept = self._run = executable


@contextmanager
def _reporting_kernels() -> Iterator[None]:
    """Turn the error of a kernel that does not compile into one of users."""
    try:
        yield
    except CudaCompilerError as error:
        raise RunError(
            f'kernels = "cuda": {error}; or use kernels = "xla", which needs no such compiler'
        ) from error


@dataclass(frozen=True, kw_only=True)
class CompileTime:
    """Seconds from Python to machine code."""

    prepare_s: float = 0.0
    """Seconds of one function, while others may have been compiled in parallel; so are the next
    two."""
    reset_s: float = 0.0
    segment_s: float = 0.0
    total_s: float = 0.0
    """Wall-clock time of all functions: less than their sum."""

    def by_program(self) -> dict[str, float]:
        """Return the seconds of each program by its name, without the total."""
        return {"prepare": self.prepare_s, "reset": self.reset_s, "segment": self.segment_s}


@dataclass(frozen=True, kw_only=True)
class PendingProgram:
    """Program during compilation."""

    lowering_s: float
    """Seconds of tracing and lowering."""
    made: Future[tuple[jax.stages.Compiled, float]]

    def result(self) -> tuple[jax.stages.Compiled, float]:
        """Return the compiled function, and the seconds from Python to machine code."""
        executable, compile_s = self.made.result()
        return executable, self.lowering_s + compile_s


class ParallelCompiler:
    """Compiler with one thread per program; leaving the context waits for all."""

    def __init__(self, max_threads: int) -> None:
        """Set the number of threads."""
        self._threads = ThreadPoolExecutor(max_threads, thread_name_prefix="compile")

    def __enter__(self) -> Self:
        """Accept programs from now on."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Wait for all programs; skip those that have not begun after a failure."""
        self._threads.shutdown(cancel_futures=error is not None)

    def begin[R](self, function: CompiledFunction[R], *example: object) -> PendingProgram:
        """Begin to load or compile a function for arguments of these shapes.

        One that is neither kept nor stored is traced and lowered before this returns.
        """
        if (executable := function.kept) is not None:
            return PendingProgram(lowering_s=0.0, made=_completed((executable, 0.0)))
        stored = function.find(*example)
        if stored is not None:
            made = self._threads.submit(_load_timed, function, stored, *example)
            return PendingProgram(lowering_s=0.0, made=made)
        lowered, lowering_s = _lower_timed(function, *example)
        made = self._threads.submit(_compile_timed, function, lowered, *example)
        return PendingProgram(lowering_s=lowering_s, made=made)


def _completed[T](result: T) -> Future[T]:
    future: Future[T] = Future()
    future.set_result(result)
    return future


_COLLECTION = SharedPause(gc.isenabled, lambda on: gc.enable() if on else gc.disable())
"""Python's cyclic garbage collection. A trace makes millions of objects that live until it ends;
visiting them repeatedly took 23 % of the time to trace and lower the programs of `reef_fleet`
(15.7 s instead of 12.1)."""


def _lower_timed(
    function: CompiledFunction[Any], *example: object
) -> tuple[jax.stages.Lowered, float]:
    start = time.perf_counter()
    with _COLLECTION.paused():
        lowered = function.lower(*example)
    return lowered, time.perf_counter() - start


def _compile_timed(
    function: CompiledFunction[Any], lowered: jax.stages.Lowered, *example: object
) -> tuple[jax.stages.Compiled, float]:
    start = time.perf_counter()
    executable = function.compile(lowered, *example)
    return executable, time.perf_counter() - start


def _load_timed(
    function: CompiledFunction[Any], stored: StoredProgram, *example: object
) -> tuple[jax.stages.Compiled, float]:
    """Load a stored program; compile it where its device refuses it."""
    start = time.perf_counter()
    executable = load_stored(stored)
    if executable is None:
        lowered, _ = _lower_timed(function, *example)
        executable, _ = _compile_timed(function, lowered, *example)
    return executable, time.perf_counter() - start
