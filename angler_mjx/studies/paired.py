"""Two runs of the same worlds: what the second changed, world by world.

Worlds are independent, robots of a world are not. So tests and intervals are of worlds. Whole teams
and completed tasks have the exact test of McNemar (two-sided binomial on the worlds that one of the
two alone solved) and Newcombe's interval for paired data (Statistics in Medicine 17, 1998,
2635-2650, method 10: Wilson's intervals of both rates, joined with the correlation of the pairs).
The share of a world's robots that arrive has Student's interval of the mean difference over worlds,
and the exact sign test on the worlds that it differs in (Dixon and Mood, JASA 41, 1946: the same
binomial as McNemar's). Costs are differences of robots that both runs have a value of, their mean
with the interval of `angler_mjx.runs.storage.confidence_intervals.clustered_mean`.
"""

import math

import numpy as np
import pyarrow as pa
from scipy.special import bdtr

from angler_mjx.runs.storage.confidence_intervals import (
    ClusteredMean,
    clustered_mean,
    wilson_interval,
)
from angler_mjx.runs.storage.results import completion_times
from angler_mjx.studies.measures import (
    COSTS,
    arrived_of,
    finite_or_none,
    mean_by_world,
    read_numbers,
    worlds_of,
)
from angler_mjx.studies.rows import PairCounts, PairingRow, RateRow, ShiftRow


def pair_runs(first: pa.Table, second: pa.Table) -> PairingRow:
    """Compare the episodes of two runs over the worlds that both hold.

    Args:
        first: rows of a run, ordered by world and robot.
        second: of the other.
    """
    common = np.intersect1d(worlds_of(first), worlds_of(second))
    tables = [rows.filter(np.isin(worlds_of(rows), common)) for rows in (first, second)]
    arrived = [arrived_of(rows) for rows in tables]
    worlds = [worlds_of(rows) for rows in tables]
    fractions = [mean_by_world(a, w) for a, w in zip(arrived, worlds, strict=True)]
    fraction_shift = _mean_shift(*fractions)
    fraction_p = sign_test(fractions[1] - fractions[0])
    same_worlds = np.array_equal(worlds[0], worlds[1])
    tasks, task_s = _compare_tasks(*(completion_times(rows) for rows in tables))
    robots: RateRow | None = None
    if same_worlds:
        robots = {
            **_count_pairs(*arrived),
            "difference": fraction_shift["difference"],
            "low": fraction_shift["low"],
            "high": fraction_shift["high"],
            "p": fraction_p,
        }
    return {
        "worlds": len(common),
        "teams": _compare_worlds(*(rows == 1.0 for rows in fractions)),
        "tasks": tasks,
        "task_s": task_s,
        "robots": robots,
        "share": fraction_shift,
        "share_p": fraction_p,
        "costs": {name: _compare_cost(name, tables, arrived) for name in COSTS}
        if same_worlds
        else {},
    }


def newcombe(both: int, only_first: int, only_second: int, neither: int) -> tuple[float, float]:
    """95 % interval of the difference of two paired rates; (-1, 1) without a pair."""
    n = both + only_first + only_second + neither
    if n == 0:
        return -1.0, 1.0
    p1, p2 = (both + only_first) / n, (both + only_second) / n
    (l1, u1), (l2, u2) = (
        wilson_interval(both + only_first, n),
        wilson_interval(both + only_second, n),
    )
    sides = (
        (both + only_first)
        * (only_second + neither)
        * (both + only_second)
        * (only_first + neither)
    )
    cross = float(both * neither - only_first * only_second)
    if cross > 0:
        cross = max(cross - n / 2, 0.0)
    phi = cross / math.sqrt(sides) if sides else 0.0
    down, up = (p1 - l1, u2 - p2), (u1 - p1, p2 - l2)
    below, above = (math.sqrt(max(x * x - 2 * phi * x * y + y * y, 0.0)) for x, y in (down, up))
    return p1 - p2 - below, p1 - p2 + above


def mcnemar(only_first: int, only_second: int) -> float:
    """Return the exact two-sided p that the two are equally likely to solve a problem alone."""
    n = only_first + only_second
    return min(1.0, 2.0 * float(bdtr(min(only_first, only_second), n, 0.5)))


def sign_test(differences: np.ndarray) -> float:
    """Exact two-sided p that differences are as likely up as down; those that are 0 say nothing."""
    return mcnemar(int(np.sum(differences > 0)), int(np.sum(differences < 0)))


def _count_pairs(first: np.ndarray, second: np.ndarray) -> PairCounts:
    return {
        "both": int(np.sum(first & second)),
        "only_first": int(np.sum(first & ~second)),
        "only_second": int(np.sum(~first & second)),
        "neither": int(np.sum(~first & ~second)),
    }


def _compare_tasks(
    first: np.ndarray | None, second: np.ndarray | None
) -> tuple[RateRow | None, ShiftRow | None]:
    """Return what became of the tasks, from the times at which worlds completed them."""
    if first is None or second is None:
        return None, None
    done = np.isfinite(first), np.isfinite(second)
    first, second = (times[done[0] & done[1]] for times in (first, second))
    mean_change = clustered_mean(second - first, np.arange(len(first)))
    task_s = _build_shift(mean_change, first, second, mean_change.low, mean_change.high)
    return _compare_worlds(*done), task_s


def _compare_worlds(first: np.ndarray, second: np.ndarray) -> RateRow:
    counts = _count_pairs(first, second)
    lost, won = counts["only_first"], counts["only_second"]
    low, high = newcombe(counts["both"], won, lost, counts["neither"])
    return {
        **counts,
        "difference": (won - lost) / max(len(first), 1),
        "low": low,
        "high": high,
        "p": mcnemar(won, lost),
    }


def _mean_shift(first: np.ndarray, second: np.ndarray) -> ShiftRow:
    """Of shares of worlds."""
    change = second - first
    mean_change = clustered_mean(change, np.arange(len(change)))
    low, high = mean_change.low, mean_change.high
    if len(change) and np.all(change == change[0]):
        # No spread was seen. Of other worlds at most this share does otherwise, with 95 %.
        other = wilson_interval(0, len(change))[1]
        low = mean_change.mean - other * (1.0 + mean_change.mean)
        high = mean_change.mean + other * (1.0 - mean_change.mean)
    return _build_shift(mean_change, first, second, max(low, -1.0), min(high, 1.0))


def _compare_cost(name: str, tables: list[pa.Table], arrived: list[np.ndarray]) -> ShiftRow:
    first, second = (read_numbers(table, name) for table in tables)
    used = np.isfinite(first) & np.isfinite(second)
    if COSTS[name] != "of all robots":
        used &= arrived[0] & arrived[1]
    first, second = first[used], second[used]
    mean_change = clustered_mean(second - first, worlds_of(tables[0])[used])
    return _build_shift(mean_change, first, second, mean_change.low, mean_change.high)


def _build_shift(
    mean_change: ClusteredMean, first: np.ndarray, second: np.ndarray, low: float, high: float
) -> ShiftRow:
    return {
        "pairs": mean_change.count,
        "first": float(np.mean(first)) if len(first) else None,
        "second": float(np.mean(second)) if len(second) else None,
        "difference": finite_or_none(mean_change.mean),
        "low": finite_or_none(low),
        "high": finite_or_none(high),
    }
