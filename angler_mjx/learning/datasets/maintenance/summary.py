"""Summary of a dataset in numbers."""

from pathlib import Path
from typing import TypedDict

import numpy as np
import pyarrow as pa

from angler_mjx.learning.datasets import index, manifest
from angler_mjx.learning.datasets.dataset import Dataset, open_dataset
from angler_mjx.runs.storage import folder, trajectory_layout

MEASURES = ("duration_s", "energy_j", "density", "path_ratio", "samples")
"""Columns of the index with reported quantiles."""


class GroupStats(TypedDict):
    """Episodes of a group."""

    episodes: int
    success: float
    """Fraction of teams that arrive whole."""
    planned: float
    """Fraction of robots with a plan."""


class Moments(TypedDict):
    """Mean and standard deviation of each component; None where no robot has it."""

    mean: list[float | None]
    std: list[float | None]


class Quantiles(TypedDict):
    """Quantiles over episodes."""

    p10: float
    p50: float
    p90: float


class DatasetStats(TypedDict):
    """Counts and statistics of a dataset."""

    name: str
    episodes: int
    chosen: int
    """Number of chosen episodes."""
    robots: int
    bytes: int
    outcomes: dict[str, int]
    """Robots by outcome."""
    by: dict[str, dict[str, GroupStats]]
    """Groups by column and value."""
    quantiles: dict[str, Quantiles]
    """By column of the index."""
    fields: dict[str, Moments]
    fields_by_vehicle: dict[str, dict[str, Moments]]
    """Fields whose components are thrusters, where there are several vehicles."""


def compute_stats(root: Path, max_episodes: int = 1000) -> DatasetStats:
    """Return counts by split, scene, expert and outcome, quantiles, and normalisation of fields.

    Fields of thrusters are grouped by vehicle, where several fly: a column is another thruster in
    each.

    Args:
        root: folder of the dataset.
        max_episodes: episodes of train that are read for means and deviations.

    Raises:
        ConfigError: the folder is no dataset, or is damaged.
    """
    dataset_manifest, table = manifest.read_manifest(root), index.read_index(root)
    n_byte = sum(path.stat().st_size for path in root.rglob("*") if path.is_file())
    outcomes: dict[str, int] = {}
    for part in dataset_manifest.parts:
        for name in folder.Run(root / part.path).episodes["outcome"].to_pylist():
            outcomes[name] = outcomes.get(name, 0) + 1
    split = "train" if "train" in dataset_manifest.splits else None
    data: Dataset = open_dataset(root, split=split)
    has_many_vehicles = len(data.vehicles) > 1
    return {
        "name": dataset_manifest.name,
        "episodes": dataset_manifest.episodes,
        "chosen": sum(dataset_manifest.chosen.values()),
        "robots": int(np.sum(table["robots"].to_numpy())),
        "bytes": n_byte,
        "outcomes": outcomes,
        "by": {
            column: _count_by(table, column)
            for column in ("split", "scene", "expert", "difficulty")
        },
        "quantiles": {name: _compute_quantiles(table[name].to_numpy()) for name in MEASURES},
        "fields": {
            name: _to_plain_moments(mean, std)
            for name, (mean, std) in data.statistics(max_episodes).items()
            if not (has_many_vehicles and _is_per_thruster(name))
        },
        "fields_by_vehicle": {
            vehicle: {
                name: _to_plain_moments(mean, std)
                for name, (mean, std) in data.statistics(max_episodes, vehicle=vehicle).items()
                if _is_per_thruster(name)
            }
            for vehicle in (data.vehicles if has_many_vehicles else ())
        },
    }


def _is_per_thruster(name: str) -> bool:
    """Return whether the components of a field are thrusters, which differ between vehicles."""
    return trajectory_layout.ARRAYS[name].dims[-1] == "thruster"


def _to_plain_moments(mean: np.ndarray, std: np.ndarray) -> Moments:
    """Return both as plain numbers, None where no robot has the component."""
    plain_mean, plain_std = (
        [None if np.isnan(x) else float(x) for x in values] for values in (mean, std)
    )
    return Moments(mean=plain_mean, std=plain_std)


def _count_by(table: pa.Table, column: str) -> dict[str, GroupStats]:
    """Count episodes, arrived teams and planned robots, by a column's values."""
    names = np.array(table[column].to_pylist())
    success = table["success"].to_numpy(zero_copy_only=False)
    planned, robots = (table[name].to_numpy() for name in ("planned", "robots"))
    return {
        name: {
            "episodes": int((names == name).sum()),
            "success": float(success[names == name].mean()),
            "planned": float(planned[names == name].sum() / robots[names == name].sum()),
        }
        for name in sorted(set(names.tolist()))
    }


def _compute_quantiles(values: np.ndarray) -> Quantiles:
    ten, half, ninety = np.quantile(values, [0.1, 0.5, 0.9])
    return {"p10": float(ten), "p50": float(half), "p90": float(ninety)}
