"""Recordings of the Hinsdale campaign of August 2023, read into runs.

A run is three CSV files with one stem, ``*_mocap.csv``, ``*_imu.csv`` and ``*_joint_states.csv``,
and a metadata file with the time at which the arm was commanded to move. Columns are read by name.
Quaternions are stored xyzw and become wxyz here; the campaign's axes are those of the simulator (x
forward, y left, z up), its angles radians, its lengths metres.
"""

import csv
import hashlib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from angler_mjx.errors import ConfigError, format_value

type Array = np.ndarray

SOURCE = "folder data/hinsdale-data-2023 of the public repository hkolano/UVMS-SysID-with-EAs"
"""Origin of the files, for messages."""

JOINTS = ("axis_e", "axis_d", "axis_c", "axis_b")
"""Joints of the arm from its base to its wrist; ``axis_a`` is the gripper."""

SUFFIXES = ("mocap", "imu", "joint_states")
"""Ends of the names of a run's files."""

_TIME = "time_secs"
_POSITION = ("x_pose", "y_pose", "z_pose")
_QUATERNION = ("w_ori", "x_ori", "y_ori", "z_ori")
_RATE = ("x_angvel", "y_angvel", "z_angvel")
_JOINT_POSITION = tuple(f"{joint}_pos" for joint in JOINTS)
_JOINT_VELOCITY = tuple(f"{joint}_vel" for joint in JOINTS)
_MAX_QUATERNION_ERROR = 0.01
_MAX_TIME_S = 3600.0


@dataclass(frozen=True, kw_only=True)
class PoseTrack:
    """Poses of the vehicle by motion capture or by its inertial unit."""

    t_s: Array
    """[n] time, increasing."""
    p_m: Array
    """[n, 3] position; zero of the inertial unit."""
    q: Array
    """[n, 4] unit attitude wxyz, vehicle to world."""
    blank_rows: int
    """Rows that were left out because a field was blank."""
    repeated_rows: int
    """Rows that were left out because their time was not after that of the row before."""


@dataclass(frozen=True, kw_only=True)
class JointTrack:
    """Recorded motion of the arm."""

    t_s: Array
    """[n] time, increasing."""
    position_rad: Array
    """[n, 4] in the order of `JOINTS`, as recorded."""
    velocity_radps: Array
    """[n, 4] as recorded."""
    blank_rows: int
    repeated_rows: int


@dataclass(frozen=True, kw_only=True)
class Run:
    """One release of the vehicle."""

    stem: str
    mocap: PoseTrack
    imu: PoseTrack
    joints: JointTrack
    start_s: float | None
    """Time of the arm's command; None for runs with the arm at rest."""
    copy_of: str | None
    """Stem of the run that has the same recording; None for a recording of its own."""


def read_campaign(folder: Path) -> list[Run]:
    """Read all runs of a folder, sorted by stem.

    A run whose motion capture lies within that of another run is marked as its copy.

    Raises:
        ConfigError: the folder or a file of a run is missing, or a file holds other columns or
            units than the campaign's.
    """
    stems = find_stems(folder)
    runs = [_read_run(folder, stem) for stem in stems]
    copies = _find_copies(runs)
    return [
        Run(**{**vars(run), "copy_of": copies[run.stem]}) if run.stem in copies else run
        for run in runs
    ]


def find_stems(folder: Path) -> list[str]:
    """Return the stems of the runs in a folder, sorted.

    Raises:
        ConfigError: the folder is missing or holds no run, or a run lacks one of its files.
    """
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder; the recordings are in {SOURCE}")
    names = {path.name for path in folder.glob("*.csv")}
    pattern = re.compile(rf"(.+)_({'|'.join(SUFFIXES)})\.csv")
    matches = [match for match in map(pattern.fullmatch, names) if match]
    stems = sorted({match[1] for match in matches})
    if not stems:
        raise ConfigError(f"{folder}: no file *_mocap.csv; the recordings are in {SOURCE}")
    missing = [
        f"{stem}_{suffix}.csv"
        for stem in stems
        for suffix in SUFFIXES
        if f"{stem}_{suffix}.csv" not in names
    ]
    if missing:
        raise ConfigError(
            f"{folder / missing[0]}: missing, though the run has other files"
            f"{f' ({len(missing)} files are missing)' if len(missing) > 1 else ''}; "
            f"complete runs are in {SOURCE}"
        )
    return stems


def _read_run(folder: Path, stem: str) -> Run:
    paths = {suffix: folder / f"{stem}_{suffix}.csv" for suffix in SUFFIXES}
    return Run(
        stem=stem,
        mocap=_read_poses(paths["mocap"], _POSITION),
        imu=_read_poses(paths["imu"], ()),
        joints=_read_joints(paths["joint_states"]),
        start_s=_read_start(folder, stem),
        copy_of=None,
    )


def _read_poses(path: Path, position: Sequence[str]) -> PoseTrack:
    """Read a track of attitudes, with positions if their columns are named."""
    table, blank, repeated = _read_table(path, (_TIME, *_QUATERNION, *position))
    q = table[:, 1:5]
    norm = np.linalg.norm(q, axis=1)
    if np.any(np.abs(norm - 1.0) > _MAX_QUATERNION_ERROR):
        row = int(np.argmax(np.abs(norm - 1.0)))
        raise ConfigError(
            f"{path}: column w_ori: attitude of length {norm[row]:.3g} at "
            f"{table[row, 0]:.3f} s; unit quaternions are wanted; see {SOURCE}"
        )
    p = table[:, 5:] if position else np.zeros((len(q), 3))
    return PoseTrack(
        t_s=table[:, 0], p_m=p, q=q / norm[:, None], blank_rows=blank, repeated_rows=repeated
    )


def _read_joints(path: Path) -> JointTrack:
    table, blank, repeated = _read_table(path, (_TIME, *_JOINT_POSITION, *_JOINT_VELOCITY))
    position = table[:, 1:5]
    if np.abs(position).max() > 4.0 * math.pi:
        column = _JOINT_POSITION[int(np.argmax(np.abs(position).max(axis=0)))]
        raise ConfigError(
            f"{path}: column {column}: {np.abs(position).max():.4g} is no angle in radians; "
            f"see {SOURCE}"
        )
    return JointTrack(
        t_s=table[:, 0],
        position_rad=position,
        velocity_radps=table[:, 5:],
        blank_rows=blank,
        repeated_rows=repeated,
    )


def _read_table(path: Path, columns: Sequence[str]) -> tuple[Array, int, int]:
    """Read columns by name; the first is time in seconds.

    Returns:
        Values [n, column] with increasing time, number of rows with blanks, number of rows whose
        time does not increase.
    """
    with path.open(newline="") as file:
        rows = list(csv.reader(file))
    indices = _find_columns(path, rows[0] if rows else [], columns)
    cells = [[row[i] if i < len(row) else "" for i in indices] for row in rows[1:]]
    is_full = [all(cell.strip() for cell in row) for row in cells]
    full = [(i, row) for i, (row, keep) in enumerate(zip(cells, is_full, strict=True)) if keep]
    values = np.array([_parse_row(path, i + 2, columns, row) for i, row in full])
    if len(values) < 2:
        raise ConfigError(f"{path}: column {columns[0]}: fewer than two full rows; see {SOURCE}")
    span = values[:, 0].max() - values[:, 0].min()
    if not span < _MAX_TIME_S:
        raise ConfigError(
            f"{path}: column {columns[0]}: spans {span:.4g}, too long for a run in seconds; "
            f"see {SOURCE}"
        )
    latest = np.maximum.accumulate(values[:, 0])
    keep = np.concatenate([[True], values[1:, 0] > latest[:-1]])
    return values[keep], len(cells) - len(full), int((~keep).sum())


def _find_columns(path: Path, header: Sequence[str], columns: Sequence[str]) -> list[int]:
    names = [name.strip() for name in header]
    for column in columns:
        if column not in names:
            raise ConfigError(
                f"{path}: no column {column}; there is {', '.join(names) or 'no header'}; "
                f"see {SOURCE}"
            )
    return [names.index(column) for column in columns]


def _parse_row(path: Path, line: int, columns: Sequence[str], row: Sequence[str]) -> list[float]:
    values = []
    for column, cell in zip(columns, row, strict=True):
        try:
            value = float(cell)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise ConfigError(
                f"{path}: column {column}: {format_value(cell)} in line {line} is no number; "
                f"see {SOURCE}"
            )
        values.append(value)
    return values


def _read_start(folder: Path, stem: str) -> float | None:
    """Return ``start_time`` [s] of a run's metadata; None without metadata."""
    path = folder / f"metadata_{stem.removeprefix('traj').removesuffix('-test')}.yml"
    if not path.exists():
        return None
    match = re.search(r"^start_time:\s*(\S+)\s*$", path.read_text(), re.MULTILINE)
    try:
        return float(match[1] if match else "")
    except ValueError:
        raise ConfigError(f"{path}: key start_time: no number of seconds; see {SOURCE}") from None


def _find_copies(runs: Sequence[Run]) -> dict[str, str]:
    """Return the stem of the original for each run whose positions are those of another run.

    The copy is the run whose joint states are recorded over the longer time: the start of an
    original is cut off there, so that its metadata fits.
    """
    originals: dict[str, Run] = {}
    copies = {}
    for run in sorted(runs, key=lambda run: (np.ptp(run.joints.t_s), run.stem)):
        key = hashlib.sha256(run.mocap.p_m[-100:].tobytes()).hexdigest()
        if key in originals:
            copies[run.stem] = originals[key].stem
        else:
            originals[key] = run
    return copies
