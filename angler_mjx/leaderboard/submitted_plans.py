"""Files of plans of submissions, read without trust in any of it.

What is wrong with a file makes its problems fail, with the reason.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from angler_mjx.errors import AnglerError, ConfigError, format_value
from angler_mjx.leaderboard.problem_files import SetRecord
from angler_mjx.leaderboard.problem_sets import ProblemSet
from angler_mjx.leaderboard.submission import find_special_file
from angler_mjx.robot.control.commands.joint_trajectory import CUBIC, LINEAR
from angler_mjx.runs.storage.plans.read import GROUND, SCHEMA, SCHEMA_VERSION, SPEED_LIMIT
from angler_mjx.runs.storage.read_errors import wrap_read_errors
from angler_mjx.scenario.scenario import Scenario

MAX_FILE_POINTS = 1024
"""Points of a path that are read; a file with wider arrays is refused."""

MAX_NOTE = 200
"""Characters of a reason of a file that are read."""

_OPTIONAL_WIDTHS = {"yaw_rad": 0, "velocity": 4, "acceleration": 4, "degree": 0}
"""Optional arrays of a file of plans, with the size of the axis behind that of the points."""


@dataclass(frozen=True, kw_only=True)
class PlanRows:
    """Plans of the problems of a set, of one shape whatever the file had."""

    arrays: Mapping[str, np.ndarray]
    """``points`` int32 [world, robot], ``time_s`` float32 [world, robot, point], ``position_m``
    float32 [world, robot, point, 3], and optional arrays of the file."""
    planning_s: np.ndarray
    """float [world], as stated or measured; NaN if unknown."""
    faults: Sequence[str] = field(default=())
    """Reason of each problem that has no usable plan as a whole; empty texts for others."""
    notes: Mapping[tuple[int, int], str] = field(default_factory=dict)
    """What the file says of why robots have no path, by problem and robot."""


def store_rows(path: Path, rows: PlanRows) -> None:
    """Write the plans of a set with their times and faults, to go on with after an interruption."""
    partial = path.with_suffix(".partial.npz")
    arrays: dict[str, Any] = {f"plan/{name}": values for name, values in rows.arrays.items()}
    np.savez(partial, planning_s=rows.planning_s, faults=np.array(rows.faults, str), **arrays)
    partial.replace(path)


def load_rows(path: Path) -> PlanRows:
    """Read what `store_rows` wrote."""
    with np.load(path, allow_pickle=False) as stored:
        arrays = {
            name.removeprefix("plan/"): stored[name]
            for name in stored.files
            if name.startswith("plan/")
        }
        return PlanRows(
            arrays=arrays, planning_s=stored["planning_s"], faults=stored["faults"].tolist()
        )


def empty_rows(entry: ProblemSet, reason: str) -> PlanRows:
    """Return rows without a path, whose problems all fail for a reason."""
    shape = (entry.problems, entry.robots)
    return PlanRows(
        arrays={
            "points": np.zeros(shape, np.int32),
            "time_s": np.zeros((*shape, 2), np.float32),
            "position_m": np.zeros((*shape, 2, 3), np.float32),
        },
        planning_s=np.full(entry.problems, np.nan),
        faults=[reason] * entry.problems,
    )


def read_plans(
    path: Path, entry: ProblemSet, record: SetRecord, seed: int, max_points: int
) -> PlanRows:
    """Read the plans of a set; what cannot be used has a reason instead.

    Args:
        path: of the file of plans.
        entry: the set.
        record: of it, in the manifest.
        seed: attribute of the files of its problems; see `problem_files.printed_seed`.
        max_points: points that a path may have.
    """
    if not path.exists():
        return empty_rows(entry, f"{path.name} is missing")
    if path.is_symlink() or (special := find_special_file(path, links=False)):
        name = path.name if path.is_symlink() else special
        return empty_rows(entry, f"{name} is a link, pipe or device")
    try:
        with wrap_read_errors(Path(path.name)):
            return _read_group(path, entry, record, seed, max_points)
    except AnglerError as error:
        return empty_rows(entry, str(error))


def _read_group(
    path: Path, entry: ProblemSet, record: SetRecord, seed: int, max_points: int
) -> PlanRows:
    group = zarr.open_group(path, mode="r")
    attributes = dict(group.attrs)
    if (attributes.get("schema"), attributes.get("schema_version")) != (SCHEMA, SCHEMA_VERSION):
        raise ConfigError(f"{path.name}: holds no plans of schema version {SCHEMA_VERSION}")
    if attributes.get("digest") != record.digest:
        raise ConfigError(
            f"{path.name}: digest is {format_value(str(attributes.get('digest'))[:12])}, that of "
            f"the problems is {record.digest[:12]}: its plans are of other problems"
        )
    if attributes.get("seed") != seed:  # not printed: results are published
        raise ConfigError(
            f"{path.name}: seed is missing or not {seed}, that of the problems: its plans are of "
            "others"
        )
    if "sha256" in attributes and attributes["sha256"] != list(record.sha256):
        raise ConfigError(f"{path.name}: sha256 differs from that of the frozen problems")
    shapes = {name: np.shape(array) for name, array in group.arrays()}
    rows = (entry.problems, entry.robots)
    points = shapes["time_s"][-1] if len(shapes.get("time_s", ())) == 3 else 0
    if not 2 <= points <= MAX_FILE_POINTS:
        raise ConfigError(
            f"{path.name}: time_s must be [world, robot, point] with 2 to {MAX_FILE_POINTS} points"
        )
    expected = {"points": rows, "time_s": (*rows, points), "position_m": (*rows, points, 3)}
    for name, width in _OPTIONAL_WIDTHS.items():
        if name in shapes:
            expected[name] = (*rows, points, width)[: 4 if width else 3]
    if "planning_s" in shapes:
        expected["planning_s"] = rows[:1]
    for name, shape in expected.items():
        if shapes.get(name) != shape:
            raise ConfigError(
                f"{path.name}/{name}: has the shape {shapes.get(name)}; must be {shape}"
            )
    if len(expected.keys() & _OPTIONAL_WIDTHS.keys()) and "yaw_rad" not in expected:
        raise ConfigError(f"{path.name}: has velocity, acceleration or degree without yaw_rad")
    arrays, damage = _read_arrays(path, group, list(expected), entry.problems)
    planning_s = arrays.pop("planning_s", np.full(entry.problems, np.nan))
    limited = _limit_points(arrays, planning_s.astype(float), max_points, damage)
    limited = _require_straight(limited)
    return replace(limited, notes=_read_notes(group, shapes.get("reason") == rows))


def _read_notes(group: zarr.Group, has_reasons: bool) -> dict[tuple[int, int], str]:
    """Read why robots have no path; nothing where the file does not say it as it should."""
    texts = group.attrs.get("reasons")
    if not has_reasons or not isinstance(texts, list):
        return {}
    try:
        with wrap_read_errors(Path("reason")):
            index = np.asarray(group.get_array("reason")[:]).astype(int)
    except AnglerError:
        return {}
    return {
        (world, robot): "".join(c for c in str(texts[at])[:MAX_NOTE] if c.isprintable())
        for (world, robot), at in np.ndenumerate(index)
        if 0 <= at < len(texts)
    }


def _read_arrays(
    path: Path, group: zarr.Group, names: Sequence[str], problems: int
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Read arrays, and the damage of each problem; problem by problem where the whole has some."""
    damage = [""] * problems
    arrays = {}
    for name in names:
        array = group.get_array(name)
        try:
            with wrap_read_errors(Path(path.name) / name):
                arrays[name] = np.asarray(array[:])
        except AnglerError:
            rows = np.zeros(array.shape, array.dtype)
            for world in range(problems):
                try:
                    with wrap_read_errors(Path(path.name) / name):
                        rows[world] = array[world]
                except AnglerError as error:
                    damage[world] = damage[world] or str(error)
            arrays[name] = rows
    return arrays, damage


def _limit_points(
    arrays: dict[str, np.ndarray],
    planning_s: np.ndarray,
    max_points: int,
    damage: Sequence[str],
) -> PlanRows:
    """Take out paths that are too long, and columns that no path needs any more."""
    counts = arrays["points"].astype(np.int64)
    is_long = counts > max_points
    faults = []
    for world, (row, points) in enumerate(zip(is_long, counts, strict=True)):
        text = damage[world]
        if row.any() and not text:
            robot = int(np.argmax(row))
            text = f"robot {robot}: path of {points[robot]} points, at most {max_points}"
        stated = planning_s[world]
        if np.isinf(stated) or stated < 0.0:
            text = text or f"planning_s is {stated:g}"
        faults.append(text)
    arrays["points"] = np.where(is_long, 0, np.clip(counts, 0, max_points)).astype(np.int32)
    cut = {
        name: values if name == "points" else values[:, :, :max_points]
        for name, values in arrays.items()
    }
    types = {"points": np.int32, "degree": np.int32}
    with np.errstate(over="ignore", invalid="ignore"):
        typed = {name: values.astype(types.get(name, np.float32)) for name, values in cut.items()}
    return PlanRows(arrays=typed, planning_s=planning_s, faults=faults)


def _require_straight(rows: PlanRows) -> PlanRows:
    """Take out problems with a path that bends between its points, and what would bend it."""
    arrays = dict(rows.arrays)
    velocity, _, degree = (
        arrays.pop(name, None) for name in ("velocity", "acceleration", "degree")
    )
    if degree is None:
        if velocity is None:
            return rows
        degree = np.full(arrays["time_s"].shape, CUBIC)  # as files of plans have it
    # A point's degree is of the segment that begins there: the last one has none.
    is_segment = np.arange(degree.shape[-1]) < arrays["points"][..., None] - 1
    is_bent = np.any(is_segment & (degree > LINEAR), axis=-1)
    faults = list(rows.faults)
    for world in np.flatnonzero(is_bent.any(axis=-1)):
        robot = int(np.argmax(is_bent[world]))
        faults[world] = faults[world] or (
            f"robot {robot}: path with velocities or of a degree above {LINEAR}; paths lead "
            "straight from point to point"
        )
    arrays["points"] = np.where(is_bent, 0, arrays["points"])
    return replace(rows, arrays=arrays, faults=faults)


def write_plans(path: Path, scenario: Scenario, rows: PlanRows) -> None:
    """Write plans of a set as a file for `runs.rollout`, with the true seed of its worlds.

    Args:
        path: to make.
        scenario: of the set.
        rows: the plans.
    """
    group = zarr.open_group(path, mode="w")
    group.attrs.update(
        {
            "schema": SCHEMA,
            "schema_version": SCHEMA_VERSION,
            "digest": scenario.digest(),
            "seed": scenario.seed,
            "scenario": scenario.name,
            SPEED_LIMIT: GROUND,
        }
    )
    is_fault = np.array([bool(fault) for fault in rows.faults])
    for name, values in rows.arrays.items():
        kept = np.where(is_fault[:, None], 0, values) if name == "points" else values
        group.create_array(name, data=kept)
    group.create_array("planning_s", data=rows.planning_s.astype(np.float32))
