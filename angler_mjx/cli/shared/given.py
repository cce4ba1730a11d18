"""A scenario as a command line gives it: a file, and flags that replace keys of it."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from angler_mjx.errors import ConfigError

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


def flag(key: str) -> str:
    """The flag of a key: ``--record-hz`` of ``time.record_hz``, ``--policy`` of ``policy.name``."""
    return "--" + key.removesuffix(".name").rpartition(".")[2].replace("_", "-")


def planner_given(name: str | None, **keys: float | None) -> dict[str, Any] | None:
    """The scenario's table of a planner that flags give; a file's path from the working folder.

    Settings of the scenario's own planner stay with it.

    Args:
        name: of the planner; the scenario's if None.
        **keys: others of its table; those that are None are left to the file.
    """
    given: dict[str, Any] = {key: value for key, value in keys.items() if value is not None}
    if name is None:
        return given or None
    path, colon, qualname = name.rpartition(":")
    if colon and path.endswith(".py"):
        name = f"{Path(path).absolute()}:{qualname}"
    return {"name": name, **given}


def at_least_one(key: str, value: int | None) -> int | None:
    """A number of processes from a flag.

    Raises:
        ConfigError: it is below 1.
    """
    if value is not None and value < 1:
        raise ConfigError(f"{flag(key)} {value}: must be at least 1")
    return value
