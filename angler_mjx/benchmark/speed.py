"""Speed of a scenario on this device: drawing and planning worlds, and simulating them.

What is timed is said with every row. The simulation is timed in its first seconds, while all robots
move; a result with NaN in it is refused.
"""

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.runs.provenance import describe_environment, peak_memory_bytes
from angler_mjx.runs.scenario import Scenario
from angler_mjx.runs.simulator import Simulator
from angler_mjx.sim.state import Outcome


@dataclass(frozen=True, kw_only=True)
class Row:
    """One measurement."""

    workload: str
    inside: str
    """What the timed region holds."""
    worlds: int
    robots: int
    unit: str
    median: float
    low: float
    high: float
    """Median, least and greatest rate over the repeats, in ``unit``."""
    repeats: int
    compile_s: float


def measure(scenario: Scenario, *, worlds: int, repeats: int) -> list[Row]:
    """Time one scenario.

    Args:
        scenario: what to simulate; ``worlds`` of it in one tile.
        worlds: worlds in one device call.
        repeats: timed calls of each kind, after one that is not timed.

    Returns:
        A row for drawing and planning worlds (worlds/s), and one for simulating them
        (vehicle-steps/s: physics steps of all robots).

    Raises:
        ConfigError: fewer than one repeat.
        RunError: a result is not finite, or not every robot moved all the time.
    """
    if repeats < 1:
        raise ConfigError(f"--repeats {repeats}: must be at least 1")
    simulator = Simulator(scenario, tile=worlds)
    compiled = simulator.compile()
    robots = len(scenario.members())
    prepare = _seconds(lambda i: simulator.worlds(i * worlds), repeats)
    tile = simulator.worlds(0)
    steps = worlds * robots * simulator.segment_steps * simulator.spec.physics_steps

    def simulate(_: int) -> Any:
        return simulator.segment(tile, fresh.pop())

    fresh = [simulator.reset(tile) for _ in range(repeats + 1)]
    jax.block_until_ready(fresh)
    segment = _seconds(simulate, repeats, check=_require_moving)
    seconds = simulator.segment_steps * simulator.spec.control_dt_s
    return [
        _row(
            "worlds",
            "drawing cells, obstacles, currents, starts and goals; planning all robots",
            scenario,
            worlds,
            compiled.prepare_s,
            "worlds/s",
            [worlds / s for s in prepare],
        ),
        _row(
            "simulation",
            f"{seconds:g} s of simulated time from the start: current, water, MJX, control, "
            "obstacles, detection, samples left on the device",
            scenario,
            worlds,
            compiled.segment_s,
            "vehicle-steps/s",
            [steps / s for s in segment],
        ),
    ]


def record(rows: list[Row], out: Path) -> None:
    """Append rows to a JSON-lines file, each with device, versions and commit.

    Raises:
        ConfigError: the file cannot be written.
    """
    around = {**describe_environment(), "peak_host_memory_bytes": peak_memory_bytes()}
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with out.open("a", encoding="utf-8") as file:
            for row in rows:
                file.write(json.dumps({**asdict(row), **around}) + "\n")
    except OSError as error:
        raise ConfigError(f"--out {out}: cannot be written ({error.strerror})") from error


def _row(
    name: str,
    inside: str,
    scenario: Scenario,
    worlds: int,
    compile_s: float,
    unit: str,
    rates: list[float],
) -> Row:
    return Row(
        workload=f"{scenario.engine}/{scenario.name}/{name}",
        inside=inside,
        worlds=worlds,
        robots=len(scenario.members()),
        unit=unit,
        median=float(np.median(rates)),
        low=min(rates),
        high=max(rates),
        repeats=len(rates),
        compile_s=compile_s,
    )


def _seconds(
    call: Callable[[int], Any], repeats: int, check: Callable[[Any], None] | None = None
) -> list[float]:
    """Wall time of ``repeats`` calls, each blocked on its result, after one untimed call."""
    jax.block_until_ready(call(0))
    taken = []
    for i in range(1, repeats + 1):
        start = time.perf_counter()
        result = jax.block_until_ready(call(i))
        taken.append(time.perf_counter() - start)
        if check is not None:
            check(result)
    return taken


def _require_moving(result: Any) -> None:
    """Refuse a timed segment with a NaN in it, or with robots that had ended before it did."""
    state, sample = result
    if not np.isfinite(np.asarray(sample.p)).all():
        raise RunError("the timed run holds NaN: no number is given")
    running = float(np.mean(np.asarray(state.tally.outcome) == Outcome.RUNNING))
    if running < 0.9:
        raise RunError(
            f"only {running:.0%} of the robots were still on their way at the end of the timed "
            "region: no number is given"
        )
