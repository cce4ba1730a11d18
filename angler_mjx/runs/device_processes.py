"""Processes that compile and run programs side by side, all on the devices of this one.

Tracing holds Python's lock: many programs are compiled in the time of a few only by processes. On a
CPU the default is one: XLA compiles and runs a program on all processors.
"""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

import jax

from angler_mjx.runs.simulator import stored_programs
from angler_mjx.runs.storage.parallel import cpu_count, map_in_order, open_processes

MAX_PROCESSES = 8
"""Processes by default at most: each has a context of its own in the device's memory."""

INHERITED = (
    "jax_platforms",
    "jax_enable_x64",
    "jax_compilation_cache_dir",
    "jax_enable_compilation_cache",
    "jax_persistent_cache_min_compile_time_secs",
)
"""JAX's settings that the processes take over; those of environment variables they have anyway."""
PREALLOCATION = "XLA_PYTHON_CLIENT_PREALLOCATE"
"""Environment variable; "false" keeps JAX from taking three quarters of a GPU's memory at once."""


def disable_preallocation() -> None:
    """Have JAX take a GPU's memory as needed, unless the user chose; before it starts devices."""
    os.environ.setdefault(PREALLOCATION, "false")


def default_count() -> int:
    """Return the number of processes that compile side by side; starts JAX's devices."""
    if jax.default_backend() == "cpu":
        return 1
    return max(1, min(cpu_count() // 2, MAX_PROCESSES))


@dataclass(frozen=True, kw_only=True)
class _Task[T, R]:
    function: Callable[[T], R]
    item: T
    settings: Mapping[str, object]
    is_stored: bool

    def run(self) -> R:
        disable_preallocation()
        for name, value in self.settings.items():
            if getattr(jax.config, name) != value:
                jax.config.update(name, value)
        if self.is_stored:
            stored_programs.enable_stored_programs()
        return self.function(self.item)


def map_on_devices[T, R](
    function: Callable[[T], R], items: Iterable[T], count: int, module: str
) -> Iterator[R]:
    """Yield the results of a function that runs programs, in the order of its arguments.

    Args:
        function: of a module; gets one item.
        items: arguments; they and the results can be pickled.
        count: number of processes; 1 calls the function here.
        module: of the function, by its full name.

    Raises:
        RunError: a process was killed.
    """
    if count < 2:
        yield from map(function, items)
        return
    settings = {name: getattr(jax.config, name) for name in INHERITED}
    is_stored = stored_programs.are_enabled()
    tasks = (
        _Task(function=function, item=item, settings=settings, is_stored=is_stored)
        for item in items
    )
    with open_processes(count, module) as pool:
        yield from map_in_order(_Task.run, tasks, pool)
