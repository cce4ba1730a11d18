"""Two results folders of the same benchmark: whether they say the same.

Of each run the plans are compared number by number, then how planning ended, and how the robots
ended. Times are told, not judged: another machine is faster or slower. A planner whose search ends
by the clock gives other plans each time; that is its way, and is told too.
"""

import json
from collections import Counter, defaultdict
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.runs.storage import atomic
from angler_mjx.studies.benchmark import paths as bytes_of
from angler_mjx.studies.benchmark.store import FILE, STATUS, BenchmarkStore

COMPARISON = "comparison.json"

type _Key = tuple[Any, ...]


@dataclass(kw_only=True)
class Compared:
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
    planners: dict[str, Compared] = field(default_factory=dict)

    @property
    def same(self) -> bool:
        """Whether all runs have the same plans, status and outcomes."""
        return all(
            one.only_one == 0 and one.runs == one.same_plans == one.same_status == one.same_outcomes
            for one in self.planners.values()
        )


def compare(first: Path, second: Path) -> FolderComparison:
    """Compare two results folders, and leave what was found in the second.

    Raises:
        ConfigError: one is none, or they ask other problems.
    """
    one, two = _runs(first), _runs(second)
    if not {key[1:] for key in one} & {key[1:] for key in two}:
        raise ConfigError(f"{second}: has no problem in common with {first}; nothing is compared")
    made = FolderComparison(first=str(first), second=str(second))
    ratios: dict[str, list[float]] = defaultdict(list)
    for key in dict.fromkeys([*one, *two]):
        found = made.planners.setdefault(key[0], Compared())
        a, b = one.get(key), two.get(key)
        if a is None or b is None:
            found.only_one += 1
            continue
        found.runs += 1
        plans = a["plans"] == b["plans"]
        outcomes = a["outcomes"] == b["outcomes"]
        found.same_plans += plans
        found.same_status += a["status"] == b["status"]
        found.same_outcomes += outcomes
        found.same_plans_other_outcomes += plans and not outcomes
        if a["time"] and b["time"]:
            ratios[key[0]].append(b["time"] / a["time"])
    for label, values in ratios.items():
        made.planners[label].slower = float(np.median(values))
    atomic.write_text(second / COMPARISON, json.dumps(asdict(made), indent=2) + "\n")
    return made


def _runs(folder: Path) -> dict[_Key, dict[str, Any]]:
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
        ended: dict[int, Counter[Any]] = defaultdict(Counter)
        for row in store.rows(
            "SELECT runid, robot, json_extract(episode, '$.outcome') AS outcome FROM robots"
        ):
            ended[row["runid"]][row["robot"], row["outcome"]] += 1
        made: dict[_Key, dict[str, Any]] = {}
        for row in store.rows(
            f"SELECT {which}, runs.id, status, time, paths FROM runs {joined} "
            "LEFT JOIN plans ON plans.runid = runs.id"
        ):
            plans = None if row["paths"] is None else bytes_of.digest(row["paths"])
            made[tuple(row)[:7]] = {
                "status": STATUS[row["status"]],
                "plans": plans,
                "outcomes": ended[row["id"]],
                "time": row["time"],
            }
        for row in store.rows(f"SELECT {which} FROM closed {joined}"):
            made[tuple(row)] = {"status": "closed", "plans": None, "outcomes": {}, "time": None}
    return made
