"""Paths in scenarios: relative to the file's folder, absolute once it is read."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from angler_mjx.user_classes import make_name_absolute


def _absolute_path(path: str, folder: Path) -> str:
    return str((folder / path).absolute()) if path else path


def _absolute_vehicle(name: str, folder: Path) -> str:
    return _absolute_path(name, folder) if name.endswith(".toml") else name


PATH_KEYS: Mapping[tuple[str, ...], Callable[..., str]] = {
    ("fleet", "*", "vehicle"): _absolute_vehicle,
    ("controller", "stages", "*"): make_name_absolute,
    ("planner", "name"): make_name_absolute,
    ("policy", "name"): make_name_absolute,
    ("world", "currents", "*", "file"): _absolute_path,
    ("world", "bathymetry", "file"): _absolute_path,
}
"""Keys that may hold paths, and the functions that make them absolute."""


def resolve_paths(table: Mapping[str, object], folder: Path) -> dict[str, object]:
    """Return keys of a scenario with absolute paths.

    Args:
        table: whole, or some of its keys; not checked here.
        folder: that paths are relative to.
    """
    resolved = dict(table)
    for (name, *rest), resolve in PATH_KEYS.items():
        if name in resolved:
            resolved[name] = _resolve_key(resolved[name], rest, partial(resolve, folder=folder))
    return resolved


def _resolve_key(value: object, key: Sequence[str], resolve: Callable[[str], str]) -> object:
    if not key:
        return resolve(value) if isinstance(value, str) else value
    if key[0] == "*" and isinstance(value, list | tuple):
        return [_resolve_key(entry, key[1:], resolve) for entry in value]
    if isinstance(value, Mapping) and key[0] in value:
        return {**value, key[0]: _resolve_key(value[key[0]], key[1:], resolve)}
    return value
