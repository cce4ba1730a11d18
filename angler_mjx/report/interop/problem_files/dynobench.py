"""Reader of the problems of db-CBS and dynobench (dynoplan): YAML with boxes, starts and goals."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.files import format_path
from angler_mjx.report.interop.problem_files.foreign_problem import ForeignBox, ForeignProblem
from angler_mjx.robot.importing.notes import Notes
from angler_mjx.robot.importing.yaml_files import read_yaml

SUFFIXES = (".yaml", ".yml")


def read_problem(path: Path, *, robots: int | None) -> ForeignProblem:
    """Read a problem.

    Args:
        path: of the YAML file.
        robots: number of its first robots that are taken; all if None.

    Raises:
        ConfigError: the file has a fault, or something in it is not understood; named.
    """
    table = read_yaml(path)
    if not isinstance(table, Mapping):
        raise ConfigError(f"{format_path(path)}: must have the keys environment and robots")
    fault = _Faults(path)
    environment = fault.table(table, "environment")
    low = fault.vector(environment, "environment", "min", None)
    axes = len(low)
    if axes not in (2, 3):
        raise ConfigError(f"{format_path(path)}: environment.min: must have 2 or 3 numbers")
    high = fault.vector(environment, "environment", "max", axes)
    if any(a >= b for a, b in zip(low, high, strict=True)):
        raise ConfigError(f"{format_path(path)}: environment: max must be above min on each axis")
    notes = Notes()
    boxes = []
    for i, entry in enumerate(environment.get("obstacles") or []):
        at = f"environment.obstacles[{i}]"
        if not isinstance(entry, Mapping) or entry.get("type") != "box":
            kind = entry.get("type") if isinstance(entry, Mapping) else entry
            raise ConfigError(
                f"{format_path(path)}: {at}: type is {format_value(kind)}; boxes are read"
            )
        center, size = (fault.vector(entry, at, key, axes) for key in ("center", "size"))
        if min(size) <= 0.0:
            raise ConfigError(f"{format_path(path)}: {at}.size: must be above 0")
        boxes.append(ForeignBox(center=center, size=size))
    entries = table.get("robots")
    if not isinstance(entries, Sequence) or isinstance(entries, str) or not entries:
        raise ConfigError(f"{format_path(path)}: robots: must be a list of robots")
    taken = entries if robots is None else entries[:robots]
    if robots is not None and len(entries) < robots:
        raise ConfigError(f"{format_path(path)}: has {len(entries)} robots, --robots {robots}")
    if len(taken) < len(entries):
        notes.add("dropped", f"robots {len(taken)} to {len(entries) - 1}")
    start: list[np.ndarray] = []
    goal: list[np.ndarray] = []
    for i, entry in enumerate(taken):
        at = f"robots[{i}]"
        if not isinstance(entry, Mapping):
            raise ConfigError(f"{format_path(path)}: {at}: must have type, start and goal")
        states = [fault.vector(entry, at, key, None) for key in ("start", "goal")]
        for key, state, rows in zip(("start", "goal"), states, (start, goal), strict=True):
            if len(state) < axes:
                raise ConfigError(
                    f"{format_path(path)}: {at}.{key}: has {len(state)} of {axes} coordinates"
                )
            position = np.array(state[:axes])
            if np.any(position < low) or np.any(position > high):
                raise ConfigError(f"{format_path(path)}: {at}.{key}: lies outside the environment")
            rows.append(position)
            if any(state[axes:]):
                notes.add("dropped", f"headings and velocities of {key}s", at)
        notes.add("dropped", f"dynamics of {entry.get('type', 'robots without a type')}", at)
    for key in sorted(set(table) - {"environment", "robots"}):
        notes.add("dropped", f"key {key}")
    return ForeignProblem(
        name=path.name.split(".")[0],
        low=low,
        high=high,
        start=np.array(start),
        goal=np.array(goal),
        boxes=tuple(boxes),
        notes=notes,
    )


class _Faults:
    """Reads values of a file; faults name file and key."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def table(self, table: Mapping[str, Any], key: str) -> Mapping[str, Any]:
        """Return a table."""
        value = table.get(key)
        if not isinstance(value, Mapping):
            raise ConfigError(f"{format_path(self._path)}: {key}: must be a table")
        return value

    def vector(
        self, table: Mapping[str, Any], at: str, key: str, size: int | None
    ) -> tuple[float, ...]:
        """Return a list of finite numbers."""
        value = table.get(key)
        numbers = [
            float(x)
            for x in (value if isinstance(value, list) else ())
            if isinstance(x, int | float) and not isinstance(x, bool) and math.isfinite(x)
        ]
        expected = len(value) if isinstance(value, list) else 0
        if not numbers or len(numbers) != expected or (size is not None and expected != size):
            count = "" if size is None else f"{size} "
            raise ConfigError(
                f"{format_path(self._path)}: {at}.{key} = {format_value(value)}: must be a list of "
                f"{count}numbers"
            )
        return tuple(numbers)
