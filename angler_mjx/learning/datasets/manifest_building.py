"""Manifest of a dataset, collected from its parts."""

import datetime
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import pyarrow as pa

from angler_mjx.learning.datasets.config import DatasetConfig
from angler_mjx.learning.datasets.manifest import ArrayEntry, Manifest, PartEntry
from angler_mjx.learning.datasets.parts import DatasetPart
from angler_mjx.runs.provenance import describe_environment
from angler_mjx.runs.storage import folder, input_copies, trajectory_layout


def build_manifest(config: DatasetConfig, parts: Sequence[DatasetPart], root: Path) -> Manifest:
    """Build the manifest of a dataset, without counts of its index and checksums of its files.

    Args:
        config: the dataset file.
        parts: flown parts.
        root: folder of the dataset.

    Raises:
        ConfigError: a run is damaged.
    """
    runs = [folder.Run(root / part.path) for part in parts]
    first = runs[0]
    return Manifest(
        name=config.name,
        description=config.description,
        licence=config.licence,
        created=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        command=shlex.join(["angler", *sys.argv[1:]]),
        episodes=sum(run.scenario.worlds for run in runs),
        splits={},
        sample=config.sample,
        split_shares=config.split.model_dump(),
        parts=tuple(
            PartEntry(
                path=part.path,
                scene=part.scene,
                expert=part.expert,
                robots=part.robots,
                worlds=run.scenario.worlds,
                seed=run.scenario.seed,
                split=part.split,
                digest=run.scenario.digest(),
                tile=run.scenario.tile or run.scenario.worlds,
                kernels=run.scenario.kernels,
            )
            for part, run in zip(parts, runs, strict=True)
        ),
        conventions={
            key: str(value)
            for key, value in dict(first.trajectories.attrs).items()
            if isinstance(value, str)
        },
        arrays=_describe_arrays(first),
        time={
            "record_hz": first.scenario.time.record_hz,
            "control_dt_s": first.scenario.time.control_dt_s,
            "physics_dt_s": first.scenario.time.physics_dt_s,
        },
        seeds={
            "dataset": config.seed,
            "keys": str(jax.config.jax_default_prng_impl),
            "of_parts": "first 31 bits of SHA-256 of 'angler dataset SEED part NUMBER'",
            "of_worlds": "the part's key folded with the world's index",
        },
        parameter_sets=_collect_parameter_sets(runs),
        environment=describe_environment(),
        sums="0" * 64,
    )


def add_counts(manifest: Manifest, table: pa.Table) -> Manifest:
    """Return a manifest with the counts of the index.

    Args:
        manifest: the manifest.
        table: the index.
    """
    return manifest.model_copy(
        update={
            "episodes": len(table),
            "splits": count_values(table, "split"),
            "chosen": count_values(table.filter(table["chosen"]), "split"),
        }
    )


def count_values(table: pa.Table, column: str) -> dict[str, int]:
    """Count the values of a column of text, by value."""
    value_counts = table[column].value_counts().to_pylist()
    return dict(sorted((entry["values"], entry["counts"]) for entry in value_counts))


def _describe_arrays(run: folder.Run) -> dict[str, ArrayEntry]:
    stored: Any = run.trajectories
    entries = {}
    for name, kind in trajectory_layout.ARRAYS.items():
        if name in stored:
            stepped = kind.dims[:1] == ("time",) and kind.dtype is not None
            step = run.scenario.store.step(kind.unit, kind.dims) if stepped else None
            entries[name] = ArrayEntry(
                dims=("world", *kind.dims),
                unit=kind.unit,
                description=kind.text,
                dtype=str(stored[name].dtype),
                step=step if str(stored[name].dtype) == "float32" else None,
            )
    return entries


def _collect_parameter_sets(runs: Sequence[folder.Run]) -> dict[str, str]:
    """Return the checksums of the vehicle and thruster files of all parts."""
    checksums: dict[str, str] = {}
    for run in runs:
        for entry in input_copies.read_inputs(run.path):
            if entry.role in (input_copies.VEHICLE, input_copies.THRUSTER):
                checksums[entry.named] = entry.sha256
    return dict(sorted(checksums.items()))
