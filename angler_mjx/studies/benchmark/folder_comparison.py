"""Two results folders of the same benchmark: whether they say the same.

Of each run the plans are compared number by number, then how planning ended, and how the robots
ended. Times are told, not judged: another machine is faster or slower. A planner whose search ends
by the clock gives other plans each time; that is its way, and is told too.
"""

import json
from collections import Counter, defaultdict
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.runs.storage import atomic_files
from angler_mjx.studies.benchmark import path_archive as bytes_of
from angler_mjx.studies.benchmark.store import FILE, STATUS, BenchmarkStore

COMPARISON = "comparison.json"

type _Key = tuple[str | int, ...]
"""Label of the planner, and the problem."""


@dataclass(frozen=True, kw_only=True)
class _ComparedRun:
    """What is compared of a run."""

    status: str
    plans: str | None = None
    """Digest of its plans."""
    outcomes: Counter[tuple[int, str]] = field(default_factory=Counter)
    """Robots by their outcomes."""
    time_s: float | None = None
    """Of planning."""


@dataclass(kw_only=True)
class PlannerComparison:
    """The runs of one planner."""

    runs: int = 0
    """In both folders."""
    only_one: int = 0
    """In one of them."""
    same_plans: int = 0
    same_status: int = 0
    same_outcomes: int = 0
    """Of all robots; of runs with the same plans this is the simulator's own doing."""
    same_plans_other_outcomes: int = 0
    slower: float | None = None
    """Median ratio of planning times, the second folder over the first."""


@dataclass(kw_only=True)
class FolderComparison:
    """Of two folders."""

    first: str
    second: str
    planners: dict[str, PlannerComparison] = field(default_factory=dict)

    @property
    def same(self) -> bool:
        """Whether all runs have the same plans, status and outcomes."""
        return all(
            planner.only_one == 0
            and planner.runs == planner.same_plans == planner.same_status == planner.same_outcomes
            for planner in self.planners.values()
        )


def compare_folders(first: Path, second: Path) -> FolderComparison:
    """Compare two results folders, and leave what was found in the second.

    Raises:
        ConfigError: one is none, or they ask other problems.
    """
    first_runs, second_runs = _read_runs(first), _read_runs(second)
    if not {key[1:] for key in first_runs} & {key[1:] for key in second_runs}:
        raise ConfigError(f"{second}: has no problem in common with {first}; nothing is compared")
    comparison = FolderComparison(first=str(first), second=str(second))
    ratios: dict[str, list[float]] = defaultdict(list)
    for key in dict.fromkeys([*first_runs, *second_runs]):
        label = str(key[0])
        planner = comparison.planners.setdefault(label, PlannerComparison())
        a, b = first_runs.get(key), second_runs.get(key)
        if a is None or b is None:
            planner.only_one += 1
            continue
        planner.runs += 1
        plans, outcomes = a.plans == b.plans, a.outcomes == b.outcomes
        planner.same_plans += plans
        planner.same_status += a.status == b.status
        planner.same_outcomes += outcomes
        planner.same_plans_other_outcomes += plans and not outcomes
        if a.time_s and b.time_s:
            ratios[label].append(b.time_s / a.time_s)
    for label, values in ratios.items():
        comparison.planners[label].slower = float(np.median(values))
    atomic_files.write_text(second / COMPARISON, json.dumps(asdict(comparison), indent=2) + "\n")
    return comparison


def _read_runs(folder: Path) -> dict[_Key, _ComparedRun]:
    """What is compared of each run, by planner and problem; what was not asked counts too."""
    if not (folder / FILE).is_file():
        raise ConfigError(f"{folder}: is no results folder of a benchmark (no {FILE} in it)")
    with BenchmarkStore(folder / FILE, only_read=True) as store:
        which = (
            "plannerConfigs.name AS label, experiments.name, robots, knows_obstacles, "
            "knows_current, problem_seed, world"
        )
        joined = (
            "JOIN experiments ON experiments.id = experimentid "
            "JOIN plannerConfigs ON plannerConfigs.id = plannerid"
        )
        ended: dict[int, Counter[tuple[int, str]]] = defaultdict(Counter)
        for row in store.rows(
            "SELECT runid, robot, json_extract(episode, '$.outcome') AS outcome FROM robots"
        ):
            ended[row["runid"]][row["robot"], row["outcome"]] += 1
        runs: dict[_Key, _ComparedRun] = {}
        for row in store.rows(
            f"SELECT {which}, runs.id, status, time, paths FROM runs {joined} "
            "LEFT JOIN plans ON plans.runid = runs.id"
        ):
            plans = None if row["paths"] is None else bytes_of.compute_digest(row["paths"])
            runs[tuple(row)[:7]] = _ComparedRun(
                status=STATUS[row["status"]],
                plans=plans,
                outcomes=ended[row["id"]],
                time_s=row["time"],
            )
        for row in store.rows(f"SELECT {which} FROM closed {joined}"):
            runs[tuple(row)] = _ComparedRun(status="closed")
    return runs
