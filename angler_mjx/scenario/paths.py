"""Paths in scenarios: those of a file begin at its folder, and are absolute once it is read."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from angler_mjx.planning import register


def _file(path: str, folder: Path) -> str:
    return str((folder / path).absolute()) if path else path


def _vehicle(name: str, folder: Path) -> str:
    return _file(name, folder) if name.endswith(".toml") else name


PATHS: Mapping[tuple[str, ...], Callable[..., str]] = {
    ("fleet", "*", "vehicle"): _vehicle,
    ("planner", "name"): register.beside,
    ("world", "currents", "*", "file"): _file,
    ("world", "bathymetry", "file"): _file,
}
"""Keys that may hold paths, and what makes them absolute."""


def anchored(table: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Keys of a scenario with the paths in them made absolute.

    Args:
        table: whole, or some of its keys; faults of it are left to who checks it.
        folder: in which paths begin.
    """
    made: Any = table
    for key, absolute in PATHS.items():
        made = _anchored(made, key, partial(absolute, folder=folder))
    return dict(made)


def _anchored(at: Any, key: tuple[str, ...], absolute: Callable[[str], str]) -> Any:
    if not key:
        return absolute(at) if isinstance(at, str) else at
    if key[0] == "*" and isinstance(at, list | tuple):
        return [_anchored(one, key[1:], absolute) for one in at]
    if isinstance(at, Mapping) and key[0] in at:
        return {**at, key[0]: _anchored(at[key[0]], key[1:], absolute)}
    return at
