"""Scenarios with changed values: plain tables, changed key by key."""

import copy
import json
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import AfterValidator, ValidationInfo

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.files import base_folder
from angler_mjx.scenario.path_resolution import resolve_paths
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.scenario.tables import PlannerConfig


def _anchor_changes(table: dict[str, object], info: ValidationInfo) -> dict[str, object]:
    return resolve_paths(table, base_folder(info))


type Changes = Annotated[dict[str, Any], AfterValidator(_anchor_changes)]
"""Keys of a scenario in another file; their paths are relative to that file's folder."""


def merge_tables(table: Mapping[str, object], changes: Mapping[str, object]) -> dict[str, Any]:
    """Return a table with changed values; nested tables are merged, other values replaced."""
    result = dict(table)
    for key, value in changes.items():
        old_value = result.get(key)
        if isinstance(value, Mapping) and isinstance(old_value, Mapping):
            result[key] = merge_tables(old_value, value)
        else:
            result[key] = value
    return result


def first_changed_key(current: Mapping[str, object], stored: Mapping[str, object]) -> str | None:
    """Return the dotted key of the first value that differs from a stored table.

    Args:
        current: plain values; tuples are lists.
        stored: read from a file; additional keys at its top level do not count.
    """
    for key, value in current.items():
        stored_value = stored.get(key)
        if json.dumps(value, sort_keys=True) == json.dumps(stored_value, sort_keys=True):
            continue
        if isinstance(value, Mapping) and isinstance(stored_value, Mapping):
            values = {name: value.get(name) for name in sorted({*value, *stored_value})}
            return f"{key}.{first_changed_key(values, stored_value)}"
        return key
    return None


def scenario_table(scenario: Scenario) -> dict[str, Any]:
    """Return the keys of a scenario's file as plain values, with absolute paths."""
    table = scenario.model_dump(mode="json", exclude_unset=True)
    table["fleet"] = [entry.model_dump(mode="json", exclude_unset=True) for entry in scenario.fleet]
    return table


def remove_horizon(table: dict[str, object]) -> dict[str, object]:
    """Return a table without its horizon, which then follows the preset of its new world."""
    time = table.get("time")
    entries = time.items() if isinstance(time, dict) else ()
    return {**table, "time": {key: value for key, value in entries if key != "horizon_s"}}


def set_value(table: dict[str, object], key: str, value: object) -> dict[str, object]:
    """Return a table in which one key has another value.

    Args:
        table: of a scenario.
        key: dotted, such as ``time.horizon_s``; entries of lists by their index from 0, as in
            ``fleet.0.count``, or all of them, as in ``fleet.*.estimate``. Settings of a planner
            stand in ``planner.NAME``, as in a file.
        value: plain. A table replaces a whole table.

    Raises:
        ConfigError: the key leads through a value that is no table, or to no entry of a list.
    """
    parts = key.split(".")
    if parts[0] == "planner" and len(parts) > 2 and parts[1] not in PlannerConfig.model_fields:
        parts.insert(1, "settings")
    changed = copy.deepcopy(table)
    _set_value(changed, parts, 0, value)
    return changed


def _set_value(container: object, parts: list[str], i: int, value: object) -> None:
    """Put a value into a table or list, at the parts of the key from i on."""
    part, is_last = parts[i], i == len(parts) - 1
    key, parent_key = ".".join(parts), ".".join(parts[:i])
    if isinstance(container, list):
        indices = [n for n in range(len(container)) if part in ("*", str(n))]
        if not indices:
            entries = f"entries 0 to {len(container) - 1}" if container else "no entries"
            raise ConfigError(f"{key}: {parent_key} is a list with {entries}; there is no {part}")
        for index in indices:
            if is_last:
                container[index] = copy.deepcopy(value)
            else:
                _set_value(container[index], parts, i + 1, value)
    elif not isinstance(container, dict):
        raise ConfigError(
            f"{key}: {parent_key} = {format_value(container)} is no table; no key can stand in it"
        )
    elif is_last:
        container[part] = copy.deepcopy(value)
    else:
        _set_value(container.setdefault(part, {}), parts, i + 1, value)
