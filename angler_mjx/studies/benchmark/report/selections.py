"""Statistics of a benchmark for every selection that a reader of its page can make.

A selection is a scene, a team size and an information level, or all of each. Rates, rankings,
profiles and paired comparisons of a selection are computed from its rows alone; the page only looks
them up. Profiles take the best of all planners, whichever of them the reader shows.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypedDict

import numpy as np

from angler_mjx.runs.storage.confidence_intervals import wilson_interval
from angler_mjx.studies.benchmark.report.paired import (
    RATIOS,
    PairedComparison,
    PairedRatio,
    compare_pairs,
)
from angler_mjx.studies.benchmark.report.profiles import COSTS, compute_profiles
from angler_mjx.studies.benchmark.report.rates import DensityBins
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


type Number = float | int | None
"""A number of the page; None for what is no number."""
type Ratio = list[Number] | int
"""Median, ends of its interval and problems of a ratio; 0 without a problem."""


class PageProfile(TypedDict):
    """Performance profiles of one cost."""

    problems: int
    end: Number
    """Largest ratio on the axis."""
    lines: list[tuple[int, int, int, list[int], list[int]]]
    """Planner, problems it is best on, problems solved, positions of steps, heights."""
    left_out: list[int]
    """Planners of which nothing is known."""


class PageSelection(TypedDict):
    """Statistics of one selection."""

    rates: list[list[Number] | None]
    ranking: list[int]
    bins: dict[str, list[list[Number] | None]]
    """Rates by density bin."""
    profiles: dict[str, PageProfile]
    pairs: dict[str, list[Number | Ratio]]
    """Comparison of two planners, by their indices."""


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


def build_page_selections(
    results: Results, selections: Sequence[Selection], bins: DensityBins
) -> list[PageSelection]:
    """Return the statistics of each selection as the page reads them.

    Args:
        results: of a benchmark.
        selections: any number of them.
        bins: density bins of all rows.
    """
    tables = [results.select_runs(selection.rows) for selection in selections]
    pairs = list(itertools.combinations(range(len(results.planners)), 2))
    return [
        {
            "rates": _build_rates(results, selection.rows),
            "ranking": _rank_planners(results, selection.rows),
            "bins": {
                str(b): _build_rates(results, selection.rows & (bins.of == b))
                for b in np.unique(bins.of[selection.rows])
            },
            "profiles": {cost: _build_profile(results, table, cost) for cost in COSTS},
            "pairs": {
                f"{i} {j}": _list_comparison(comparison)
                for (i, j), comparison in zip(pairs, compared, strict=True)
                if comparison.pairs
            },
        }
        for selection, table, compared in zip(
            selections, tables, compare_pairs(results, tables, pairs), strict=True
        )
    ]


def round_digits(value: float, digits: int = _DIGITS) -> Number:
    """Return a number of so many significant digits for JSON; None for what is no number."""
    if not math.isfinite(value):
        return None
    short = float(f"{value:.{digits}g}")
    return int(short) if short.is_integer() else short


def _count_runs(results: Results, rows: np.ndarray) -> np.ndarray:
    """Return counted runs, hits and given-up runs [3, planner] of selected rows."""
    runs = results.runs
    counted = rows & runs.counted
    return np.stack(
        [
            np.bincount(results.planner[kept], minlength=len(results.planners))
            for kept in (counted, counted & runs[results.judged], counted & ~runs.requested)
        ]
    )


def _build_rates(results: Results, rows: np.ndarray) -> list[list[Number] | None]:
    """Return fraction, ends of its interval, runs and given-up runs of each planner."""
    rates: list[list[Number] | None] = []
    for total, count, closed in _count_runs(results, rows).T.tolist():
        fractions = (count / total, *wilson_interval(count, total)) if total else ()
        rounded = [round_digits(x, _RATE_DIGITS) for x in fractions]
        rates.append([*rounded, total, closed] if total else None)
    return rates


def _rank_planners(results: Results, rows: np.ndarray) -> list[int]:
    """Return indices of the planners with runs, from the highest rate to the lowest."""
    total, count, _ = _count_runs(results, rows).tolist()
    present = [i for i, of_planner in enumerate(total) if of_planner]
    return sorted(present, key=lambda i: -count[i] / total[i])


def _build_profile(results: Results, table: np.ndarray, cost: str) -> PageProfile:
    profiles = compute_profiles(results, table, cost)
    ends = [float(np.quantile(r, 0.99)) for r in profiles.ratios.values() if len(r)]
    end = max(1.02, min(max([1.0, *ends]), profiles.largest, 1e4))
    return {
        "problems": profiles.problems,
        "end": round_digits(end),
        "lines": [
            (results.planners.index(name), *_build_steps(ratios, end))
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


def _list_comparison(comparison: PairedComparison) -> list[Number | Ratio]:
    """Return counts, difference with its interval, p, then the ratio of each cost."""
    return [
        *(comparison.both, comparison.only_first, comparison.only_second, comparison.neither),
        *(round_digits(x) for x in (comparison.difference, comparison.low, comparison.high)),
        round_digits(comparison.p),
        *(_list_ratio(comparison.ratios[cost]) for cost in RATIOS),
    ]


def _list_ratio(ratio: PairedRatio) -> Ratio:
    if not ratio.pairs:
        return 0
    return [*(round_digits(x) for x in (ratio.median, ratio.low, ratio.high)), ratio.pairs]
