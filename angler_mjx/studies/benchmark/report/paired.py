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
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from angler_mjx.studies.benchmark.report.rates import FEW
from angler_mjx.studies.benchmark.report.reading import Results
from angler_mjx.studies.paired import mcnemar, newcombe

RATIOS = {"planning_s": "planned", "makespan_s": "success", "energy_j": "success"}
"""Costs whose ratios are taken, and what both must have done."""
RESAMPLES = 1000
_SEED = 1
_STEP, _MASK = 0x6D2B79F5, 0xFFFFFFFF
"""Increment and word of the generator mulberry32."""
_MAX_CHUNK = 4000
"""Ratios that are resampled at once: a bound on memory."""

type Sample = tuple[np.ndarray, np.ndarray]
"""Logarithms of ratios [n], ascending, and the world int [n] of each, counted without gaps."""


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
    pair = (results.planners.index(first), results.planners.index(second))
    return compare_pairs(results, [results.run_table], [pair])[0][0]


def compare_pairs(
    results: Results, tables: Sequence[np.ndarray], pairs: Sequence[tuple[int, int]]
) -> list[list[PairedComparison]]:
    """Compare pairs of planners over several selections of runs.

    Args:
        results: of a benchmark.
        tables: int [planner, problem] rows of each selection, as `Results.run_table`.
        pairs: indices of two planners each.

    Returns:
        Comparison of each pair, by selection.
    """
    first, second = np.array(pairs, int).reshape(-1, 2).T
    samples = [
        sample
        for table in tables
        for cost in RATIOS
        for sample in _build_samples(results, table, cost, first, second)
    ]
    ratios = iter(bootstrap_ratios(samples))
    compared = []
    for table in tables:
        by_cost = {cost: list(itertools.islice(ratios, len(pairs))) for cost in RATIOS}
        counts = _count_pairs(results, table, first, second)
        compared.append(
            [
                _build_comparison(
                    (results.planners[i], results.planners[j]),
                    (*map(int, counts[k]),),
                    {cost: of_pairs[k] for cost, of_pairs in by_cost.items()},
                )
                for k, (i, j) in enumerate(pairs)
            ]
        )
    return compared


def _count_pairs(
    results: Results, table: np.ndarray, first: np.ndarray, second: np.ndarray
) -> np.ndarray:
    """Return the problems [pair, 4] that both solved, only the first, only the second, neither."""
    won = np.append(results.runs[results.judged], False)[table]
    a, b = won[first], won[second]
    is_common = (table[first] >= 0) & (table[second] >= 0)
    outcomes = (a & b, a & ~b & is_common, ~a & b & is_common, ~a & ~b & is_common)
    return np.stack([np.sum(outcome, axis=1) for outcome in outcomes], axis=1)


def _build_samples(
    results: Results, table: np.ndarray, cost: str, first: np.ndarray, second: np.ndarray
) -> list[Sample]:
    """Return the ratios of a cost of each pair, over the problems on which both have it."""
    values = results.runs[cost]
    has_cost = results.runs[RATIOS[cost]] & (values > 0)
    costs = np.append(np.where(has_cost, values, np.nan), np.nan)[table]
    logs = np.log(costs[first] / costs[second])
    pair, problem = np.nonzero(~np.isnan(logs))
    worlds, world = np.unique(results.world[table.max(axis=0)], return_inverse=True)
    is_present = np.zeros((len(first), len(worlds)), bool)
    is_present[pair, world[problem]] = True
    world_index = (np.cumsum(is_present, axis=1) - 1)[:, world]
    order = np.argsort(logs, axis=1)
    logs = np.take_along_axis(logs, order, axis=1)
    world_index = np.take_along_axis(world_index, order, axis=1)
    counts = np.bincount(pair, minlength=len(first)).tolist()
    return [(logs[k, :n], world_index[k, :n]) for k, n in enumerate(counts)]


def _build_comparison(
    planners: tuple[str, str], counts: tuple[int, ...], ratios: dict[str, PairedRatio]
) -> PairedComparison:
    both, only_first, only_second, neither = counts
    low, high = newcombe(*counts)
    return PairedComparison(
        first=planners[0],
        second=planners[1],
        both=both,
        only_first=only_first,
        only_second=only_second,
        neither=neither,
        difference=(only_first - only_second) / sum(counts) if any(counts) else math.nan,
        low=low,
        high=high,
        p=mcnemar(only_first, only_second),
        ratios=ratios,
    )


def bootstrap_ratios(samples: Sequence[Sample]) -> list[PairedRatio]:
    """Return the median ratio of each sample with its 95 % percentile bootstrap interval.

    Whole worlds are resampled. Samples of as many worlds share their resamples.

    Args:
        samples: any number of them; one may be empty.
    """
    ratios = [PairedRatio(median=math.nan, low=math.nan, high=math.nan, pairs=0)] * len(samples)

    def count_worlds(at: int) -> int:
        return int(samples[at][1].max()) + 1

    filled = [at for at, (logs, _) in enumerate(samples) if len(logs)]
    ordered = sorted(filled, key=lambda at: (count_worlds(at), len(samples[at][0])))
    for worlds, group in itertools.groupby(ordered, count_worlds):
        counts, members = _resample_worlds(worlds, RESAMPLES), list(group)
        step = max(1, _MAX_CHUNK // len(samples[members[-1]][0]))
        for chunk in (members[i : i + step] for i in range(0, len(members), step)):
            medians = _resample_medians([samples[at] for at in chunk], counts)
            low, high = np.exp(np.quantile(medians, [0.025, 0.975], axis=1))
            for i, at in enumerate(chunk):
                logs = samples[at][0]
                n = len(logs)
                median = float(np.exp((logs[(n - 1) // 2] + logs[n // 2]) / 2))
                ratios[at] = PairedRatio(
                    median=median, low=float(low[i]), high=float(high[i]), pairs=n
                )
    return ratios


def _resample_medians(samples: Sequence[Sample], counts: np.ndarray) -> np.ndarray:
    """Return the median [sample, resample] of each resample.

    Args:
        samples: of as many worlds each, none empty.
        counts: int [resample, world] how often each world is chosen.
    """
    size, worlds = max(len(logs) for logs, _ in samples), counts.shape[1]
    ordered = np.zeros((len(samples), size))
    # What is beyond the end of a sample lies in a world that is never chosen.
    world = np.full((size, len(samples)), worlds)
    for i, (logs, world_index) in enumerate(samples):
        ordered[i, : len(logs)], world[: len(logs), i] = logs, world_index
    max_total = worlds * max(int(np.bincount(world_index).max()) for _, world_index in samples)
    kind = np.int16 if max_total < np.iinfo(np.int16).max else np.int32
    weights = np.zeros((worlds + 1, len(counts)), kind)
    weights[:worlds] = counts.T
    ends = weights[world]
    for i in range(1, size):
        np.add(ends[i - 1], ends[i], out=ends[i])
    halves = (ends[-1] - 1) // 2, ends[-1] // 2
    # Medians lie near the middle: before the first row no half is passed, from the last on all are.
    first = bisect_left(range(size), True, key=lambda i: bool(np.any(ends[i] > halves[0])))
    last = bisect_left(range(size), True, key=lambda i: bool(np.all(ends[i] > halves[1])))
    passed = [np.sum(ends[first:last] <= half, axis=0, dtype=kind).astype(int) for half in halves]
    lower, upper = (np.take_along_axis(ordered, first + count, axis=1) for count in passed)
    medians: np.ndarray = (lower + upper) / 2
    return medians


def _resample_worlds(worlds: int, times: int) -> np.ndarray:
    """Return how often each world is chosen in each resample, int [times, worlds]."""
    numbers = _sample_uniform(times << (worlds - 1).bit_length())[: times * worlds]
    row = np.repeat(np.arange(times), worlds)
    counts = np.bincount(
        row * worlds + (numbers * worlds).astype(np.int64), minlength=times * worlds
    )
    return counts.reshape(times, worlds)


@lru_cache(maxsize=2)
def _sample_uniform(count: int) -> np.ndarray:
    """Return the first numbers [count] of one fixed sequence, uniform in [0, 1).

    mulberry32 (T. Ettinger, public domain): its state is a counter, so all numbers come at once.
    """
    state = (_SEED + np.arange(1, count + 1, dtype=np.uint64) * _STEP) & _MASK
    mixed = ((state ^ (state >> 15)) * (state | 1)) & _MASK
    mixed = ((mixed + ((mixed ^ (mixed >> 7)) * (mixed | 61) & _MASK)) & _MASK) ^ mixed
    numbers: np.ndarray = (mixed ^ (mixed >> 14)) / 2**32
    return numbers


def format_pairs_csv(results: Results) -> str:
    """All pairs of planners over all of their common problems, as CSV."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    head = ["first", "second", "problems", "both", "only_first", "only_second", "neither"]
    head += ["difference", "low", "high", "mcnemar_p"]
    for cost in RATIOS:
        head += [f"{cost}_ratio", f"{cost}_ratio_low", f"{cost}_ratio_high", f"{cost}_pairs"]
    writer.writerow([*head, "few"])
    pairs = list(itertools.combinations(range(len(results.planners)), 2))
    for comparison in compare_pairs(results, [results.run_table], pairs)[0]:
        row: list[object] = [
            comparison.first,
            comparison.second,
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
