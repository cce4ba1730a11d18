"""Success rates: of cells, by team and by density, with Wilson's 95 % intervals.

Rates count only the rows that a mask selects: in the table of cells those that a planner got, in
charts also those it did not get because it had been given up, which count as failures. Each run
is a world of its own, so runs of one planner and team are independent; Wilson's interval (JASA 22,
1927) holds as it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from angler_mjx.runs.storage.intervals import wilson
from angler_mjx.studies.benchmark.report.reading import Runs

FEW = 10
"""Runs, or pairs, below which a number is said to rest on few."""

_MOST_BINS = 6


@dataclass(frozen=True, kw_only=True)
class ReportRate:
    """Fraction of the selected runs that are hits."""

    count: int
    asked: int
    closed: int
    """Runs of the same kind outside the mask."""
    low: float
    high: float

    @property
    def share(self) -> float:
        """NaN where none was asked."""
        return self.count / self.asked if self.asked else float("nan")

    @property
    def few(self) -> bool:
        """Whether so few were asked that the interval says little."""
        return self.asked < FEW


def rate(hit: np.ndarray, asked: np.ndarray) -> ReportRate:
    """Return the fraction of the selected rows that are hits.

    Args:
        hit: bool [n].
        asked: bool [n].
    """
    count, total = int(np.sum(hit & asked)), int(np.sum(asked))
    low, high = wilson(count, total)
    return ReportRate(count=count, asked=total, closed=len(asked) - total, low=low, high=high)


def by(
    groups: Sequence[np.ndarray], hit: np.ndarray, asked: np.ndarray
) -> dict[tuple[Any, ...], ReportRate]:
    """Rates of groups of rows.

    Args:
        groups: [n] each; rows that agree in all of them are a group.
        hit: bool [n].
        asked: bool [n].
    """
    return {
        key: rate(hit[rows], asked[rows])
        for key, rows in grouped(*(values.tolist() for values in groups)).items()
    }


def grouped(*columns: Sequence[object]) -> dict[tuple[Any, ...], np.ndarray]:
    """Indices of the rows of each combination of values, in order of appearance."""
    found: dict[tuple[Any, ...], list[int]] = {}
    for i, key in enumerate(zip(*columns, strict=True)):
        found.setdefault(key, []).append(i)
    return {key: np.array(rows) for key, rows in found.items()}


@dataclass(frozen=True, kw_only=True)
class Bins:
    """Densities of rock in bins that hold about as many problems each."""

    edges: np.ndarray
    """[b + 1]; a bin holds its lower edge, the last one both."""
    centres: np.ndarray
    """[b] mean density of the rows in it."""
    of: np.ndarray
    """int [n] bin of each row."""


def density_bins(runs: Runs, problem: np.ndarray) -> Bins:
    """Bins of density, by quantiles of the problems; of few densities each its own.

    Args:
        runs: rows.
        problem: int [n] which problem each row is.
    """
    density = np.nan_to_num(runs["density"])
    once = density[np.unique(problem, return_index=True)[1]]
    distinct = np.unique(once)
    if len(distinct) <= _MOST_BINS:
        edges = np.r_[distinct, distinct[-1]]
    else:
        edges = np.unique(np.quantile(once, np.linspace(0.0, 1.0, _MOST_BINS + 1)))
    of = np.clip(np.searchsorted(edges, density, side="right") - 1, 0, len(edges) - 2)
    held = [density[of == i] for i in range(len(edges) - 1)]
    centres = np.array([values.mean() if len(values) else np.nan for values in held])
    return Bins(edges=edges, centres=centres, of=of)
