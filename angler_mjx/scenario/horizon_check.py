"""Whether any robot of a scenario can be at its goal in time, as far as the scenario alone says."""

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.world.config import resolve_world


def minimum_time_s(scenario: Scenario) -> float:
    """Time within which no robot can be at its goal: straight on at its cruise speed."""
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

    Plans are never faster over ground than the cruise speed, but for those of the planner current;
    a policy may be, too: in a current neither is judged. Nor are tasks, which have other places.

    Args:
        scenario: that is to be planned or flown.
        key: what the message calls the horizon, with the file that says it.

    Raises:
        ConfigError: naming the horizon and the least that is possible.
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
