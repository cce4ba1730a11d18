"""Statistics of features as LeRobot 3.0 stores them: of each episode, and of all of them.

Its editing tools (delete, split, merge) aggregate the statistics of the episodes that are left: a
dataset without them leaves its policies nothing to normalise by.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
"""By the names of LeRobot's statistics."""
NAMES = ("min", "max", "mean", "std", "count", *QUANTILES)
"""Statistics of a feature, in LeRobot's order."""

type Statistics = dict[str, np.ndarray]
"""Values [width] of a feature by the names of `NAMES`; ``count`` is [1]."""


def compute_statistics(rows: np.ndarray) -> Statistics:
    """Return the statistics of a feature over one episode.

    A quantile is the smallest value that the fraction of the samples does not exceed: LeRobot's own
    are that value to a bin of its histogram, the range over 5,000.

    Args:
        rows: [samples, width], at least one sample.
    """
    rows = rows.astype(float)
    quantiles = np.quantile(rows, list(QUANTILES.values()), axis=0, method="inverted_cdf")
    return {
        "min": rows.min(axis=0),
        "max": rows.max(axis=0),
        "mean": rows.mean(axis=0),
        "std": rows.std(axis=0),
        "count": np.array([len(rows)]),
        **dict(zip(QUANTILES, quantiles, strict=True)),
    }


def aggregate_statistics(episodes: Iterable[Statistics]) -> Statistics:
    """Return the statistics of a feature over several episodes, as LeRobot aggregates them.

    Mean and standard deviation are those of all samples. Quantiles are the means of the episodes'
    quantiles, weighted by samples.
    """
    stacked = [np.stack(values) for values in zip(*map(_ordered_values, episodes), strict=True)]
    by_name = dict(zip(NAMES, stacked, strict=True))
    count = by_name["count"]
    total = count.sum(axis=0)
    mean = (by_name["mean"] * count).sum(axis=0) / total
    variance = ((by_name["std"] ** 2 + (by_name["mean"] - mean) ** 2) * count).sum(axis=0) / total
    return {
        "min": by_name["min"].min(axis=0),
        "max": by_name["max"].max(axis=0),
        "mean": mean,
        "std": np.sqrt(variance),
        "count": total,
        **{name: (by_name[name] * count).sum(axis=0) / total for name in QUANTILES},
    }


def _ordered_values(statistics: Statistics) -> list[np.ndarray]:
    return [statistics[name] for name in NAMES]


def build_columns(features: Mapping[str, Statistics]) -> dict[str, Any]:
    """Return the columns of an episode's row: ``stats/FEATURE/NAME``, lists of numbers."""
    return {
        f"stats/{feature}/{name}": values.tolist()
        for feature, statistics in features.items()
        for name, values in statistics.items()
    }
