"""A scenario as a command line gives it: a file, and flags that replace keys of it."""

from collections.abc import Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any, get_args

from angler_mjx.errors import ConfigError, RunError, shown
from angler_mjx.files import named

if TYPE_CHECKING:
    from angler_mjx.scenario.scenario import Scenario


def scenario_given(name_or_path: str, **flags: Any) -> "Scenario":
    """Read a scenario; what is wrong with a flag is said of the flag.

    Args:
        name_or_path: of a shipped scenario, or of a file.
        **flags: keys of the scenario; those that are None are left to the file. A table holds
            keys within it.

    Raises:
        ConfigError: as `angler_mjx.scenario.scenario.load_scenario`.
    """
    from angler_mjx.scenario.scenario import read_scenario

    given = {key: value for key, value in flags.items() if value is not None}
    return read_scenario(name_or_path, given, blame=flag)


def scenario_to_fly(name_or_path: str, **flags: Any) -> "Scenario":
    """As `scenario_given`, of a scenario that is to be planned or flown.

    Raises:
        ConfigError: also where no robot can be at its goal within the horizon.
    """
    from angler_mjx.scenario.reachable import check_reachable

    loaded = scenario_given(name_or_path, **flags)
    check_reachable(loaded, f"{named(name_or_path)}: time.horizon_s")
    return loaded


def flag(key: str) -> str:
    """The flag of a key: ``--record-hz`` of ``time.record_hz``, ``--policy`` of ``policy.name``."""
    return "--" + key.removesuffix(".name").rpartition(".")[2].replace("_", "-")


def knows_given(text: str | None) -> dict[str, str] | None:
    """The scenario's table of what is known, from a flag such as obstacles=observed,current=truth.

    Raises:
        ConfigError: naming the part that is none, and what is possible.
    """
    if text is None:
        return None
    from angler_mjx.sim.information import Information, InformationLevel

    levels, things = get_args(InformationLevel.__value__), [one.name for one in fields(Information)]
    made: dict[str, str] = {}
    for part in text.split(","):
        thing, _, level = (word.strip() for word in part.partition("="))
        if thing not in things or level not in levels or thing in made:
            raise ConfigError(
                f"--knows {shown(part)}: give {' and '.join(things)} once each at most, as in "
                f"obstacles=observed,current=predicted; levels are {', '.join(levels)}"
            )
        made[thing] = level
    return made


def policy_given(name: str | None, knows: dict[str, str] | None) -> dict[str, Any] | None:
    """Return the scenario's table of a policy that flags give.

    Args:
        name: of the policy; the scenario's if None.
        knows: of `knows_given`, in place of the policy's own level; the scenario's if None.
    """
    given = {"name": name, "knows": knows}
    return {key: value for key, value in given.items() if value is not None} or None


def planner_given(name: str | None, **keys: Any) -> dict[str, Any] | None:
    """The scenario's table of a planner that flags give.

    Settings of the scenario's own planner stay with it.

    Args:
        name: of the planner; the scenario's if None.
        **keys: others of its table; those that are None are left to the file.
    """
    given: dict[str, Any] = {key: value for key, value in keys.items() if value is not None}
    if name is None:
        return given or None
    return {"name": name, **given}


def at_least_one(key: str, value: int | None) -> int | None:
    """A number of processes from a flag.

    Raises:
        ConfigError: it is below 1.
    """
    if value is not None and value < 1:
        raise ConfigError(f"{flag(key)} {value}: must be at least 1")
    return value


def require_planned(planning: Mapping[str, Any] | None, who: str) -> None:
    """Refuse to end a command as done when its planner raised an exception in every world.

    Args:
        planning: as `angler_mjx.runs.storage.planned.summarise` returns it.
        who: planned, for the message.

    Raises:
        RunError: no world was planned; names the planner, the exception, its file and line.
    """
    from angler_mjx.runs.storage import planned

    why = planned.fault(planning)
    if why is not None:
        raise RunError(
            f"{who} {why}; angler plan SCENARIO --planner NAME --debug 0 plans world 0 alone and "
            "lets the exception through, with its traceback"
        )
