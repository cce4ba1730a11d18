"""Replanning by a planner on the host, in the flight of one scene.

It plans in a process of its own, as before a start, and the compiled policy waits for it. Without
an answer within its deadline there is no plan, and the robots brake and hold.
"""

from collections import Counter
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from angler_mjx.planning.answers import FAILED_STATUSES
from angler_mjx.planning.problem import Problem
from angler_mjx.planning.register import PlannerReference, PlannerSpec
from angler_mjx.robot.control.commands.trajectory import Trajectory, hold_position

if TYPE_CHECKING:
    from angler_mjx.planning.host.workers import Workers


@dataclass(frozen=True, kw_only=True)
class HostReplanner:
    """A planner with ``plan``; hashable, static under jit."""

    reference: PlannerReference
    settings: tuple[tuple[str, object], ...]
    points: int
    """Rows of its plans; longer paths are refused."""

    def __call__(self, problem: Problem) -> Trajectory:
        """Return plans [R] of one problem; see `Replanning.planner`."""
        start = problem.team.start_m
        like = jax.eval_shape(lambda at: hold_position(at, self.points), start)
        # The problem is all that an answer depends on, but for the clock.
        plans: Trajectory = jax.pure_callback(
            partial(_plan_on_host, self), like, problem, vmap_method="sequential"
        )
        return plans


def _plan_on_host(replanner: HostReplanner, problem: Problem) -> Trajectory:
    """Plan by the worker process; a robot without a plan stays at its start."""
    host_problem: Problem = jax.tree.map(np.asarray, problem)
    workers = _find_workers(replanner)
    answer = workers.take(workers.submit(host_problem))
    if answer.status in FAILED_STATUSES:
        FAILURES[answer.reason] += 1
    start = np.asarray(host_problem.team.start_m)
    time: Any = np.zeros((host_problem.robots, replanner.points), start.dtype)
    position_m: Any = np.repeat(start[:, None], replanner.points, axis=1)
    is_found: Any = np.zeros(host_problem.robots, bool)
    for robot, path in enumerate(answer.paths):
        if isinstance(path, Trajectory):
            rows = path.time_s.shape[0]
            for all_rows, path_rows in ((time, path.time_s), (position_m, path.position_m)):
                all_rows[robot, :rows] = path_rows
                all_rows[robot, rows:] = all_rows[robot, rows - 1]
            is_found[robot] = True
    return Trajectory(time_s=time, position_m=position_m, found=is_found)


FAILURES: Counter[str] = Counter()
"""How often planning failed in flight since the last `take_failures`, by reason."""


def take_failures() -> list[tuple[str, int]]:
    """Return reasons for which planning failed in flight, and how often each; forgets them."""
    failures = FAILURES.most_common()
    FAILURES.clear()
    return failures


_PROCESSES: "dict[HostReplanner, Workers]" = {}
"""One process for each planner in use; they end with this one, or by `close_workers`."""


def _find_workers(replanner: HostReplanner) -> "Workers":
    if replanner not in _PROCESSES:
        from angler_mjx.planning.host.workers import Workers

        spec = PlannerSpec(
            reference=replanner.reference,
            settings=dict(replanner.settings),
            max_points=replanner.points,
        )
        _PROCESSES[replanner] = Workers(spec, 1)
    return _PROCESSES[replanner]


def close_workers() -> None:
    """End the processes that plan; later problems start new ones."""
    while _PROCESSES:
        _PROCESSES.popitem()[1].close()
