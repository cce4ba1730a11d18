"""Checks of files against their checksums, of parts against the manifest, and of values."""

import os
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa

from angler_mjx.errors import ConfigError
from angler_mjx.learning.datasets import checksums, index
from angler_mjx.learning.datasets.manifest import SPLITS, Manifest, PartEntry
from angler_mjx.learning.datasets.stored import StoredArray
from angler_mjx.learning.datasets.verifying.report import DatasetCheck
from angler_mjx.runs.storage import environments, folder
from angler_mjx.runs.storage.checksums import compare_files
from angler_mjx.runs.storage.folder import Run
from angler_mjx.sim.state import Outcome

MAX_SPEED_MPS, MAX_RATE_RADPS = 20.0, 50.0
"""Limits of a vehicle's motion; faster means divergence."""
MAX_DISTANCE_M = 30_000.0
PWM_US = (1100.0, 1900.0)
WORLDS_PER_TASK = 16
"""Number of worlds of a thread's task."""


def check_files(root: Path, manifest: Manifest) -> DatasetCheck:
    """Check every file against its checksum."""
    check = DatasetCheck(name="files")
    digests = checksums.read_checksums(root, manifest.sums)
    differences = compare_files(root, digests, checksums.list_files(root))
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


def check_parts(root: Path, manifest: Manifest) -> DatasetCheck:
    """Check every part against the manifest."""
    check = DatasetCheck(name="parts")
    for part in manifest.parts:
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


def check_index(root: Path, manifest: Manifest, table: pa.Table) -> DatasetCheck:
    """Check the index against one computed anew from the parts, and its splits."""
    check = DatasetCheck(name="index", looked_at=f"{len(table):,} episodes", exact=len(table))
    try:
        rebuilt = index.build_index(root, manifest)
    except ConfigError as error:
        check.add_finding("runs", str(error))
        return check
    if len(rebuilt) != len(table) or len(rebuilt) != manifest.episodes:
        check.add_finding(
            "index.parquet", f"has {len(table)} rows; the parts have {len(rebuilt)} episodes"
        )
        return check
    for name in rebuilt.schema.names:
        if rebuilt[name].to_pylist() != table[name].to_pylist():
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


def check_values(root: Path, manifest: Manifest) -> DatasetCheck:
    """Check every sample against its physical limits."""
    check = DatasetCheck(name="values")
    worlds = samples = 0
    with ThreadPoolExecutor(min(os.cpu_count() or 1, 16)) as pool:
        for part in manifest.parts:
            try:
                stored = {
                    name: StoredArray(root / part.path / folder.TRAJECTORIES / name)
                    for name in _CHECKED_ARRAYS
                }
                check_from = partial(_check_worlds, stored, part, manifest)
                for checked in pool.map(check_from, range(0, part.worlds, WORLDS_PER_TASK)):
                    for name, fault in checked.faults:
                        check.add_finding(f"{part.path}/{folder.TRAJECTORIES}/{name}", fault)
                    worlds += checked.worlds
                    samples += checked.samples
            except ConfigError as error:
                check.add_finding(part.path, str(error))
    check.looked_at = f"{samples:,} samples of robots in {worlds:,} worlds"
    check.bounded, check.why = samples, "each against the range that it can have"
    return check


_CHECKED_ARRAYS = ("p_m", "q", "nu", "pwm_us", "outcome", "current_mps", "target_m")
"""Arrays with checked values."""


@dataclass(frozen=True)
class _CheckedWorlds:
    """Results of some worlds."""

    worlds: int
    samples: int
    faults: list[tuple[str, str]]
    """Name of an array, and the fault in it."""


def _check_worlds(
    stored: Mapping[str, StoredArray], part: PartEntry, manifest: Manifest, first: int
) -> _CheckedWorlds:
    """Check worlds of a part from number ``first`` on, at most `WORLDS_PER_TASK`."""
    worlds = range(first, min(first + WORLDS_PER_TASK, part.worlds))
    arrays = {name: np.stack([array.read(i) for i in worlds]) for name, array in stored.items()}
    return _CheckedWorlds(
        len(worlds), arrays["p_m"].size // 3, list(_find_faults(first, arrays, manifest))
    )


def _find_faults(
    first: int, arrays: Mapping[str, np.ndarray], manifest: Manifest
) -> Iterator[tuple[str, str]]:
    """Yield the faults of some worlds: [w, t, r, ...]."""
    outcome = arrays["outcome"].astype(int)
    is_finite = np.isfinite(arrays["p_m"]).all(-1)  # NaN after the tile had ended
    running = is_finite & (outcome == 0)
    step = manifest.arrays["q"].step or 0.0
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
