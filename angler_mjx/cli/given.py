"""A scenario as a command line gives it: a file, and flags that replace keys of it."""

from typing import TYPE_CHECKING, Any

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
    """The flag of a key: ``--record-hz`` of ``time.record_hz``."""
    return "--" + key.rpartition(".")[2].replace("_", "-")
