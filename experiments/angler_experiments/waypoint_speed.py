"""Cost of way-points: the same plans with more of them, flown by the fused engine.

    python -m angler_experiments.waypoint_speed --worlds 16384

The grid planner's paths are divided evenly by their rows, so that they follow the same paths at the
same times; rates are medians of five flights over the first third of the horizon.
"""

import time

import jax
import numpy as np
import tyro

from angler_mjx.host_arrays import as_leaf
from angler_mjx.planning.planner import PathShape
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.sim.state import World

FLIGHTS = 5


def resample_path(path: Trajectory, points: int) -> Trajectory:
    """Resample paths to another number of way-points.

    Args:
        path: `Trajectory`, [world, robot] leading.
        points: number of way-points of each path.
    """
    time_s, position_m = np.asarray(path.time_s), np.asarray(path.position_m)
    rows = np.linspace(0.0, time_s.shape[-1] - 1, points)
    low = np.minimum(rows.astype(int), time_s.shape[-1] - 2)
    fraction = (rows - low).astype(np.float32)
    return Trajectory(
        time_s=as_leaf(time_s[..., low] * (1 - fraction) + time_s[..., low + 1] * fraction),
        position_m=as_leaf(
            position_m[..., low, :] * (1 - fraction)[:, None]
            + position_m[..., low + 1, :] * fraction[:, None]
        ),
        found=as_leaf(np.asarray(path.found)),
    )


def measure_rate(simulator: Simulator, worlds: World) -> float:
    """Return vehicle-steps/s, the median of some flights; compiled before the first."""
    segments = max(1, simulator.segments // 3)
    robots = worlds.variant.size * simulator.spec.physics_steps * simulator.segment_steps
    rates = []
    for _ in range(FLIGHTS + 1):
        state = jax.block_until_ready(simulator.reset(worlds))
        start_s = time.perf_counter()
        for _ in range(segments):
            state, _, _ = simulator.advance(worlds, state)
        jax.block_until_ready(state)
        rates.append(segments * robots / (time.perf_counter() - start_s))
    return float(np.median(rates[1:]))


def main(worlds: int = 1024, points: tuple[int, ...] = (32, 256, 1024)) -> None:
    """Print the rate for each number of way-points.

    Args:
        worlds: worlds of `reef_fleet`, in one tile.
        points: numbers of way-points of a path.
    """
    scenario = load_scenario(
        "reef_fleet", engine="fused", worlds=worlds, tile=worlds, time={"record_hz": 0.0}
    )
    planned = jax.device_get(Simulator(scenario).worlds().path)
    for number in points:
        simulator = Simulator(scenario, paths=PathShape(points=number))
        worlds_state = simulator.with_paths(simulator.worlds(), resample_path(planned, number))
        print(
            f"{number:5d} way-points: {measure_rate(simulator, worlds_state):.3g} vehicle-steps/s",
            flush=True,
        )


if __name__ == "__main__":
    tyro.cli(main)
