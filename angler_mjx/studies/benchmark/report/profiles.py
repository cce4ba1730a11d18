"""Performance profiles (Dolan and More, Mathematical Programming 91, 2002).

The profile of a planner at tau is the share of the common problems on which its cost is at most
tau times the least cost of any planner. Where it failed its ratio is infinite; problems that
nobody solved count in the share.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from angler_mjx.studies.benchmark.report.reading import Runs

COSTS = {
    "planning_s": "planned",
    "makespan_s": "success",
    "energy_j": "success",
    "flowtime_s": "success",
}
"""Costs, and the column that says whether a run counts as solved."""


@dataclass(frozen=True, kw_only=True)
class PerformanceProfiles:
    """Profiles of several planners over the problems that all were asked, or given up on."""

    ratios: Mapping[str, np.ndarray]
    """By planner: finite ratios, sorted."""
    problems: int
    """That are common."""
    all_problems: int
    left_out: tuple[str, ...]
    """Planners for which nothing of the cost is known."""

    def at(self, planner: str, tau: float) -> float:
        """Share of the common problems within ``tau`` of the best."""
        within = np.searchsorted(self.ratios[planner], tau, side="right")
        return float(within) / self.problems if self.problems else float("nan")

    @property
    def largest(self) -> float:
        """The largest finite ratio; 1 without any."""
        return max((float(r[-1]) for r in self.ratios.values() if len(r)), default=1.0)


def compute_profiles(
    runs: Runs, problem: np.ndarray, planners: Sequence[str], cost: str
) -> PerformanceProfiles:
    """Profiles of one cost.

    Args:
        runs: rows.
        problem: int [n] which problem each row is.
        planners: labels to compare.
        cost: one of `COSTS`.
    """
    values = np.where(runs[COSTS[cost]], runs[cost], np.nan)
    measured = [name for name in planners if np.any(np.isfinite(values[runs["planner"] == name]))]
    planner_rows = {name: (runs["planner"] == name) & runs.counted for name in measured}
    common = np.unique(problem)
    for rows in planner_rows.values():
        common = np.intersect1d(common, problem[rows])
    if not measured:
        common = common[:0]
    table = np.full((len(measured), len(common)), np.inf)
    for i, rows in enumerate(planner_rows.values()):
        at = np.searchsorted(common, problem[rows])
        is_common = np.isin(problem[rows], common)
        costs = np.nan_to_num(values[rows][is_common], nan=np.inf)
        table[i, at[is_common]] = costs
    best = table.min(axis=0, initial=np.inf)
    # A cost of 0 can be the best: it is within every ratio of itself, and others are beyond all.
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(table == best, 1.0, table / best)
    ratio[~np.isfinite(table)] = np.inf
    return PerformanceProfiles(
        ratios={
            name: np.sort(row[np.isfinite(row)]) for name, row in zip(measured, ratio, strict=True)
        },
        problems=len(common),
        all_problems=len(np.unique(problem)),
        left_out=tuple(name for name in planners if name not in measured),
    )
