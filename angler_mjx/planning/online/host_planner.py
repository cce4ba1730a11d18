"""A planner of the host, as what plans anew while the robots of one scene fly.

It plans in a process of its own, as before a start, and the compiled policy waits for it: what it
did not find within its deadline is no plan, and the robots brake and hold.
"""

from collections import Counter
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from angler_mjx.planning.problem import Problem
from angler_mjx.planning.register import PlannerReference, PlannerSpec
from angler_mjx.robot.control.trajectory import Trajectory, hold

if TYPE_CHECKING:
    from angler_mjx.planning.host.workers import Workers


@dataclass(frozen=True, kw_only=True)
class HostReplanner:
    """A planner with ``plan``."""

    reference: PlannerReference
    settings: tuple[tuple[str, Any], ...]
    points: int
    """Rows of its plans; who gives more is refused."""

    def __call__(self, problem: Problem) -> Trajectory:
        """Plans [R] of one problem."""
        start = problem.team.start_m
        like = jax.eval_shape(lambda at: hold(at, self.points), start)
        # The problem is all that an answer depends on, but for the clock.
        plans: Trajectory = jax.pure_callback(
            partial(_plan, self), like, problem, vmap_method="sequential"
        )
        return plans


def _plan(anew: HostReplanner, problem: Problem) -> Trajectory:
    """Asks the process; a robot without a plan stays at its start."""
    asked: Problem = jax.tree.map(np.asarray, problem)
    workers = _workers(anew)
    answer = workers.take(workers.submit(asked))
    if answer.status in FAILED:
        FAILURES[answer.reason] += 1
    start = np.asarray(asked.team.start_m)
    time: Any = np.zeros((asked.robots, anew.points), start.dtype)
    place: Any = np.repeat(start[:, None], anew.points, axis=1)
    found: Any = np.zeros(asked.robots, bool)
    for robot, path in enumerate(answer.paths):
        if isinstance(path, Trajectory):
            rows = path.time_s.shape[0]
            for all_rows, own in ((time, path.time_s), (place, path.position_m)):
                all_rows[robot, :rows] = own
                all_rows[robot, rows:] = all_rows[robot, rows - 1]
            found[robot] = True
    return Trajectory(time_s=time, position_m=place, found=found)


FAILED = ("error", "died", "timeout")
"""Statuses of problems for which the planner raised, or gave no answer in time."""

FAILURES: Counter[str] = Counter()
"""How often planning failed in flight since the last `take_failures`, by reason."""


def take_failures() -> list[tuple[str, int]]:
    """Return reasons for which planning failed in flight, and how often each; forgets them."""
    found = FAILURES.most_common()
    FAILURES.clear()
    return found


_PROCESSES: "dict[HostReplanner, Workers]" = {}
"""One process for each planner that was asked; they end with this one, or by `close`."""


def _workers(anew: HostReplanner) -> "Workers":
    if anew not in _PROCESSES:
        from angler_mjx.planning.host.workers import Workers

        spec = PlannerSpec(
            reference=anew.reference, settings=dict(anew.settings), most_points=anew.points
        )
        _PROCESSES[anew] = Workers(spec, 1)
    return _PROCESSES[anew]


def close() -> None:
    """End the processes that plan; who is asked later gets a new one."""
    while _PROCESSES:
        _PROCESSES.popitem()[1].close()
