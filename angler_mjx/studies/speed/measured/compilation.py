"""Seconds from Python to machine code of each program of a scenario, without and with a cache.

Cold: with an empty cache folder. Cached: a second time, from that folder, with nothing of the first
left in memory; a command loads its stored executables then, a Python caller traces and lowers
again. Each is measured once, since a cold start takes minutes.
"""

from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

import jax

from angler_mjx.errors import RunError
from angler_mjx.runs.simulator import compile_cache, programs
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.studies.speed.rows import DURATION, HITS, REQUESTS, SpeedRow, cache_events

CACHED = "cached"
INSIDE = (
    "from Python to executables with an empty cache folder, and once more with the programs of "
    "that folder; programs side by side, all together by the clock on the wall"
)


def measure(scenario: Scenario, *, label: str, worlds: int) -> list[SpeedRow]:
    """Compile the programs of a scenario twice into one temporary cache folder.

    Args:
        scenario: whose programs.
        label: beginning of the workload's name; ``/PROGRAM`` and ``/cached`` follow.
        worlds: in one device call.

    Returns:
        Rows in seconds: of all programs and of each, cold and then cached.

    Raises:
        RunError: a program was compiled a second time though the folder was full.
    """
    rows = []
    with (
        TemporaryDirectory(prefix="angler-compile-") as folder,
        compile_cache.use_cache_folder(Path(folder)),
    ):
        for is_cached in (False, True):
            jax.clear_caches()
            programs.clear_shared()
            rows += _measure_programs(scenario, label, worlds, is_cached)
    return rows


def _measure_programs(
    scenario: Scenario, label: str, worlds: int, is_cached: bool
) -> list[SpeedRow]:
    simulator = Simulator(scenario, tile=worlds)
    try:
        before = Counter(cache_events())
        took = simulator.compile()
        events = cache_events() - before
    finally:
        simulator.close()
    if is_cached and events[HITS] < events[REQUESTS]:
        raise RunError(
            f"{events[REQUESTS] - events[HITS]} of {events[REQUESTS]} programs were compiled a "
            "second time though a full cache folder was there: no number is given"
        )
    return [
        SpeedRow(
            workload="/".join([label, *program, *([CACHED] if is_cached else [])]),
            inside=INSIDE,
            worlds=worlds,
            robots=len(scenario.members()),
            unit=DURATION,
            median=seconds,
            low=seconds,
            high=seconds,
            repeats=1,
            compile_s=None,
            cached_programs=events[HITS] if not program else int(is_cached),
            engine=scenario.engine,
            kernels=simulator.kernels,
            controller=scenario.controller.title,
        )
        for program, seconds in [
            ((), took.total_s),
            *(((name,), seconds) for name, seconds in took.by_program().items()),
        ]
    ]
