"""Fraction of teams that device planners plan, and their rate.

    python -m angler_experiments.benchmarks.fleets_planned --presets reef --teams 16 32 --worlds 512

Still water without drifting obstacles, robots of the reef fleet's two kinds crossing the middle.
Rates are of the second of two samplings with plans, less one without plans. Of incomplete teams it
reports how many provably have no plan at all (`planning.priority.proofs`).
"""

import time

import jax
import numpy as np
import tyro

from angler_mjx.planning.planner import PathShape
from angler_mjx.planning.priority.proofs import prove_unsolvable
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario, load_scenario
from angler_mjx.sim.state import World


def build_scenario(
    preset: str, robots: int, worlds: int, horizon_s: float, planner: str
) -> Scenario:
    """Build the scenario of teams of one size in worlds of one preset."""
    small = robots // 2
    heavy = load_scenario("reef_fleet").fleet[0].model_copy(update={"count": robots - small})
    fleet = [heavy.model_dump(exclude_unset=True)]
    if small:
        fleet.append({"vehicle": "bluerov2", "count": small, "parameter_set": "blue_gazebo"})
    return load_scenario(
        "reef_fleet",
        worlds=worlds,
        tile=worlds,
        fleet=fleet,
        world={"preset": preset, "currents": [], "obstacles": {"dynamic": {"count": 0}}},
        time={"horizon_s": horizon_s, "record_hz": 0.0},
        planner={"name": planner, "points": 64},
    )


def sample_timed(simulator: Simulator) -> tuple[World, float]:
    """Sample worlds; return them and the seconds of a second sampling."""
    jax.block_until_ready(simulator.worlds())
    start_s = time.perf_counter()
    worlds = jax.block_until_ready(simulator.worlds())
    return worlds, time.perf_counter() - start_s


def main(
    presets: tuple[str, ...] = ("reef",),
    teams: tuple[int, ...] = (4, 16),
    planners: tuple[str, ...] = ("grid", "priority"),
    worlds: int = 64,
    horizon_s: float = 180.0,
) -> None:
    """Print a row for each planner, preset and size of team.

    Args:
        presets: presets of the worlds.
        teams: robots of each team.
        planners: device planners.
        worlds: worlds of each row, in one tile.
        horizon_s: horizon of the plans.
    """
    print(
        "| preset | robots | planner | teams, % | robots, % | worlds/s |\n|---|---|---|---|---|---|"
    )
    for preset in presets:
        for robots in teams:
            grid_scenario = build_scenario(preset, robots, worlds, horizon_s, "grid")
            _, without_s = sample_timed(Simulator(grid_scenario, paths=PathShape(points=64)))
            for name in planners:
                simulator = Simulator(build_scenario(preset, robots, worlds, horizon_s, name))
                sampled_worlds, seconds = sample_timed(simulator)
                is_valid = np.asarray(sampled_worlds.environment.valid)
                has_path = np.asarray(sampled_worlds.planned)[is_valid]
                unplanned = np.flatnonzero(
                    ~np.asarray(sampled_worlds.planned).all(axis=1) & is_valid
                )
                host_problems = simulator.problems(0, worlds) if unplanned.size else []
                margin_m = simulator.scenario.planner.margin_m
                proved = sum(
                    prove_unsolvable(host_problems[i], margin_m) is not None for i in unplanned
                )
                rate = worlds / max(seconds - without_s, 1e-9)
                print(
                    f"| {preset} | {robots} | {name} | {100 * has_path.all(axis=1).mean():.1f} | "
                    f"{100 * has_path.mean():.1f} | {rate:.3g} | {unplanned.size}, {proved} |",
                    flush=True,
                )


if __name__ == "__main__":
    tyro.cli(main)
