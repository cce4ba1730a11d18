"""Search of one robot in space and time, for robots that a later departure does not help.

States are x, y, z and the time, in metres at the robot's speed; an edge goes forward in time,
within the robot's speed, and meets nothing. The goal is reached at a chosen time, of which several
are tried, the earliest first. OMPL's tree planners check edges from the earlier state to the later;
where a planner takes an edge in both directions, its path may run back in time, and is not used.
"""

import time
from collections.abc import Sequence

import numpy as np

from angler_mjx.planning.host.edges import EdgeChecker
from angler_mjx.planning.host.ompl import problem_setup
from angler_mjx.planning.host.ompl.search import PlanningOrder, SearchSpace, search_path
from angler_mjx.planning.host.ompl.settings import ompl_parameters
from angler_mjx.planning.host.ompl.shortcut import build_smoothing_problem, shorten_path, thin_path
from angler_mjx.planning.host.ompl.still_water_timing import SPEED_FACTOR
from angler_mjx.planning.host.ompl.team import NoPathError, TeamMotion, TeamTask
from angler_mjx.planning.host.ompl.timing import max_ground_speed, timing_limits, water_velocity
from angler_mjx.planning.host.timed import Traffic
from angler_mjx.planning.problem import Problem

ARRIVAL_FACTORS = (1.2, 1.6, 2.4, 4.0)
"""Arrival times that are tried, as multiples of the duration of the straight line."""

MIN_PATH_LENGTH_M = 2.0
"""Least length [m] by which arrival times are computed."""


class _SpacetimeChecker:
    """Edges of one robot in space and time."""

    def __init__(self, checks: EdgeChecker, speed: float, traffic: Traffic) -> None:
        self.checks, self.speed, self.traffic = checks, speed, traffic
        self.smoothing = build_smoothing_problem(checks, traffic, speed)

    def is_edge_free(self, a: np.ndarray, b: np.ndarray) -> bool:
        clock_m, step_m = b[3] - a[3], b[:3] - a[:3]
        if clock_m <= 0.0 or step_m @ step_m > (SPEED_FACTOR * clock_m) ** 2:
            return False
        return self.checks.timed_edge(
            0, a[:3], a[3] / self.speed, b[:3], b[3] / self.speed, self.traffic
        )

    def is_state_free(self, p: np.ndarray) -> bool:
        time_s = p[3] / self.speed
        return self.checks.timed_edge(0, p[:3], time_s, p[:3], time_s, self.traffic)

    def are_edges_free(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Check edges a, b [n, 1, 4]."""
        a, b = a[:, 0], b[:, 0]
        clock_m, length_m = b[:, 3] - a[:, 3], np.linalg.norm(b[:, :3] - a[:, :3], axis=1)
        is_slow_enough = (clock_m > 0.0) & (length_m <= SPEED_FACTOR * clock_m)
        free = np.zeros(len(a), bool)
        free[is_slow_enough] = self.checks.timed_edges(
            0,
            a[is_slow_enough, :3],
            a[is_slow_enough, 3] / self.speed,
            b[is_slow_enough, :3],
            b[is_slow_enough, 3] / self.speed,
            self.traffic,
        )
        return free

    def can_stay(self, p: np.ndarray, when: float) -> bool:
        return self.checks.timed_edge(0, p, when, p, np.inf, self.traffic)


def plan_spacetime_motion(
    problem: Problem, robots: Sequence[int], task: TeamTask, traffic: Traffic, time_fraction: float
) -> TeamMotion:
    """Return a motion of one robot among the paths of others.

    Args:
        problem: arrays of NumPy.
        robots: which; one.
        task: how.
        traffic: paths of the others.
        time_fraction: of the time that is left, for all of this.

    Raises:
        BlockedRobotError: its start or goal is taken.
        NoPathError: there is no path.
    """
    begin = time.perf_counter()
    end = begin + time_fraction * max(0.0, task.end - begin)
    checks = problem_setup.build_checker(problem, robots, task.settings.margin_m)
    (start,), (goal,) = problem_setup.start_and_goal(problem, robots, heading=False)
    bounds = timing_limits(
        problem, list(robots), task.settings.thrust_share, task.settings.turn_radps
    )
    speed = float(bounds.cruise_mps[0])
    straight_s = max(MIN_PATH_LENGTH_M, float(np.linalg.norm(goal - start))) / speed
    reason = "what moves is in the way at every time that was tried"
    for attempt, factor in enumerate(ARRIVAL_FACTORS):
        arrival_s = factor * straight_s
        spacetime = _SpacetimeChecker(checks, speed, traffic)
        if arrival_s > problem.horizon_s or not spacetime.can_stay(goal, arrival_s):
            continue
        spent = (time.perf_counter() - begin) / max(end - begin, 1e-9)
        if spent >= 1.0:
            break
        limit = (end - time.perf_counter()) / (len(ARRIVAL_FACTORS) - attempt)
        path = _search_states(
            problem, robots, task, spacetime, (start, goal), arrival_s, limit, attempt
        )
        if path is None:
            continue
        time_s = path[:, 3] / speed
        if not _is_slow_enough(problem, path, time_s, robots, task):
            reason = "the current is too strong for the times that were tried"
            continue
        positions = path[:, None, :3]
        if task.settings.heading:
            yaw = float(np.asarray(problem.team.start_yaw_rad)[robots[0]])
            positions = np.concatenate([positions, np.full_like(positions[..., :1], yaw)], axis=-1)
        task.add_extras({"attempts": attempt + 1.0})
        return TeamMotion(time_s=time_s, path=positions, delay_s=0.0)
    raise NoPathError(reason)


def _search_states(
    problem: Problem,
    robots: Sequence[int],
    task: TeamTask,
    spacetime: _SpacetimeChecker,
    ends: tuple[np.ndarray, np.ndarray],
    arrival: float,
    limit: float,
    attempt: int,
) -> np.ndarray | None:
    """Return states [k, 4] from the start at t = 0 to the goal at its time; None without a path."""
    low, high = problem_setup.space_bounds(problem, robots, heading=False)
    last = arrival * spacetime.speed
    space = SearchSpace(
        low=np.append(low, 0.0),
        high=np.append(high, last),
        checked_columns=[0, 1, 2, 3],
        edge=spacetime.is_edge_free,
        state=spacetime.is_state_free,
    )
    start, goal = np.append(ends[0], 0.0), np.append(ends[1], last)
    if spacetime.is_edge_free(start, goal):
        path = np.stack([start, goal])
    else:
        order = PlanningOrder(
            planner=task.planner,
            parameters=ompl_parameters(task.settings),
            seed=(*task.seed, attempt),
            limit_s=limit,
            edge_limit=task.settings.edge_limit,
            first=True,
        )
        result = search_path(space, start, goal, order)
        task.add_extras(result.extras)
        if result.points is None:
            return None
        path = result.points
    path[0], path[-1] = start, goal
    if not spacetime.are_edges_free(path[:-1, None], path[1:, None]).all():
        return None
    if task.settings.simplify != "none":
        until = time.perf_counter() + limit
        path = shorten_path(path[:, None], spacetime.smoothing, np.array([spacetime.speed]), until)[
            :, 0
        ]
    max_points = task.settings.points
    if len(path) > max_points:
        path = thin_path(
            path[:, None], spacetime.smoothing, np.array([spacetime.speed]), max_points
        )[:, 0]
    return path


def _is_slow_enough(
    problem: Problem, path: np.ndarray, time_s: np.ndarray, robots: Sequence[int], task: TeamTask
) -> bool:
    """Return whether the robot reaches the speed in the current at both ends of each edge."""
    if not problem.current.components:
        return True
    bounds = timing_limits(
        problem, list(robots), task.settings.thrust_share, task.settings.turn_radps
    )
    step_m = np.diff(path[:, :3], axis=0)
    length = np.linalg.norm(step_m, axis=1)
    direction = step_m / np.maximum(length, 1e-12)[:, None]
    max_speed = np.inf
    for fraction in (0.0, 0.5, 1.0):
        water = water_velocity(problem, path[:, None, :3], time_s, fraction)
        max_speed = np.minimum(max_speed, max_ground_speed(direction[:, None], water, bounds)[:, 0])
    return bool((length <= max_speed * np.diff(time_s) + 1e-6).all())
