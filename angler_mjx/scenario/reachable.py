"""Whether any robot of a scenario can be at its goal in time, as far as the scenario alone says."""

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.world.config import resolve


def least_time_s(scenario: Scenario) -> float:
    """Time within which no robot can be at its goal: straight on at its cruise speed."""
    world = resolve(scenario.world)
    cruise_mps = np.array(
        [one.cruise_speed_mps for one in scenario.fleet for _ in range(one.count)]
    )
    apart_m = np.full(len(cruise_mps), 0.5 * max(world.size_m))
    if world.placement == "given":
        apart_m = np.linalg.norm(np.subtract(world.goal_m, world.start_m), axis=1)
    left_m = np.maximum(apart_m - scenario.goal_tolerance_m, 0.0)
    return float(np.min(left_m / cruise_mps))


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
    may_be_carried = scenario.policy.name != "none" or scenario.planner.name == "current"
    if may_be_carried and scenario.world.currents:
        return
    least_s, horizon_s = least_time_s(scenario), scenario.time.horizon_s
    if horizon_s >= least_s:
        return
    raise ConfigError(
        f"{key} = {horizon_s:g}: no robot can be at its goal by then; straight on at cruise speed "
        f"the nearest goal that placement allows takes {least_s:.1f} s; give more than that"
    )
