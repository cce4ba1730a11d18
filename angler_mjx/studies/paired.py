"""Two runs of the same worlds: what the second changed, world by world.

Worlds are independent, robots of a world are not. So tests and intervals are of worlds. Whole teams
and completed tasks have the exact test of McNemar and Newcombe's interval
(`angler_mjx.studies.benchmark.report.paired`). The share of a world's robots that arrive has
Student's interval of the mean difference over worlds, and the exact sign test on the worlds that it
differs in (Dixon and Mood, JASA 41, 1946: the same binomial as McNemar's). Costs are differences of
robots that both runs have a value of, their mean with the interval of
`angler_mjx.runs.storage.intervals.clustered_mean`.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from angler_mjx.runs.storage.intervals import Mean, clustered_mean, wilson
from angler_mjx.runs.storage.results import completion_times
from angler_mjx.studies.benchmark.report.paired import mcnemar, newcombe
from angler_mjx.studies.measures import COSTS, arrived_of, by_world, numbers, worlds_of


@dataclass(frozen=True, kw_only=True)
class Change:
    """Pairs of yes and no, second run against first."""

    both: int
    only_first: int
    only_second: int
    neither: int
    difference: float
    """Rate of the second minus that of the first."""
    low: float
    high: float
    p: float
    """Exact, two-sided: that neither is likelier to have it alone."""


@dataclass(frozen=True, kw_only=True)
class Shift:
    """Pairs of numbers, second run minus first."""

    pairs: int
    first: float
    """Mean of the first run, over the pairs."""
    second: float
    difference: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Pairing:
    """What the second of two runs changed."""

    worlds: int
    """That both hold."""
    teams: Change
    """Worlds in which all robots arrived."""
    tasks: Change | None
    """Worlds that completed their task; None where a run has none."""
    task_s: Shift | None
    """When, of worlds that did in both."""
    robots: Change | None
    """Robots that arrived; counts are of robots, difference and p of worlds. None where the fleets
    have different sizes."""
    share: Shift
    """Share of a world's robots that arrived."""
    share_p: float
    """Of the sign test on that share."""
    costs: dict[str, Shift]
    """By column; empty where the fleets have different sizes."""


def pair(first: pa.Table, second: pa.Table) -> Pairing:
    """Compare the episodes of two runs over the worlds that both hold.

    Args:
        first: rows of a run, ordered by world and robot.
        second: of the other.
    """
    common = np.intersect1d(worlds_of(first), worlds_of(second))
    tables = [one.filter(np.isin(worlds_of(one), common)) for one in (first, second)]
    arrived = [arrived_of(one) for one in tables]
    worlds = [worlds_of(one) for one in tables]
    shares = [by_world(a, w) for a, w in zip(arrived, worlds, strict=True)]
    share = _mean_shift(*shares)
    share_p = sign_test(shares[1] - shares[0])
    alike = np.array_equal(worlds[0], worlds[1])
    robots = None
    if alike:
        counts = _counts(*arrived)
        robots = Change(
            **counts, difference=share.difference, low=share.low, high=share.high, p=share_p
        )
    return Pairing(
        worlds=len(common),
        teams=_of_worlds(*(one == 1.0 for one in shares)),
        **_tasks(*(completion_times(one) for one in tables)),
        robots=robots,
        share=share,
        share_p=share_p,
        costs={name: _cost(name, tables, arrived) for name in COSTS} if alike else {},
    )


def sign_test(differences: np.ndarray) -> float:
    """Exact two-sided p that differences are as likely up as down; those that are 0 say nothing."""
    return mcnemar(int(np.sum(differences > 0)), int(np.sum(differences < 0)))


def _counts(first: np.ndarray, second: np.ndarray) -> dict[str, Any]:
    return {
        "both": int(np.sum(first & second)),
        "only_first": int(np.sum(first & ~second)),
        "only_second": int(np.sum(~first & second)),
        "neither": int(np.sum(~first & ~second)),
    }


def _tasks(first: np.ndarray | None, second: np.ndarray | None) -> dict[str, Any]:
    """What became of the tasks, from the times at which worlds completed them."""
    if first is None or second is None:
        return {"tasks": None, "task_s": None}
    done = np.isfinite(first), np.isfinite(second)
    first, second = (times[done[0] & done[1]] for times in (first, second))
    found = clustered_mean(second - first, np.arange(len(first)))
    return {
        "tasks": _of_worlds(*done),
        "task_s": _shift(found, first, second, found.low, found.high),
    }


def _of_worlds(first: np.ndarray, second: np.ndarray) -> Change:
    counts = _counts(first, second)
    lost, won = counts["only_first"], counts["only_second"]
    low, high = newcombe(counts["both"], won, lost, counts["neither"])
    return Change(
        **counts,
        difference=(won - lost) / max(len(first), 1),
        low=low,
        high=high,
        p=mcnemar(won, lost),
    )


def _mean_shift(first: np.ndarray, second: np.ndarray) -> Shift:
    """Of shares of worlds."""
    change = second - first
    found = clustered_mean(change, np.arange(len(change)))
    low, high = found.low, found.high
    if len(change) and np.all(change == change[0]):
        # No spread was seen. Of other worlds at most this share does otherwise, with 95 %.
        other = wilson(0, len(change))[1]
        low = found.mean - other * (1.0 + found.mean)
        high = found.mean + other * (1.0 - found.mean)
    return _shift(found, first, second, max(low, -1.0), min(high, 1.0))


def _cost(name: str, tables: list[pa.Table], arrived: list[np.ndarray]) -> Shift:
    first, second = (numbers(one, name) for one in tables)
    used = np.isfinite(first) & np.isfinite(second)
    if COSTS[name] != "of all robots":
        used &= arrived[0] & arrived[1]
    first, second = first[used], second[used]
    found = clustered_mean(second - first, worlds_of(tables[0])[used])
    return _shift(found, first, second, found.low, found.high)


def _shift(found: Mean, first: np.ndarray, second: np.ndarray, low: float, high: float) -> Shift:
    return Shift(
        pairs=found.count,
        first=float(np.mean(first)) if len(first) else float("nan"),
        second=float(np.mean(second)) if len(second) else float("nan"),
        difference=found.mean,
        low=low,
        high=high,
    )
