"""What way-points cost: the same plans with more of them, flown by the fused engine.

    python -m angler_experiments.way_points --worlds 16384

The grid planner's paths are divided evenly by their rows, so that they lead the same way at the
same times; rates are medians of five flights over the first third of the horizon.
"""

import time
from typing import Any

import jax
import numpy as np
import tyro

from angler_mjx.planning.planner import PathShape
from angler_mjx.robot.control.trajectory import Trajectory
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import load_scenario

FLIGHTS = 5


def divided(path: Any, points: int) -> Trajectory:
    """Paths with another number of way-points.

    Args:
        path: `Trajectory`, [world, robot] leading.
        points: of each.
    """
    when, where = np.asarray(path.time_s), np.asarray(path.position_m)
    rows = np.linspace(0.0, when.shape[-1] - 1, points)
    low = np.minimum(rows.astype(int), when.shape[-1] - 2)
    share = (rows - low).astype(np.float32)
    made: Any = {
        "time_s": when[..., low] * (1 - share) + when[..., low + 1] * share,
        "position_m": where[..., low, :] * (1 - share)[:, None]
        + where[..., low + 1, :] * share[:, None],
        "found": np.asarray(path.found),
    }
    return Trajectory(**made)


def rate(simulator: Simulator, worlds: Any) -> float:
    """Vehicle-steps/s, the median of some flights; compiled before the first."""
    segments = max(1, simulator.segments // 3)
    robots = worlds.variant.size * simulator.spec.physics_steps * simulator.segment_steps
    rates = []
    for _ in range(FLIGHTS + 1):
        state = jax.block_until_ready(simulator.reset(worlds))
        begun = time.perf_counter()
        for _ in range(segments):
            state, _, _ = simulator.advance(worlds, state)
        jax.block_until_ready(state)
        rates.append(segments * robots / (time.perf_counter() - begun))
    return float(np.median(rates[1:]))


def main(worlds: int = 1024, points: tuple[int, ...] = (32, 256, 1024)) -> None:
    """Print the rate for each number of way-points.

    Args:
        worlds: of `reef_fleet`, in one tile.
        points: of a path.
    """
    scenario = load_scenario(
        "reef_fleet", engine="fused", worlds=worlds, tile=worlds, time={"record_hz": 0.0}
    )
    planned = jax.device_get(Simulator(scenario).worlds().path)
    for number in points:
        simulator = Simulator(scenario, paths=PathShape(points=number))
        drawn = simulator.with_paths(simulator.worlds(), divided(planned, number))
        print(f"{number:5d} way-points: {rate(simulator, drawn):.3g} vehicle-steps/s", flush=True)


if __name__ == "__main__":
    tyro.cli(main)
