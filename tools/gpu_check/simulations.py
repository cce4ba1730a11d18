"""Flights of small worlds: samples, plans and trajectories as arrays to compare."""

import jax
import numpy as np

from tools.gpu_check.comparing import ErrorBound

ROUNDING = "float32 rounds differently, and near ties and near misses are decided by it"

TIES = "of routes that cost the same, rounding decides which is flown"

BOUNDS = {
    "start_m": ErrorBound(atol=1e-4, why=ROUNDING),
    "goal_m": ErrorBound(atol=1e-4, why=ROUNDING),
    "planned": ErrorBound(fraction=0.95, axes=2, why=ROUNDING),
    "plan_m": ErrorBound(atol=1e-2, fraction=0.5, axes=2, why=TIES),
    "plan_s": ErrorBound(rtol=0.02, fraction=0.9, why=TIES),
    "early_m": ErrorBound(atol=1e-2, fraction=0.95, axes=2, why=ROUNDING, equal="plan_m"),
    "outcome": ErrorBound(fraction=0.85, axes=2, why=ROUNDING),
}
"""Bounds of robots [world, robot]; cells must be equal. Of durations of plans the mean of each
world's team is compared: which robot of a team waits for another can be a tie."""


def fly_worlds(scenario: str, **changes: object) -> dict[str, np.ndarray]:
    """Simulate every world of a scenario to its horizon.

    Args:
        scenario: name of a shipped scenario.
        **changes: as of `load_scenario`; tables are merged. Kernels of a GPU are left to a GPU.

    Returns:
        Cells, starts, goals, plans [world, robot, ...], positions after the first segment and
        outcomes [world, robot]; way-points of plans and mean durations
        [world] only where a planner made them.
    """
    from angler_mjx.robot.control import plans
    from angler_mjx.runs.simulator.simulator import Simulator
    from angler_mjx.scenario.scenario import load_scenario

    if jax.default_backend() != "gpu":
        changes = {key: value for key, value in changes.items() if key != "kernels"}
    loaded = load_scenario(scenario, **{"time": {}, **changes})
    simulator = Simulator(loaded, tile=loaded.worlds)
    try:
        simulator.compile()
        worlds = simulator.worlds()
        state = simulator.reset(worlds)
        early = None
        for _ in range(simulator.segments):
            state, _, _ = simulator.advance(worlds, state)
            if early is None:
                early = np.array(state.vehicles.p)
        jax.block_until_ready(state)
    finally:
        simulator.close()
    environment = worlds.environment
    arrays = {
        "cells": environment.grid.occupied,
        "start_m": environment.start_m,
        "goal_m": environment.goal_m,
        "early_m": early,
        "outcome": state.tally.outcome,
    }
    if simulator.planner is not None:
        arrays |= {
            "planned": worlds.planned,
            "plan_m": plans.points_m(worlds.path),
            "plan_s": np.mean(worlds.path.time_s[..., -1], axis=-1),
        }
    return {name: np.asarray(array) for name, array in arrays.items()}
