"""Scenario and speed options of the autopilots."""

from pathlib import Path
from typing import Literal

from angler_mjx.errors import ConfigError
from angler_mjx.scenario.scenario import Scenario, load_scenario

FASTEST = "max"


def select_scenario(scenario: Scenario | str | Path, robots: int | None) -> Scenario:
    """Return a scenario with a given number of robots.

    Args:
        scenario: itself, its name, or its file.
        robots: number of robots; the first of its fleet, and more of the last kind if it has fewer.
            With explicit places, robots take the first ones.

    Raises:
        ConfigError: the scenario has faults, or the number is below 1.
    """
    chosen = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    if robots is None:
        return chosen
    if robots < 1:
        raise ConfigError(f"robots = {robots}: give 1 or more")
    fleet, remaining = [], robots
    for i, entry in enumerate(chosen.fleet):
        last = i == len(chosen.fleet) - 1
        count = remaining if last else min(entry.count, remaining)
        if count:
            fleet.append(entry.model_copy(update={"count": count}))
        remaining -= count
    positions = {key: getattr(chosen.world, key)[:robots] for key in ("start_m", "goal_m")}
    world = chosen.world.model_copy(update=positions)
    return chosen.model_copy(update={"fleet": tuple(fleet), "world": world})


def parse_speed(speed: Literal["max"] | float) -> float | None:
    """Return the speed, times real time; None for no limit.

    Raises:
        ConfigError: it is not a positive number.
    """
    if speed == FASTEST:
        return None
    if not isinstance(speed, int | float) or not speed > 0:
        raise ConfigError(f"speed = {speed!r}: give a positive number, or {FASTEST!r}")
    return float(speed)
