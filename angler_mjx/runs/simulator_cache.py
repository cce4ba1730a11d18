"""Cache of compiled simulators, shared by cells that need the same programs, compiled ahead."""

import gc
import os
from collections import OrderedDict
from collections.abc import Callable, Hashable
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Self

from angler_mjx.runs.simulator.programs import release_memory
from angler_mjx.runs.simulator.simulator import Simulator

MAX_SIMULATORS = 24
"""Simulators that are held at a time: the programs of more would use up the memory maps that a
process may have."""
MAX_AHEAD = 4
"""Simulators that are compiled before they are needed."""


class SimulatorCache:
    """Compiled simulators by key; the least recently used ones are closed."""

    def __init__(self) -> None:
        """Hold no simulator yet."""
        self._threads = ThreadPoolExecutor(
            max(1, (os.cpu_count() or 1) // 4), thread_name_prefix="simulator"
        )
        self._held: OrderedDict[Hashable, Future[Simulator]] = OrderedDict()
        self.compiled = 0
        """Number of simulators whose compilation began."""

    def begin(self, key: Hashable, build: Callable[[], Simulator]) -> None:
        """Begin to compile a simulator in a thread, unless it is held.

        Args:
            key: equal for simulators of equal programs.
            build: makes the simulator; it is compiled afterwards.
        """
        if key not in self._held:
            self._held[key] = self._threads.submit(_compile_simulator, build)
            self.compiled += 1
        self._held.move_to_end(key)

    def of(self, key: Hashable, build: Callable[[], Simulator]) -> Simulator:
        """Return a compiled simulator; arguments as of `begin`.

        Raises:
            ConfigError, RunError: as of `Simulator` and its ``compile``.
        """
        self.begin(key, build)
        simulator = self._held[key].result()
        while len(self._held) > MAX_SIMULATORS:
            _close(self._held.popitem(last=False)[1])
            gc.collect()
        return simulator

    def drop(self, key: Hashable) -> None:
        """Close a simulator, if it is held."""
        held = self._held.pop(key, None)
        if held is not None:
            _close(held)

    def clear(self) -> None:
        """Close all simulators, and release the memory of their programs."""
        self._close_all()
        release_memory()

    def __enter__(self) -> Self:
        """Compile simulators from now on."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the cache; see `close`."""
        self.close()

    def close(self) -> None:
        """Wait for what is being compiled, and close all simulators."""
        self._threads.shutdown(cancel_futures=True)
        self._close_all()

    def _close_all(self) -> None:
        for future in self._held.values():
            _close(future)
        self._held.clear()


def _compile_simulator(build: Callable[[], Simulator]) -> Simulator:
    simulator = build()
    simulator.compile_ahead()
    return simulator


def _close(future: Future[Simulator]) -> None:
    """End what plans on the host for a simulator, once it is compiled."""
    if not future.cancel() and future.exception() is None:
        future.result().close()
