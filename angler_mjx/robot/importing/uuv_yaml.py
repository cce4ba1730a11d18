"""YAML files of UUV Simulator's thruster manager, compared with the imported thrusters."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.robot.importing.notes import Location, Notes
from angler_mjx.robot.importing.yaml_files import find_key_lines, read_yaml

TOLERANCE = 0.01
"""Max difference of an allocation matrix from the thrusters, 1 and m."""


def compare_yaml(path: Path, layout: Sequence[Mapping[str, Any]], notes: Notes) -> None:
    """Compare the allocation matrix of a file with thrusters, and list its other keys.

    Args:
        path: of a YAML file with the keys tam, thruster_manager, or both.
        layout: thrusters of the vehicle file; the matrix is about the origin of their frame.
        notes: list to add to.

    Raises:
        ConfigError: the file holds neither, or the matrix contradicts the thrusters.
    """
    content = read_yaml(path)
    if not isinstance(content, dict) or not content.keys() & {"tam", "thruster_manager"}:
        raise ConfigError(
            f"{path}: holds neither tam nor thruster_manager; give files of UUV Simulator's "
            "thruster manager"
        )
    lines = find_key_lines(path)
    for key, value in content.items():
        if key == "tam":
            _compare_matrix(path, lines[key], value, layout, notes)
        elif key == "thruster_manager" and isinstance(value, dict):
            for name, entry in value.items():
                notes.add(
                    "dropped",
                    f"{name} = {format_value(entry, 40)} of thruster_manager: the thruster file "
                    "and the controllers have it",
                    Location(file=path, line=lines[str(name)]),
                )
        else:
            notes.add(
                "dropped",
                f"{key} = {format_value(value, 40)}: not understood",
                Location(file=path, line=lines[str(key)]),
            )


def _compare_matrix(
    path: Path, line: int, value: object, layout: Sequence[Mapping[str, Any]], notes: Notes
) -> None:
    try:
        stated = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        stated = np.zeros(0)
    if stated.shape != (6, len(layout)) or not np.all(np.isfinite(stated)):
        raise ConfigError(
            f"{path}:{line}: tam has the shape {list(stated.shape)}; the vehicle has {len(layout)} "
            f"thrusters, so give 6 rows of {len(layout)} numbers"
        )
    columns = [
        np.concatenate(
            [row["direction"], np.cross(np.array(row["position_m"]), np.array(row["direction"]))]
        )
        for row in layout
    ]
    difference = np.abs(stated - np.array(columns).T)
    i, j = np.unravel_index(int(np.argmax(difference)), difference.shape)
    name, computed = layout[int(j)]["name"], columns[int(j)][i]
    if difference[i, j] > TOLERANCE:
        raise ConfigError(
            f"{path}:{line}: tam[{i}][{j}] = {stated[i, j]:g}, but thruster {name} "
            f"gives {computed:g} by its pose; correct one of them, or leave the file out"
        )
    notes.add(
        "converted",
        f"tam: not stored; it is that of the thrusters' poses within {difference[i, j]:.2g}",
        Location(file=path, line=line),
    )
