"""Performance profiles (Dolan and More, Mathematical Programming 91, 2002).

The profile of a planner at tau is the share of the common problems on which its cost is at most
tau times the least cost of any planner. Where it failed its ratio is infinite; problems that
nobody solved count in the share.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from angler_mjx.studies.benchmark.report.reading import Results

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


def compute_profiles(results: Results, table: np.ndarray, cost: str) -> PerformanceProfiles:
    """Profiles of one cost.

    Args:
        results: of a benchmark.
        table: int [planner, problem] rows, as `Results.run_table`.
        cost: one of `COSTS`.
    """
    runs = results.runs
    values = np.append(np.where(runs[COSTS[cost]], runs[cost], np.nan), np.nan)[table]
    is_measured = np.isfinite(values).any(axis=1)
    common = np.all(table[is_measured] >= 0, axis=0) & is_measured.any()
    costs = np.nan_to_num(values[is_measured][:, common], nan=np.inf)
    best = costs.min(axis=0, initial=np.inf)
    # A cost of 0 can be the best: it is within every ratio of itself, and others are beyond all.
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(costs == best, 1.0, costs / best)
    ratio[~np.isfinite(costs)] = np.inf
    measured = [
        name for name, has_cost in zip(results.planners, is_measured, strict=True) if has_cost
    ]
    return PerformanceProfiles(
        ratios={
            name: np.sort(row[np.isfinite(row)]) for name, row in zip(measured, ratio, strict=True)
        },
        problems=int(common.sum()),
        left_out=tuple(name for name in results.planners if name not in measured),
    )
