"""Scenarios of a command line: a file, and flags that replace its keys."""

from dataclasses import fields
from typing import TYPE_CHECKING

from angler_mjx.errors import ConfigError, RunError, format_value
from angler_mjx.files import format_path

if TYPE_CHECKING:
    from angler_mjx.runs.storage.planning_summary import PlanningSummary
    from angler_mjx.scenario.scenario import Scenario


def build_scenario(name_or_path: str, **flags: object) -> "Scenario":
    """Read a scenario; errors in a flag's value name the flag.

    Args:
        name_or_path: of a shipped scenario, or of a file.
        **flags: keys of the scenario; None keeps the file's value. A table holds nested keys.

    Raises:
        ConfigError: as `angler_mjx.scenario.scenario.load_scenario`.
    """
    from angler_mjx.scenario.scenario import read_scenario

    overrides = {key: value for key, value in flags.items() if value is not None}
    return read_scenario(name_or_path, overrides, blame=format_flag)


def build_flyable_scenario(name_or_path: str, **flags: object) -> "Scenario":
    """Read a scenario to plan or fly, as `build_scenario` does.

    Raises:
        ConfigError: also where no robot can reach its goal within the horizon.
    """
    from angler_mjx.scenario.horizon_check import check_reachable

    loaded = build_scenario(name_or_path, **flags)
    check_reachable(loaded, f"{format_path(name_or_path)}: time.horizon_s")
    return loaded


def format_flag(key: str) -> str:
    """Return the flag of a key, such as ``--record-hz`` of ``time.record_hz``."""
    return "--" + key.removesuffix(".name").rpartition(".")[2].replace("_", "-")


def parse_information(text: str | None) -> dict[str, str] | None:
    """Parse information levels from a flag such as obstacles=observed,current=truth.

    Raises:
        ConfigError: naming the part that is not valid, and the possible values.
    """
    if text is None:
        return None
    from angler_mjx.sim.information import LEVELS, Information

    quantities = [item.name for item in fields(Information)]
    table: dict[str, str] = {}
    for part in text.split(","):
        quantity, _, level = (text_part.strip() for text_part in part.partition("="))
        if quantity not in quantities or level not in LEVELS or quantity in table:
            raise ConfigError(
                f"--information {format_value(part)}: give {' and '.join(quantities)} once each at "
                "most, "
                "as in "
                f"obstacles=observed,current=predicted; levels are {', '.join(LEVELS)}"
            )
        table[quantity] = level
    return table


def build_policy_table(
    name: str | None, information: dict[str, str] | None
) -> dict[str, object] | None:
    """Return the scenario's table of a policy from flags.

    Args:
        name: of the policy; the scenario's if None.
        information: of `parse_information`, in place of the policy's own level; the scenario's if
            None.
    """
    table = {"name": name, "information": information}
    return {key: value for key, value in table.items() if value is not None} or None


def build_planner_table(name: str | None, **keys: object) -> dict[str, object] | None:
    """Return the scenario's table of a planner from flags.

    The settings of the scenario's own planner are kept.

    Args:
        name: of the planner; the scenario's if None.
        **keys: other keys of its table; None keeps the file's value.
    """
    table = {key: value for key, value in keys.items() if value is not None}
    if name is None:
        return table or None
    return {"name": name, **table}


def require_positive(key: str, value: int | None) -> int | None:
    """Return a number of processes from a flag.

    Raises:
        ConfigError: it is below 1.
    """
    if value is not None and value < 1:
        raise ConfigError(f"{format_flag(key)} {value}: must be at least 1")
    return value


def require_plans(planning: "PlanningSummary | None", source: str) -> None:
    """Refuse to end a command as successful when its planner raised in every world.

    Args:
        planning: of all its worlds; None where robots have a task.
        source: name of the planned scenario or file, for the message.

    Raises:
        RunError: no world was planned; names the planner, the exception, its file and line.
    """
    from angler_mjx.runs.storage import planning_summary

    reason = planning_summary.planner_fault(planning)
    if reason is not None:
        raise RunError(
            f"{source} {reason}; angler plan SCENARIO --planner NAME --debug 0 plans world 0 alone "
            "and "
            "lets the exception through, with its traceback"
        )
