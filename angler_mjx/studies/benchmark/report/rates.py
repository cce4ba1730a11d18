"""Success rates: of cells, by team and by density, with Wilson's 95 % intervals.

Rates count only the rows that a mask selects: in the table of cells those that a planner got, in
charts also those it did not get because it had been given up, which count as failures. Each run
is a world of its own, so runs of one planner and team are independent; Wilson's interval (JASA 22,
1927) holds as it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from angler_mjx.runs.storage.confidence_intervals import wilson_interval
from angler_mjx.studies.benchmark.report.reading import Runs

FEW = 10
"""Runs, or pairs, below which a number is said to rest on few."""

_MAX_BINS = 6


@dataclass(frozen=True, kw_only=True)
class ReportRate:
    """Fraction of the selected runs that are hits."""

    count: int
    requested: int
    low: float
    high: float

    @property
    def fraction(self) -> float:
        """NaN where none was asked."""
        return self.count / self.requested if self.requested else float("nan")

    @property
    def few(self) -> bool:
        """Whether so few were asked that the interval says little."""
        return self.requested < FEW


def compute_rate(hit: np.ndarray, requested: np.ndarray) -> ReportRate:
    """Return the fraction of the selected rows that are hits.

    Args:
        hit: bool [n].
        requested: bool [n].
    """
    count, total = int(np.sum(hit & requested)), int(np.sum(requested))
    low, high = wilson_interval(count, total)
    return ReportRate(count=count, requested=total, low=low, high=high)


def compute_rates(
    groups: Sequence[np.ndarray], hit: np.ndarray, requested: np.ndarray
) -> dict[tuple[object, ...], ReportRate]:
    """Rates of groups of rows.

    Args:
        groups: [n] each; rows that agree in all of them are a group.
        hit: bool [n].
        requested: bool [n].
    """
    return {
        key: compute_rate(hit[rows], requested[rows])
        for key, rows in group_rows(*(values.tolist() for values in groups)).items()
    }


def group_rows(*columns: Sequence[object]) -> dict[tuple[object, ...], np.ndarray]:
    """Indices of the rows of each combination of values, in order of appearance."""
    rows_by_key: dict[tuple[object, ...], list[int]] = {}
    for i, key in enumerate(zip(*columns, strict=True)):
        rows_by_key.setdefault(key, []).append(i)
    return {key: np.array(rows) for key, rows in rows_by_key.items()}


@dataclass(frozen=True, kw_only=True)
class DensityBins:
    """Densities of rock in bins that hold about as many problems each."""

    edges: np.ndarray
    """[b + 1]; a bin holds its lower edge, the last one both."""
    centres: np.ndarray
    """[b] mean density of the rows in it."""
    of: np.ndarray
    """int [n] bin of each row."""


def build_density_bins(runs: Runs, problem: np.ndarray) -> DensityBins:
    """Bins of density, by quantiles of the problems; of few densities each its own.

    Args:
        runs: rows.
        problem: int [n] which problem each row is.
    """
    density = np.nan_to_num(runs["density"])
    densities = density[np.unique(problem, return_index=True)[1]]
    distinct = np.unique(densities)
    if len(distinct) <= _MAX_BINS:
        edges = np.r_[distinct, distinct[-1]]
    else:
        edges = np.unique(np.quantile(densities, np.linspace(0.0, 1.0, _MAX_BINS + 1)))
    bin_of_row = np.clip(np.searchsorted(edges, density, side="right") - 1, 0, len(edges) - 2)
    members = [density[bin_of_row == i] for i in range(len(edges) - 1)]
    centres = np.array([values.mean() if len(values) else np.nan for values in members])
    return DensityBins(edges=edges, centres=centres, of=bin_of_row)
