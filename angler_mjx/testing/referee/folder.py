"""Plain files of a run folder: JSON, results, copies of its input files."""

import hashlib
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from angler_mjx.errors import ConfigError

NUMBER_COLUMNS = (
    "path_length_m",
    "energy_j",
    "min_clearance_m",
    "min_separation_m",
    "time_to_goal_s",
    "failure_time_s",
    "failure_x_m",
    "failure_y_m",
    "failure_z_m",
    "impact_speed_mps",
)
TASK_NUMBER_COLUMNS = ("jobs_done", "task_progress", "task_completed_s")
"""Further number columns of runs with a task."""
CONTACT_NUMBER_COLUMNS = ("impact_energy_j", "contact_depth_m")
"""Further number columns of runs in which bodies push each other."""
CARRY_NUMBER_COLUMNS = ("grip_force_n", "internal_force_n", "cargo_distance_m", "cargo_angle_rad")
"""Further number columns of runs whose robots hold a body together."""
TEXT_COLUMNS = ("vehicle", "parameter_set", "outcome", "failure_pair")
"""Text columns of ``episodes.parquet`` that are judged."""

OPTIONAL_COLUMNS = ("variant", "planned", "passed_goal_early")
"""Columns that older runs, or runs written by other programs, may lack."""

type Row = dict[str, Any]
"""Results of one robot of one world; missing numbers are NaN."""


@contextmanager
def reporting_damage(path: Path) -> Iterator[None]:
    """Convert the exceptions of a damaged file to one message."""
    try:
        yield
    except ConfigError:
        raise
    except (OSError, ValueError, KeyError, TypeError, IndexError, RuntimeError) as error:
        message = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise ConfigError(f"{path}: cannot be judged: {message}") from error


def read_rows(path: Path, robots: int, more: Sequence[str] = ()) -> dict[int, list[Row]]:
    """Read the results of each world, a row for each robot.

    Args:
        path: of ``episodes.parquet``.
        robots: number of robots of each world.
        more: number columns beside those of all runs.

    Raises:
        ConfigError: the file is damaged, or a world has other rows.
    """
    numbers = (*NUMBER_COLUMNS, *more)
    with reporting_damage(path):
        optional = [name for name in OPTIONAL_COLUMNS if name in pq.read_schema(path).names]
        table = pq.read_table(path, columns=["world", "robot", *TEXT_COLUMNS, *numbers, *optional])
        table = table.sort_by([("world", "ascending"), ("robot", "ascending")])
        columns: dict[str, Sequence[object] | np.ndarray] = {
            "world": table["world"].to_numpy(),
            "robot": table["robot"].to_numpy(),
            **{name: table[name].to_pylist() for name in TEXT_COLUMNS},
            **{name: _to_numbers(table[name], name) for name in numbers},
            **{name: table[name].to_pylist() for name in optional},
        }
    columns.setdefault("passed_goal_early", [None] * table.num_rows)
    rows_by_world: dict[int, list[Row]] = {}
    for i in range(table.num_rows):
        row: Row = {name: values[i] for name, values in columns.items()}
        rows_by_world.setdefault(int(row["world"]), []).append(row)
    for world, rows in rows_by_world.items():
        if [int(row["robot"]) for row in rows] != list(range(robots)):
            raise ConfigError(f"{path}: world {world} has not one row for each of {robots} robots")
    return rows_by_world


def _to_numbers(column: pa.ChunkedArray, name: str) -> np.ndarray:
    """Convert a column to numbers; a robot without others is infinitely far from them."""
    numbers = column.cast(pa.float64())
    if name == "min_separation_m":
        numbers = numbers.fill_null(float("inf"))
    values: np.ndarray = numbers.to_numpy()
    return values


def read_copies(folder: Path) -> dict[str, Path]:
    """Return the vehicle files of the run, by their names in its scenario.

    Raises:
        ConfigError: the list is damaged, or a copy has changed.
    """
    if not folder.exists():
        return {}
    index = folder / "inputs.json"
    copies = {}
    with reporting_damage(index):
        for entry in read_json(index)["files"]:
            relative = PurePosixPath(entry["copy_path"])
            if relative.is_absolute() or ".." in relative.parts:
                raise ConfigError(f"{index}: {entry['copy_path']!r} leads out of the folder")
            path = folder / relative
            if hashlib.sha256(path.read_bytes()).hexdigest() != entry["copy_sha256"]:
                raise ConfigError(f"{path}: is not the copy that the run made; put that one back")
            if entry["role"] == "vehicle":
                copies[str(entry["named"])] = path
    return copies


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object.

    Raises:
        ConfigError: the file is missing or holds no object.
    """
    with reporting_damage(path):
        table = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(table, dict):
            raise ValueError("it is no JSON object")
        return table
