"""Summary of a run's planning: fraction of robots with a plan, and reasons for the others."""

import re
from collections import Counter
from collections.abc import Callable, Sequence
from typing import TypedDict

import numpy as np
import pyarrow as pa

from angler_mjx.planning.answers import FAILED_STATUSES
from angler_mjx.runs.simulator.host_planning import PlanNotes
from angler_mjx.runs.storage import confidence_intervals

RAISED_STATUSES = ("error", "died")
"""Statuses of worlds whose planner raised an exception, or whose process died."""

NO_PATH = "the planner found no path"
"""Reason of a robot without a plan for which the planner gave none."""

MAX_REASONS = 5
"""Reasons that are listed, the commonest first."""

_NUMBER = re.compile(r"(?<![\w.:])[-+]?\d+(\.\d+)?(e[-+]?\d+)?(?![\w.])")
"""A measured number in a reason. Digits of names and of lines of files are none."""


class PlannedRobots(TypedDict):
    """Robots with a plan: their number, fraction and its 95 % interval."""

    count: int
    rate: float
    low: float
    high: float


class ReasonCount(TypedDict):
    """Robots without a plan for one reason.

    Reasons that differ in measured numbers alone are one, and the first of them stands for all.
    """

    reason: str
    status: str
    robots: int
    worlds: int


class PlanningSummary(TypedDict):
    """Planning of the robots of some worlds."""

    robots: PlannedRobots
    worlds: dict[str, int]
    """Number of worlds by planning status."""
    reasons: list[ReasonCount]
    """The commonest first."""


def summarise_planning(episodes: pa.Table) -> PlanningSummary | None:
    """Return how the robots of some worlds were planned for; None where they have a task.

    Args:
        episodes: rows of ``EPISODE_SCHEMA``.
    """
    progress = episodes["task_progress"]
    if progress.null_count < len(progress):
        return None
    return summarise_robots(
        episodes["world"].to_numpy(),
        np.asarray(episodes["planned"].to_numpy(zero_copy_only=False), bool),
        episodes["plan_status"].to_pylist(),
        episodes["plan_reason"].to_pylist(),
    )


def summarise_robots(
    world: np.ndarray,
    planned: np.ndarray,
    statuses: Sequence[str | None],
    reasons: Sequence[str | None],
) -> PlanningSummary:
    """Return the same of robots [n].

    Args:
        world: int [n] index of each robot's world, those of one world side by side.
        planned: bool [n] whether the robot has a plan.
        statuses: [n] of its world; None or empty where it is unknown.
        reasons: [n] why it has no plan; None or empty where it has one, or no reason was given.
    """
    status = [text or "" for text in statuses]
    reason = [text or NO_PATH for text in reasons]
    rate = confidence_intervals.clustered_rates({"yes": planned, "no": ~planned}, world)["yes"]
    first = np.unique(world, return_index=True)[1]
    return {
        "robots": {"count": rate.count, "rate": rate.rate, "low": rate.low, "high": rate.high},
        "worlds": dict(sorted(Counter(status[i] for i in first if status[i]).items())),
        "reasons": _count_reasons(world, np.flatnonzero(~planned), status, reason),
    }


def _count_reasons(
    world: np.ndarray, rows: np.ndarray, status: Sequence[str], reason: Sequence[str]
) -> list[ReasonCount]:
    kinds: dict[tuple[str, str], list[int]] = {}
    for row in rows.tolist():
        kinds.setdefault((status[row], _NUMBER.sub("#", reason[row])), []).append(row)
    listed: list[ReasonCount] = [
        {
            "reason": reason[members[0]],
            "status": kind,
            "robots": len(members),
            "worlds": len(set(world[members].tolist())),
        }
        for (kind, _), members in kinds.items()
    ]
    return sorted(listed, key=lambda entry: -entry["robots"])


def reason_lines(planning: PlanningSummary | None, noun: str = "robot") -> list[str]:
    """Return the commonest reasons of robots without a plan, a line each; none where planning is.

    Args:
        planning: as `summarise_planning` returns it.
        noun: what is counted: of benchmarks, whole teams.
    """
    listed = [] if planning is None else planning["reasons"]
    texts = [
        f"no plan for {_format_count(entry['robots'], noun)} in "
        f"{_format_count(entry['worlds'], 'world')}: "
        f"{entry['reason']}"
        for entry in listed[:MAX_REASONS]
    ]
    if len(listed) > MAX_REASONS:
        rest = sum(entry["robots"] for entry in listed[MAX_REASONS:])
        texts.append(f"no plan for {_format_count(rest, noun)}: other reasons (see plan_reason)")
    return texts


def format_percent(planning: PlanningSummary | None) -> str:
    """Return the fraction of robots with a plan for a table; a dash where nobody planned."""
    return "-" if planning is None else f"{100 * planning['robots']['rate']:.1f} %"


def planner_fault(planning: PlanningSummary | None) -> str | None:
    """Return why no world at all was planned, where the planner raised in each; else None."""
    if planning is None or planning["robots"]["count"]:
        return None
    if not planning["worlds"] or set(planning["worlds"]) - set(RAISED_STATUSES):
        return None
    worlds = sum(planning["worlds"].values())
    return f"planned none of {_format_count(worlds, 'world')}: {planning['reasons'][0]['reason']}"


class PlanningFailures:
    """Reports each kind of planner failure once, when it first occurs."""

    def __init__(self, report: Callable[[str], None]) -> None:
        """Begin without failures.

        Args:
            report: receives each message.
        """
        self._report = report
        self._kinds: set[str] = set()

    def add(self, worlds: np.ndarray, notes: PlanNotes | None) -> None:
        """Report new kinds of failure in some worlds.

        Args:
            worlds: [w] indices.
            notes: how they were planned; None on the device.
        """
        if notes is None:
            return
        for w in np.flatnonzero(np.isin(notes.status.astype(str), FAILED_STATUSES)):
            reason = str(notes.reason[w][0])
            kind = _NUMBER.sub("#", reason)
            if kind not in self._kinds and len(self._kinds) < MAX_REASONS:
                self._kinds.add(kind)
                self._report(f"world {int(worlds[w])} has no plan: {reason}")


def _format_count(number: int, noun: str) -> str:
    return f"{number:,} {noun}" if number == 1 else f"{number:,} {noun}s"


def early_lines(count: int) -> list[str]:
    """Return a line on robots that passed their goals early, none where no robot did.

    Args:
        count: robots that were at their goals before the last approaches of their plans.
    """
    if count == 0:
        return []
    robots = "1 robot" if count == 1 else f"{count:,} robots"
    return [
        f"{robots} passed the goal before the plan's last approach to it: not counted as arrival"
    ]
