"""Scenarios with other values than their files say: plain tables, changed key by key."""

import copy
import json
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import AfterValidator, ValidationInfo

from angler_mjx.errors import ConfigError, shown
from angler_mjx.files import folder_of
from angler_mjx.scenario.paths import anchored
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.scenario.tables import PlannerConfig


def _from_its_file(table: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
    return anchored(table, folder_of(info))


type Changes = Annotated[dict[str, Any], AfterValidator(_from_its_file)]
"""Keys of a scenario in another file; paths in them begin at that file's folder."""


def merged(table: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """A table with other values; tables within it are merged, all else is replaced."""
    made = dict(table)
    for key, value in changes.items():
        before = made.get(key)
        if isinstance(value, Mapping) and isinstance(before, Mapping):
            made[key] = merged(before, value)
        else:
            made[key] = value
    return made


def first_difference(now: Mapping[str, Any], then: Mapping[str, Any]) -> str | None:
    """The dotted key of the first value that a table has otherwise than one that was written.

    Args:
        now: plain values; tuples are lists.
        then: read from a file; keys that it has at the top alone do not count.
    """
    for key, value in now.items():
        before = then.get(key)
        if json.dumps(value, sort_keys=True) == json.dumps(before, sort_keys=True):
            continue
        if isinstance(value, Mapping) and isinstance(before, Mapping):
            every = {name: value.get(name) for name in sorted({*value, *before})}
            return f"{key}.{first_difference(every, before)}"
        return key
    return None


def table_of(scenario: Scenario) -> dict[str, Any]:
    """What a scenario's file said, in plain values; paths in it are absolute."""
    table = scenario.model_dump(mode="json", exclude_unset=True)
    table["fleet"] = [one.model_dump(mode="json", exclude_unset=True) for one in scenario.fleet]
    return table


def without_horizon(table: dict[str, Any]) -> dict[str, Any]:
    """A table whose horizon is that of its world's preset: for one that gets another world."""
    time = {key: value for key, value in table.get("time", {}).items() if key != "horizon_s"}
    return {**table, "time": time}


def with_value(table: dict[str, Any], key: str, value: Any) -> dict[str, Any]:
    """A table in which one key has another value.

    Args:
        table: of a scenario.
        key: dotted, such as ``time.horizon_s``; entries of lists by their index from 0, as in
            ``fleet.0.count``, or all of them, as in ``fleet.*.estimate``. Settings of a planner
            stand in ``planner.NAME``, as in a file.
        value: plain. A table takes the place of a whole table.

    Raises:
        ConfigError: the key leads through something that is no table, or to no entry of a list.
    """
    parts = key.split(".")
    if parts[0] == "planner" and len(parts) > 2 and parts[1] not in PlannerConfig.model_fields:
        parts.insert(1, "settings")
    made = copy.deepcopy(table)
    _put(made, parts, 0, value)
    return made


def _put(at: Any, parts: list[str], i: int, value: Any) -> None:
    """Put a value into a table or list, where the parts from i on lead to."""
    part, last = parts[i], i == len(parts) - 1
    key, here = ".".join(parts), ".".join(parts[:i])
    if isinstance(at, list):
        held = range(len(at))
        steps: list[Any] = [n for n in held if part in ("*", str(n))]
        if not steps:
            entries = f"entries 0 to {len(at) - 1}" if at else "no entries"
            raise ConfigError(f"{key}: {here} is a list with {entries}; there is no {part}")
    elif isinstance(at, dict):
        steps = [part]
        if not last:
            at.setdefault(part, {})
    else:
        raise ConfigError(f"{key}: {here} = {shown(at)} is no table; no key can stand in it")
    for step in steps:
        if last:
            at[step] = copy.deepcopy(value)
        else:
            _put(at[step], parts, i + 1, value)
