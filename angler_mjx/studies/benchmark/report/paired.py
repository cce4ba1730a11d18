"""Two planners on the same problems: who succeeds more often, and at what cost.

The difference of two success rates has Newcombe's interval for paired data, and the exact p of
McNemar's test (`angler_mjx.studies.paired`). Ratios of costs are medians over problems that both
solved, those of planning time over problems that both planned, with percentiles of a bootstrap that
resamples whole worlds (Efron and Tibshirani 1993), always with the same seed.

The report's page holds these comparisons for every selection of its reader
(`angler_mjx.studies.benchmark.report.selections`).
"""

import csv
import io
import itertools
import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from angler_mjx.studies.benchmark.report.rates import FEW
from angler_mjx.studies.benchmark.report.reading import Results, Runs
from angler_mjx.studies.paired import mcnemar, newcombe

RATIOS = {"planning_s": "planned", "makespan_s": "success", "energy_j": "success"}
"""Costs whose ratios are taken, and what both must have done."""
RESAMPLES = 1000
_SEED = 1
_STEP, _MASK = 0x6D2B79F5, 0xFFFFFFFF
"""Increment and word of the generator mulberry32."""


@dataclass(frozen=True, kw_only=True)
class PairedRatio:
    """Median ratio of a cost, first planner over second."""

    median: float
    low: float
    high: float
    pairs: int

    @property
    def few(self) -> bool:
        """Whether it rests on few problems."""
        return self.pairs < FEW


@dataclass(frozen=True, kw_only=True)
class PairedComparison:
    """Two planners over the problems that both were asked.

    Success is having planned for every robot while nothing has been flown.
    """

    first: str
    second: str
    both: int
    only_first: int
    only_second: int
    neither: int
    difference: float
    """Success rate of the first minus that of the second; NaN without a common problem."""
    low: float
    high: float
    p: float
    ratios: dict[str, PairedRatio]

    @property
    def pairs(self) -> int:
        """Common problems."""
        return self.both + self.only_first + self.only_second + self.neither

    @property
    def few(self) -> bool:
        """Whether it rests on few problems."""
        return self.pairs < FEW


def compare_planners(results: Results, first: str, second: str) -> PairedComparison:
    """Compare two planners.

    Args:
        results: of a benchmark.
        first: label.
        second: label.
    """
    return compare_rows(
        results.runs, results.problem, results.world, results.judged, (first, second)
    )


def compare_rows(
    runs: Runs, problem: np.ndarray, world: np.ndarray, judged: str, planners: tuple[str, str]
) -> PairedComparison:
    """Compare two planners over some rows of a benchmark.

    Args:
        runs: rows.
        problem: int [n] problem of each row.
        world: int [n] world of each row.
        judged: column that rates are of.
        planners: labels.
    """
    rows = [np.flatnonzero((runs["planner"] == name) & runs.counted) for name in planners]
    first_problems, second_problems = (problem[at] for at in rows)
    _, i, j = np.intersect1d(first_problems, second_problems, return_indices=True)
    a, b = rows[0][i], rows[1][j]
    won = runs[judged]
    counts = (
        int(np.sum(won[a] & won[b])),
        int(np.sum(won[a] & ~won[b])),
        int(np.sum(~won[a] & won[b])),
        int(np.sum(~won[a] & ~won[b])),
    )
    low, high = newcombe(*counts)
    ratios = {}
    for cost, needs in RATIOS.items():
        x, y = runs[cost][a], runs[cost][b]
        with np.errstate(invalid="ignore"):
            used = runs[needs][a] & runs[needs][b] & (x > 0) & (y > 0)
        ratios[cost] = bootstrap_ratio(np.log(x[used] / y[used]), world[a][used])
    return PairedComparison(
        first=planners[0],
        second=planners[1],
        both=counts[0],
        only_first=counts[1],
        only_second=counts[2],
        neither=counts[3],
        difference=(counts[1] - counts[2]) / len(a) if len(a) else math.nan,
        low=low,
        high=high,
        p=mcnemar(counts[1], counts[2]),
        ratios=ratios,
    )


def bootstrap_ratio(logs: np.ndarray, world: np.ndarray) -> PairedRatio:
    """Return the median ratio with its 95 % percentile bootstrap interval.

    Args:
        logs: [n] logarithms of ratios.
        world: int [n] the world of each; whole worlds are resampled.
    """
    if len(logs) == 0:
        return PairedRatio(median=math.nan, low=math.nan, high=math.nan, pairs=0)
    order = np.argsort(logs, kind="stable")
    ordered, world_index = logs[order], np.unique(world, return_inverse=True)[1][order]
    counts = _resample_worlds(int(world_index.max()) + 1, RESAMPLES)[:, world_index]
    ends = np.cumsum(counts, axis=1, dtype=np.int32)
    total = ends[:, -1:]
    lower = ordered[np.sum(ends <= (total - 1) // 2, axis=1)]
    upper = ordered[np.sum(ends <= total // 2, axis=1)]
    low, high = np.exp(np.quantile((lower + upper) / 2, [0.025, 0.975]))
    median = float(np.exp(np.median(logs)))
    return PairedRatio(median=median, low=float(low), high=float(high), pairs=len(logs))


@lru_cache(maxsize=64)
def _resample_worlds(worlds: int, times: int) -> np.ndarray:
    """Return how often each world is chosen in each resample, int [times, worlds].

    mulberry32 (T. Ettinger, public domain): its state is a counter, so all numbers come at once.
    """
    state = (_SEED + np.arange(1, times * worlds + 1, dtype=np.uint64) * _STEP) & _MASK
    mixed = ((state ^ (state >> 15)) * (state | 1)) & _MASK
    mixed = ((mixed + ((mixed ^ (mixed >> 7)) * (mixed | 61) & _MASK)) & _MASK) ^ mixed
    chosen = (((mixed ^ (mixed >> 14)) / 2**32) * worlds).astype(np.int64)
    row = np.repeat(np.arange(times), worlds)
    counts = np.bincount(row * worlds + chosen, minlength=times * worlds).astype(np.int32)
    return counts.reshape(times, worlds)


def format_pairs_csv(results: Results) -> str:
    """All pairs of planners over all of their common problems, as CSV."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    head = ["first", "second", "problems", "both", "only_first", "only_second", "neither"]
    head += ["difference", "low", "high", "mcnemar_p"]
    for cost in RATIOS:
        head += [f"{cost}_ratio", f"{cost}_ratio_low", f"{cost}_ratio_high", f"{cost}_pairs"]
    writer.writerow([*head, "few"])
    for first, second in itertools.combinations(results.planners, 2):
        comparison = compare_planners(results, first, second)
        row: list[object] = [
            first,
            second,
            comparison.pairs,
            comparison.both,
            comparison.only_first,
            comparison.only_second,
        ]
        row += [
            comparison.neither,
            *(f"{x:.4f}" for x in (comparison.difference, comparison.low, comparison.high)),
        ]
        row += [f"{comparison.p:.3g}"]
        for paired_ratio in comparison.ratios.values():
            row += [
                *(f"{x:.4g}" for x in (paired_ratio.median, paired_ratio.low, paired_ratio.high)),
                paired_ratio.pairs,
            ]
        writer.writerow([*row, "yes" if comparison.few else "no"])
    return out.getvalue()
