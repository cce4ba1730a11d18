"""Statistics of a benchmark for every selection that a reader of its page can make.

A selection is a scene, a team size and an information level, or all of each. Rates, rankings,
profiles and paired comparisons of a selection are computed from its rows alone; the page only looks
them up. Profiles take the best of all planners, whichever of them the reader shows.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from angler_mjx.studies.benchmark.report.paired import (
    RATIOS,
    PairedComparison,
    PairedRatio,
    compare_rows,
)
from angler_mjx.studies.benchmark.report.profiles import COSTS, compute_profiles
from angler_mjx.studies.benchmark.report.rates import DensityBins, compute_rate
from angler_mjx.studies.benchmark.report.reading import Results

ALL = -1
"""Index of a choice that selects every scene, team size or information level."""
_DIGITS = 5
"""Significant digits of stored statistics; the page shows at most four."""
_RATE_DIGITS = 7
"""Significant digits of rates, so that whole per cents round as unrounded ones do."""
_AXIS = 364
"""Positions on the axis of a profile: the width of its chart in pixels."""
_MAX_STEPS = 30
"""Steps of a profile that the page draws, at most."""


@dataclass(frozen=True, kw_only=True)
class Selection:
    """Rows of one choice of a reader."""

    key: str
    """Indices of scene, team size and information level, `ALL` for all, joined by blanks."""
    rows: np.ndarray
    """bool [n]."""


def select_rows(*columns: Sequence[int]) -> Iterator[Selection]:
    """Yield every selection that holds a row.

    Args:
        columns: int [n] of each choice: index of the chosen value in each row. Of a column with
            one value only `ALL` is a choice.
    """
    arrays = [np.asarray(column) for column in columns]
    choices = []
    for values in arrays:
        distinct = np.unique(values).tolist()
        choices.append([ALL, *(distinct if len(distinct) > 1 else [])])
    for chosen in itertools.product(*choices):
        rows = np.ones(len(arrays[0]), bool)
        for values, value in zip(arrays, chosen, strict=True):
            rows &= (value == ALL) | (values == value)
        if rows.any():
            yield Selection(key=" ".join(map(str, chosen)), rows=rows)


def build_page_selection(results: Results, rows: np.ndarray, bins: DensityBins) -> dict[str, Any]:
    """Return the statistics of selected rows as the page reads them.

    Args:
        results: of a benchmark.
        rows: bool [n] selected rows.
        bins: density bins of all rows.
    """
    return {
        "rates": _build_rates(results, rows),
        "ranking": _rank_planners(results, rows),
        "bins": {
            str(b): _build_rates(results, rows & (bins.of == b)) for b in np.unique(bins.of[rows])
        },
        "profiles": {cost: _build_profile(results, rows, cost) for cost in COSTS},
        "pairs": _build_pairs(results, rows),
    }


def round_digits(value: float, digits: int = _DIGITS) -> float | int | None:
    """Return a number of so many significant digits for JSON; None for what is no number."""
    if not math.isfinite(value):
        return None
    short = float(f"{value:.{digits}g}")
    return int(short) if short.is_integer() else short


def _build_rates(results: Results, rows: np.ndarray) -> list[list[float | int | None] | None]:
    """Return fraction, ends of its interval, runs and given-up runs of each planner."""
    runs = results.runs
    rates: list[list[float | int | None] | None] = []
    for name in results.planners:
        of_planner = rows & (runs["planner"] == name) & runs.counted
        if not of_planner.any():
            rates.append(None)
            continue
        rate = compute_rate(runs[results.judged][of_planner], runs.counted[of_planner])
        closed = int(np.sum(of_planner & ~runs.requested))
        fractions = (round_digits(x, _RATE_DIGITS) for x in (rate.fraction, rate.low, rate.high))
        rates.append([*fractions, rate.requested, closed])
    return rates


def _rank_planners(results: Results, rows: np.ndarray) -> list[int]:
    """Return indices of the planners with runs, from the highest rate to the lowest."""
    runs = results.runs
    fractions = {}
    for index, name in enumerate(results.planners):
        of_planner = rows & (runs["planner"] == name) & runs.counted
        if of_planner.any():
            fractions[index] = float(np.mean(runs[results.judged][of_planner]))
    return sorted(fractions, key=lambda index: -fractions[index])


def _build_profile(results: Results, rows: np.ndarray, cost: str) -> dict[str, Any]:
    profiles = compute_profiles(
        results.runs.where(rows), results.problem[rows], results.planners, cost
    )
    ends = [float(np.quantile(r, 0.99)) for r in profiles.ratios.values() if len(r)]
    end = max(1.02, min(max([1.0, *ends]), profiles.largest, 1e4))
    return {
        "problems": profiles.problems,
        "end": round_digits(end),
        "lines": [
            [results.planners.index(name), *_build_steps(ratios, end)]
            for name, ratios in profiles.ratios.items()
            if profiles.problems
        ],
        "left_out": [results.planners.index(name) for name in profiles.left_out],
    }


def _build_steps(ratios: np.ndarray, end: float) -> tuple[int, int, list[int], list[int]]:
    """Return one profile: problems it is best on, problems solved, positions of steps, heights.

    Positions are on the logarithmic axis from 0 at 1 to `_AXIS` at its end, heights in problems.
    Of more than `_MAX_STEPS` steps evenly many are kept, with the first and the last one.

    Args:
        ratios: [n] finite ratios, ascending.
        end: largest ratio on the axis.
    """
    shown = ratios[ratios <= end]
    position, count = np.unique(
        np.round(_AXIS * np.log(shown) / np.log(end)).astype(int), return_counts=True
    )
    height = np.cumsum(count)
    if len(position) > _MAX_STEPS:
        kept = np.linspace(0, len(position) - 1, _MAX_STEPS).round().astype(int)
        position, height = position[kept], height[kept]
    return int(np.sum(ratios == 1.0)), len(ratios), position.tolist(), height.tolist()


def _build_pairs(results: Results, rows: np.ndarray) -> dict[str, list[Any]]:
    """Return the comparison of each pair of planners that share a problem, once."""
    runs = results.runs.where(rows)
    problem, world = results.problem[rows], results.world[rows]
    present = set(runs["planner"][runs.counted].tolist())
    pairs = {}
    for (i, first), (j, second) in itertools.combinations(enumerate(results.planners), 2):
        if first in present and second in present:
            comparison = compare_rows(runs, problem, world, results.judged, (first, second))
            if comparison.pairs:
                pairs[f"{i} {j}"] = _list_comparison(comparison)
    return pairs


def _list_comparison(comparison: PairedComparison) -> list[Any]:
    """Return counts, difference with its interval, p, then the ratio of each cost."""
    return [
        *(comparison.both, comparison.only_first, comparison.only_second, comparison.neither),
        *(round_digits(x) for x in (comparison.difference, comparison.low, comparison.high)),
        round_digits(comparison.p),
        *(_list_ratio(comparison.ratios[cost]) for cost in RATIOS),
    ]


def _list_ratio(ratio: PairedRatio) -> list[float | int | None] | int:
    if not ratio.pairs:
        return 0
    return [*(round_digits(x) for x in (ratio.median, ratio.low, ratio.high)), ratio.pairs]
