"""Checks of files against their checksums, of parts against the manifest, and of values."""

from collections.abc import Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa

from angler_mjx.errors import ConfigError
from angler_mjx.learning.datasets import checksums, index
from angler_mjx.learning.datasets.manifest import SPLITS, Manifest
from angler_mjx.learning.datasets.stored import StoredArray
from angler_mjx.learning.datasets.verifying.carrying import (
    END_ARRAYS,
    GRIP_ARRAYS,
    POSE_ARRAYS,
    GripCheck,
)
from angler_mjx.learning.datasets.verifying.joints import (
    JointBounds,
    find_bounds,
    find_joint_faults,
)
from angler_mjx.learning.datasets.verifying.report import DatasetCheck
from angler_mjx.progress import Progress
from angler_mjx.runs.storage import environments, folder
from angler_mjx.runs.storage.checksums import compare_files
from angler_mjx.runs.storage.folder import Run
from angler_mjx.runs.storage.parallel import cpu_count, map_in_order
from angler_mjx.runs.storage.trajectory_layout import TIME_ARRAY
from angler_mjx.sim.state import Outcome

MAX_SPEED_MPS, MAX_RATE_RADPS = 20.0, 50.0
"""Limits of a vehicle's motion; faster means divergence."""
MAX_DISTANCE_M = 30_000.0
PWM_US = (1100.0, 1900.0)
WORLDS_PER_FINDING = 16
"""Number of worlds that are read at once; each of their arrays has one finding at most."""
WORLDS_PER_TASK = 16 * WORLDS_PER_FINDING
"""Number of worlds of a process' task."""
MIN_TASKS_PER_PROCESS = 8
"""Number of tasks below which a process takes longer to start than to work."""


def check_files(root: Path, manifest: Manifest, progress: Progress) -> DatasetCheck:
    """Check every file against its checksum."""
    check = DatasetCheck(name="files")
    digests = checksums.read_checksums(root, manifest.sums)
    progress.start(len(digests), unit="files")
    progress.describe("files")
    differences = compare_files(root, digests, checksums.list_files(root), progress)
    for name in differences.missing:
        check.add_finding(name, "is missing; copy it again, or mend it with angler dataset repair")
    for name in differences.foreign:
        check.add_finding(name, "is no file of the dataset; move it elsewhere")
    for name in differences.changed:
        check.add_finding(
            name,
            "was changed or damaged (its SHA-256 differs); copy it again, or mend the "
            "dataset with angler dataset repair",
        )
    check.looked_at, check.exact = f"{differences.compared:,} files", differences.compared
    return check


def check_parts(root: Path, manifest: Manifest, progress: Progress) -> DatasetCheck:
    """Check every part against the manifest."""
    check = DatasetCheck(name="parts")
    progress.start(len(manifest.parts), unit="parts")
    progress.describe("parts")
    for part in manifest.parts:
        progress.advance(1)
        try:
            run = Run(root / part.path)
            scenario = run.scenario
            stored = environments.list_arrays(run.trajectories)
            summary = run.summary
        except ConfigError as error:
            check.add_finding(part.path, str(error))
            continue
        expected = {
            "worlds": (part.worlds, scenario.worlds),
            "seed": (part.seed, scenario.seed),
            "robots": (part.robots, len(scenario.members())),
            "digest": (part.digest, scenario.digest()),
            "record_hz": (manifest.time["record_hz"], scenario.time.record_hz),
            "complete": (True, summary.get("complete")),
            folder.VARIANTS: (
                "there" if scenario.randomise.changes_vehicles else "none",
                "there" if (root / part.path / folder.VARIANTS).is_file() else "none",
            ),
            "arrays": (set(), manifest.arrays.keys() - stored.keys()),
        }
        for key, (expected_value, actual) in expected.items():
            if expected_value != actual:
                check.add_finding(
                    part.path, f"{key} is {actual!r}, and the manifest says {expected_value!r}"
                )
    check.looked_at, check.exact = f"{len(manifest.parts)} run folders", len(manifest.parts)
    return check


def check_index(
    root: Path, manifest: Manifest, table: pa.Table, progress: Progress
) -> DatasetCheck:
    """Check the index against one computed anew from the parts, and its splits."""
    check = DatasetCheck(name="index", looked_at=f"{len(table):,} episodes", exact=len(table))
    progress.start(manifest.episodes, unit="episodes")
    progress.describe("index")
    try:
        rebuilt = index.build_index(root, manifest, progress)
    except ConfigError as error:
        check.add_finding("runs", str(error))
        return check
    if len(rebuilt) != len(table) or len(rebuilt) != manifest.episodes:
        check.add_finding(
            "index.parquet", f"has {len(table)} rows; the parts have {len(rebuilt)} episodes"
        )
        return check
    for name in rebuilt.schema.names:
        if not rebuilt[name].equals(table[name]):
            check.add_finding(
                f"index.parquet, {name}",
                "is not what the parts give; copy it again, or make the dataset again where an "
                "earlier version of angler-mjx made it",
            )
    if (pair := index.find_shared_environment(table)) is not None:
        check.add_finding(
            "index.parquet", f"splits {pair[0]} and {pair[1]} share environment {pair[2]}"
        )
    unknown = {s for s in table["split"].to_pylist() if s not in SPLITS and s[:5] != "test_"}
    if unknown:
        check.add_finding(
            "index.parquet", f"knows splits that are none: {', '.join(sorted(unknown))}"
        )
    return check


def count_processes(manifest: Manifest, workers: int | None) -> int:
    """Return the number of processes that check the values of a dataset.

    Args:
        manifest: manifest of the dataset.
        workers: requested number; if None, as many as the processors and the episodes are worth.
    """
    tasks = len(_split_tasks(manifest))
    return min(tasks, workers or min(cpu_count(), tasks // MIN_TASKS_PER_PROCESS))


def check_values(
    root: Path, manifest: Manifest, pool: Executor | None, progress: Progress
) -> DatasetCheck:
    """Check every sample against its physical limits.

    Args:
        root: folder of the dataset.
        manifest: its manifest.
        pool: processes that read; None reads in this one.
        progress: receives the number of episodes.

    Raises:
        RunError: a process was killed.
    """
    check = DatasetCheck(name="values")
    progress.start(manifest.episodes, unit="episodes")
    progress.describe("values")
    worlds = samples = 0
    broken: set[str] = set()
    tasks = _split_tasks(manifest)
    check_task = partial(_check_task, root, manifest.arrays["q"].step or 0.0)
    for (path, _), checked in zip(tasks, map_in_order(check_task, tasks, pool), strict=True):
        progress.advance(checked.worlds)
        if path in broken:
            continue
        for name, fault in checked.faults:
            check.add_finding(f"{path}/{folder.TRAJECTORIES}/{name}", fault)
        worlds += checked.worlds
        samples += checked.samples
        if checked.error:
            check.add_finding(path, checked.error)
            broken.add(path)
    check.looked_at = f"{samples:,} samples of robots in {worlds:,} worlds"
    check.bounded, check.why = samples, "each against the range that it can have"
    return check


_CHECKED_ARRAYS = ("p_m", "q", "nu", "pwm_us", "outcome", "current_mps", "target_m")
"""Arrays with checked values."""
_JOINT_ARRAYS = ("joint_position", "joint_velocity")
"""Likewise, of fleets with arms."""

type _Task = tuple[str, range]
"""Path of a part, and neighbouring worlds of it."""


def _split_tasks(manifest: Manifest) -> list[_Task]:
    """Return the worlds of all parts, at most `WORLDS_PER_TASK` in each."""
    return [
        (part.path, range(first, min(first + WORLDS_PER_TASK, part.worlds)))
        for part in manifest.parts
        for first in range(0, part.worlds, WORLDS_PER_TASK)
    ]


@dataclass(kw_only=True)
class _CheckedWorlds:
    """Results of some worlds."""

    worlds: int = 0
    samples: int = 0
    faults: list[tuple[str, str]] = field(default_factory=list)
    """Name of an array, and the fault in it."""
    error: str = ""
    """Reason why the other worlds cannot be read; empty where all were."""


def _check_task(root: Path, step: float, task: _Task) -> _CheckedWorlds:
    """Check worlds of a part, `WORLDS_PER_FINDING` at a time, until some cannot be read.

    Args:
        root: folder of the dataset.
        step: step of stored quaternions; 0 where they are stored exactly.
        task: the worlds.
    """
    path, worlds = task
    checked = _CheckedWorlds()
    try:
        part = root / path / folder.TRAJECTORIES
        has_joints = (part / _JOINT_ARRAYS[0]).is_dir()
        grips = GripCheck.of(Run(root / path)) if (part / GRIP_ARRAYS[0]).is_dir() else None
        names = (
            *_CHECKED_ARRAYS,
            *(_JOINT_ARRAYS if has_joints else ()),
            *((*GRIP_ARRAYS, *POSE_ARRAYS) if grips is not None else ()),
        )
        stored = {name: StoredArray(part / name) for name in names}
        ends = {name: StoredArray(part / name) for name in END_ARRAYS if grips is not None}
        joints = _JointCheck.of(Run(root / path), stored) if has_joints else None
        for first in worlds[::WORLDS_PER_FINDING]:
            last = min(first + WORLDS_PER_FINDING, worlds.stop)
            arrays = {name: array.read_worlds(first, last) for name, array in stored.items()}
            checked.faults += _find_faults(first, arrays, step, joints, grips)
            if grips is not None:
                last_states = {name: array.read_worlds(first, last) for name, array in ends.items()}
                checked.faults += _find_wrong_errors(grips, first, arrays, last_states)
            checked.worlds += last - first
            checked.samples += arrays["p_m"].size // 3
    except ConfigError as error:
        checked.error = str(error)
    return checked


@dataclass(frozen=True)
class _JointCheck:
    """What the joints of a part's worlds are checked against."""

    bounds: JointBounds
    time_s: np.ndarray
    """[t] of the samples."""

    @classmethod
    def of(cls, run: Run, stored: Mapping[str, StoredArray]) -> "_JointCheck":
        """Return the check of a part."""
        joints = stored[_JOINT_ARRAYS[0]].shape[-1]
        time_s = np.asarray(run.trajectories.get_array(TIME_ARRAY)[:], float)
        return cls(find_bounds(run.scenario.members(), joints), time_s)

    def find_faults(
        self, arrays: Mapping[str, np.ndarray], running: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Return the faulty samples of some worlds; see `find_joint_faults`."""
        position, velocity = (arrays[name] for name in _JOINT_ARRAYS)
        return find_joint_faults(self.bounds, self.time_s, position, velocity, running)


def _find_faults(
    first: int,
    arrays: Mapping[str, np.ndarray],
    step: float,
    joints: _JointCheck | None,
    grips: GripCheck | None,
) -> Iterator[tuple[str, str]]:
    """Yield the faults of some worlds: [w, t, r, ...]; see `_check_task`."""
    outcome = arrays["outcome"].astype(int)
    is_finite = np.isfinite(arrays["p_m"]).all(-1)  # NaN after the tile had ended
    running = is_finite & (outcome == 0)
    pwm = arrays["pwm_us"]
    faults = {
        "p_m": running & (np.abs(arrays["p_m"]) > MAX_DISTANCE_M).any(-1),
        "q": is_finite
        & (outcome != Outcome.DIVERGED)
        & ~np.isclose(np.linalg.norm(arrays["q"], axis=-1), 1.0, atol=1e-4 + 2.0 * step),
        "nu": running
        & (
            (np.abs(arrays["nu"][..., :3]) > MAX_SPEED_MPS).any(-1)
            | (np.abs(arrays["nu"][..., 3:]) > MAX_RATE_RADPS).any(-1)
        ),
        "pwm_us": is_finite
        & ((pwm != 0.0) & ((pwm < PWM_US[0] - 0.5) | (pwm > PWM_US[1] + 0.5))).any(-1),
        "outcome": (outcome > max(Outcome)),
        "current_mps": running & ~(np.abs(arrays["current_mps"]) <= MAX_SPEED_MPS).all(-1),
        "target_m": running & ~np.isfinite(arrays["target_m"]).all(-1),
    }
    if joints is not None:
        faults |= joints.find_faults(arrays, running)
    if grips is not None:
        faults |= grips.find_faults(arrays, running)
    changed = np.diff(outcome, axis=1)
    faults["outcome"][:, 1:] |= (changed != 0) & (outcome[:, :-1] != 0)
    for name, fault in faults.items():
        if fault.any():
            world, time, robot = np.argwhere(fault)[0]
            value = np.asarray(arrays[name][world, time, robot]).tolist()
            yield (
                name,
                f"world {first + world}, sample {time}, robot {robot}: {value} cannot be "
                f"({int(fault.sum())} such samples)",
            )


def _find_wrong_errors(
    grips: GripCheck,
    first: int,
    arrays: Mapping[str, np.ndarray],
    ends: Mapping[str, np.ndarray],
) -> Iterator[tuple[str, str]]:
    """Yield the columns that differ from the last state of a held body; see `_check_task`."""
    start_q = arrays["obstacle_q"][:, 0, grips.cargo.body]
    for name, wrong in grips.find_wrong_errors(first, start_q, ends).items():
        if wrong.any():
            world, robot = np.argwhere(wrong)[0]
            value = grips.columns[name][first + world, robot]
            yield (
                f"../{folder.EPISODES}, {name}",
                f"world {first + world}, robot {robot}: {value:g} is not that of the body's last "
                f"state ({int(wrong.sum())} such robots)",
            )
