"""Files against their sums, parts against the manifest, values against what they can be."""

import os
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from angler_mjx.errors import ConfigError
from angler_mjx.learning.datasets import index, sums
from angler_mjx.learning.datasets.manifest import SPLITS, Manifest, PartEntry
from angler_mjx.learning.datasets.reading.stored import StoredArray
from angler_mjx.learning.datasets.verifying.report import DatasetCheck
from angler_mjx.runs.storage import folder
from angler_mjx.runs.storage.folder import Run
from angler_mjx.sim.state import Outcome

MOST_MPS, MOST_RADPS = 20.0, 50.0
"""Of a vehicle: what is faster has diverged."""
FARTHEST_M = 30_000.0
PWM_US = (1100.0, 1900.0)
WORLDS = 16
"""Looked at by one thread at a time."""


def files(place: Path, manifest: Manifest) -> DatasetCheck:
    """Every file against its sum."""
    check = DatasetCheck(name="files")
    said = sums.read(place, manifest.sums)
    there = set(sums.files(place))
    for name in sorted(said.keys() - there):
        check.wrong(name, "is missing; copy it again, or mend it with angler dataset repair")
    for name in sorted(there - said.keys()):
        check.wrong(name, "is no file of the dataset; move it elsewhere")
    names = sorted(there & said.keys())
    for name, digest in sums.of_files(place, names):
        if digest != said[name]:
            check.wrong(
                name,
                "was changed or damaged (its SHA-256 differs); copy it again, or mend the "
                "dataset with angler dataset repair",
            )
    check.looked_at, check.exact = f"{len(names):,} files", len(names)
    return check


def parts(place: Path, manifest: Manifest) -> DatasetCheck:
    """Every part against what the manifest says of it."""
    check = DatasetCheck(name="parts")
    for part in manifest.parts:
        try:
            run = Run(place / part.path)
            scenario = run.scenario
            stored: Any = run.trajectories  # whose schema is checked there
            summary = run.summary
        except ConfigError as error:
            check.wrong(part.path, str(error))
            continue
        said = {
            "worlds": (part.worlds, scenario.worlds),
            "seed": (part.seed, scenario.seed),
            "robots": (part.robots, len(scenario.members())),
            "digest": (part.digest, scenario.digest()),
            "record_hz": (manifest.time["record_hz"], scenario.time.record_hz),
            "complete": (True, summary.get("complete")),
            folder.VARIANTS: (
                "there" if scenario.randomise.of_vehicles else "none",
                "there" if (place / part.path / folder.VARIANTS).is_file() else "none",
            ),
            "arrays": (set(), manifest.arrays.keys() - _names(stored)),
        }
        for key, (wanted, found) in said.items():
            if wanted != found:
                check.wrong(part.path, f"{key} is {found!r}, and the manifest says {wanted!r}")
    check.looked_at, check.exact = f"{len(manifest.parts)} run folders", len(manifest.parts)
    return check


def _names(stored: Any) -> set[str]:
    return {name for name, _ in stored.members(max_depth=None)}


def rows(place: Path, manifest: Manifest, table: pa.Table) -> DatasetCheck:
    """The index made again of the parts, and its splits."""
    check = DatasetCheck(name="index", looked_at=f"{len(table):,} episodes", exact=len(table))
    try:
        made = index.of_manifest(place, manifest)
    except ConfigError as error:
        check.wrong("runs", str(error))
        return check
    if len(made) != len(table) or len(made) != manifest.episodes:
        check.wrong("index.parquet", f"has {len(table)} rows; the parts have {len(made)} episodes")
        return check
    for name in made.schema.names:
        if made[name].to_pylist() != table[name].to_pylist():
            check.wrong(
                f"index.parquet, {name}",
                "is not what the parts give; copy it again, or make the dataset again where an "
                "earlier version of angler-mjx made it",
            )
    if (pair := index.shared_environment(table)) is not None:
        check.wrong("index.parquet", f"splits {pair[0]} and {pair[1]} share environment {pair[2]}")
    unknown = {s for s in table["split"].to_pylist() if s not in SPLITS and s[:5] != "test_"}
    if unknown:
        check.wrong("index.parquet", f"knows splits that are none: {', '.join(sorted(unknown))}")
    return check


def values(place: Path, manifest: Manifest) -> DatasetCheck:
    """Every sample against what it can be."""
    check = DatasetCheck(name="values")
    worlds = samples = 0
    with ThreadPoolExecutor(min(os.cpu_count() or 1, 16)) as pool:
        for part in manifest.parts:
            try:
                stored = {
                    name: StoredArray(place / part.path / folder.TRAJECTORIES / name)
                    for name in _LOOKED
                }
                look = partial(_some, stored, part, manifest)
                for looked in pool.map(look, range(0, part.worlds, WORLDS)):
                    for name, what in looked.faults:
                        check.wrong(f"{part.path}/{folder.TRAJECTORIES}/{name}", what)
                    worlds += looked.worlds
                    samples += looked.samples
            except ConfigError as error:
                check.wrong(part.path, str(error))
    check.looked_at = f"{samples:,} samples of robots in {worlds:,} worlds"
    check.bounded, check.why = samples, "each against the range that it can have"
    return check


_LOOKED = ("p_m", "q", "nu", "pwm_us", "outcome", "current_mps", "target_m")
"""Arrays whose values are looked at."""


@dataclass(frozen=True)
class _Looked:
    """What some worlds came to."""

    worlds: int
    samples: int
    faults: list[tuple[str, str]]
    """Name of an array, and what is wrong in it."""


def _some(
    stored: Mapping[str, StoredArray], part: PartEntry, manifest: Manifest, first: int
) -> _Looked:
    """Worlds of a part from number ``first`` on, `WORLDS` of them at most."""
    here = range(first, min(first + WORLDS, part.worlds))
    got = {name: np.stack([array.read(i) for i in here]) for name, array in stored.items()}
    return _Looked(len(here), got["p_m"].size // 3, list(_values(first, got, manifest)))


def _values(
    first: int, got: Mapping[str, np.ndarray], manifest: Manifest
) -> Iterator[tuple[str, str]]:
    """Faults of some worlds: [w, t, r, ...]."""
    outcome = got["outcome"].astype(int)
    known = np.isfinite(got["p_m"]).all(-1)  # NaN after the tile had ended
    running = known & (outcome == 0)
    step = manifest.arrays["q"].step or 0.0
    pwm = got["pwm_us"]
    faults = {
        "p_m": running & (np.abs(got["p_m"]) > FARTHEST_M).any(-1),
        "q": known
        & (outcome != Outcome.DIVERGED)
        & ~np.isclose(np.linalg.norm(got["q"], axis=-1), 1.0, atol=1e-4 + 2.0 * step),
        "nu": running
        & (
            (np.abs(got["nu"][..., :3]) > MOST_MPS).any(-1)
            | (np.abs(got["nu"][..., 3:]) > MOST_RADPS).any(-1)
        ),
        "pwm_us": known
        & ((pwm != 0.0) & ((pwm < PWM_US[0] - 0.5) | (pwm > PWM_US[1] + 0.5))).any(-1),
        "outcome": (outcome > max(Outcome)),
        "current_mps": running & ~(np.abs(got["current_mps"]) <= MOST_MPS).all(-1),
        "target_m": running & ~np.isfinite(got["target_m"]).all(-1),
    }
    back = np.diff(outcome, axis=1)
    faults["outcome"][:, 1:] |= (back != 0) & (outcome[:, :-1] != 0)
    for name, fault in faults.items():
        if fault.any():
            world, time, robot = np.argwhere(fault)[0]
            value = np.asarray(got[name][world, time, robot]).tolist()
            yield (
                name,
                f"world {first + world}, sample {time}, robot {robot}: {value} cannot be "
                f"({int(fault.sum())} such samples)",
            )
