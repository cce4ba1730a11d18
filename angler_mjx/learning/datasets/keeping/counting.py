"""What is in a dataset, in numbers."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from angler_mjx.learning.datasets import index, manifest
from angler_mjx.learning.datasets.reading.dataset import Dataset, open_dataset
from angler_mjx.runs.storage import folder, layout

MEASURES = ("duration_s", "energy_j", "density", "path_ratio", "samples")
"""Columns of the index of which quantiles are told."""


def stats(place: Path, most: int = 1000) -> dict[str, Any]:
    """Return counts by split, scene, expert and outcome, quantiles, and what normalises fields.

    Fields of thrusters stand by vehicle, where several fly: a column is another thruster in each.

    Args:
        place: of the dataset.
        most: episodes of train that are read for means and deviations.

    Raises:
        ConfigError: it is none, or damaged.
    """
    found, table = manifest.read(place), index.read(place)
    n_byte = sum(path.stat().st_size for path in place.rglob("*") if path.is_file())
    outcomes: dict[str, int] = {}
    for part in found.parts:
        for name in folder.Run(place / part.path).episodes["outcome"].to_pylist():
            outcomes[name] = outcomes.get(name, 0) + 1
    learned = "train" if "train" in found.splits else None
    data: Dataset = open_dataset(place, split=learned)
    several = len(data.vehicles) > 1
    return {
        "name": found.name,
        "episodes": found.episodes,
        "chosen": sum(found.chosen.values()),
        "robots": int(np.sum(table["robots"].to_numpy())),
        "bytes": n_byte,
        "outcomes": outcomes,
        "by": {column: _by(table, column) for column in ("split", "scene", "expert", "difficulty")},
        "quantiles": {name: _quantiles(table[name].to_numpy()) for name in MEASURES},
        "fields": {
            name: _moments(mean, std)
            for name, (mean, std) in data.statistics(most).items()
            if not (several and _of_thrusters(name))
        },
        "fields_by_vehicle": {
            vehicle: {
                name: _moments(mean, std)
                for name, (mean, std) in data.statistics(most, vehicle=vehicle).items()
                if _of_thrusters(name)
            }
            for vehicle in (data.vehicles if several else ())
        },
    }


def _of_thrusters(name: str) -> bool:
    """Return whether the components of a field are thrusters, which differ between vehicles."""
    return layout.ARRAYS[name].dims[-1] == "thruster"


def _moments(mean: np.ndarray, std: np.ndarray) -> dict[str, list[float | None]]:
    """Return both as plain numbers, None where no robot has the component."""
    return {
        name: [None if np.isnan(x) else float(x) for x in values]
        for name, values in (("mean", mean), ("std", std))
    }


def _by(table: pa.Table, column: str) -> dict[str, dict[str, float]]:
    """Episodes, fractions of teams that arrive and of robots with a plan, by a column's values."""
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


def _quantiles(values: np.ndarray) -> Mapping[str, float]:
    ten, half, ninety = np.quantile(values, [0.1, 0.5, 0.9])
    return {"p10": float(ten), "p50": float(half), "p90": float(ninety)}
