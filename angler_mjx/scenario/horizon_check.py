"""Check of whether any robot can reach its goal in time, from the scenario alone."""

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.world.config import resolve_world


def minimum_time_s(scenario: Scenario) -> float:
    """Return the min time [s] to any goal: a straight line at cruise speed."""
    world = resolve_world(scenario.world)
    cruise_mps = np.array(
        [entry.cruise_speed_mps for entry in scenario.fleet for _ in range(entry.count)]
    )
    distance_m = np.full(len(cruise_mps), 0.5 * max(world.size_m))
    if world.placement == "given":
        distance_m = np.linalg.norm(np.subtract(world.goal_m, world.start_m), axis=1)
    remaining_m = np.maximum(distance_m - scenario.goal_tolerance_m, 0.0)
    return float(np.min(remaining_m / cruise_mps))


def check_reachable(scenario: Scenario, key: str = "time.horizon_s") -> None:
    """Refuse a horizon in which no robot can be at its goal.

    Plans are no faster over ground than the cruise speed, except those of the planner `current` and
    policies in a current: these are not checked. Tasks with several jobs are not checked either.

    Args:
        scenario: to plan or fly.
        key: name of the horizon in the message, with its file.

    Raises:
        ConfigError: naming the horizon and the min time.
    """
    if scenario.task_spec() is not None:
        return
    may_use_current = scenario.policy.name != "none" or scenario.planner.name == "current"
    if may_use_current and scenario.world.currents:
        return
    minimum_s, horizon_s = minimum_time_s(scenario), scenario.time.horizon_s
    if horizon_s >= minimum_s:
        return
    raise ConfigError(
        f"{key} = {horizon_s:g}: no robot can be at its goal by then; straight on at cruise speed "
        f"the nearest goal that placement allows takes {minimum_s:.1f} s; give more than that"
    )
