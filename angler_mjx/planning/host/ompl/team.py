"""From a problem to a motion of some of its robots, planned together.

A search finds a path, which is shortened and timed. Among known moving obstacles or fixed paths of
other robots, the robots wait at their starts until the path is free; if it never is, another path
is searched.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from angler_mjx.planning.host.edges import EdgeChecker
from angler_mjx.planning.host.ompl import problem_setup
from angler_mjx.planning.host.ompl.search import PlanningOrder, SearchSpace, search_path
from angler_mjx.planning.host.ompl.settings import OmplSettings, ompl_parameters
from angler_mjx.planning.host.ompl.shortcut import (
    NO_TRAFFIC,
    build_smoothing_problem,
    shorten_path,
    thin_path,
)
from angler_mjx.planning.host.ompl.timing import CurrentTooStrongError, robot_waypoints, time_path
from angler_mjx.planning.host.timed import Traffic
from angler_mjx.planning.path_search.bodies import GOAL_CLEAR_S
from angler_mjx.planning.problem import Problem

SEARCH_TIME_FRACTION = 0.9
"""Fraction of the remaining time for a search; the rest is for shortcuts and timing."""

MAX_ATTEMPTS = 20
"""Limit of searches where no wait makes a path free."""

MAX_DELAYS = 60
"""Times of setting off that are tried, `DELAY_STEP_S` or more apart."""

DELAY_STEP_S = 1.0

STAYS_S = (math.inf, GOAL_CLEAR_S)
"""How long the goal has to be free of obstacles that move after the arrival: for ever, or this
long. Other robots never go where one stands at its goal."""


class NoPathError(Exception):
    """There is no path; its text says why."""


@dataclass(frozen=True, kw_only=True)
class TeamMotion:
    """Of some robots."""

    time_s: np.ndarray
    """[n] from 0."""
    path: np.ndarray
    """[n, R, d] x, y, z (and heading)."""
    delay_s: float
    """For which all wait before."""


@dataclass(kw_only=True)
class TeamTask:
    """Planner, limits and notes of the planning of a team."""

    planner: str
    """OMPL's name."""
    settings: OmplSettings
    seed: tuple[int, ...]
    """Seed of the problem, followed by numbers of attempts."""
    end: float
    """Of `time.perf_counter`."""
    extras: dict[str, float] = field(default_factory=dict)
    progress: list[tuple[float, float]] = field(default_factory=list)
    """Of the search of the whole team: s since the first one began, and the best cost then."""

    def remaining_s(self) -> float:
        """Return the remaining time, s."""
        return self.end - time.perf_counter()

    def add_extras(self, more: dict[str, float]) -> None:
        """Add numbers to the notes."""
        for name, value in more.items():
            self.extras[name] = self.extras.get(name, 0.0) + value


def plan_motion(
    problem: Problem,
    robots: Sequence[int],
    task: TeamTask,
    traffic: Traffic | None = None,
    time_fraction: float = 1.0,
) -> TeamMotion:
    """Return a motion of some robots from their starts to their goals.

    Args:
        problem: arrays of NumPy.
        robots: which.
        task: how.
        traffic: paths of others; none if left out.
        time_fraction: of the time that is left, for all of this.

    Raises:
        BlockedRobotError: a start or goal is taken.
        NoPathError: there is no path.
    """
    begin = time.perf_counter()
    settings = task.settings
    checks = problem_setup.build_checker(problem, robots, settings.margin_m)
    low, high = problem_setup.space_bounds(problem, robots, settings.heading)
    width = 4 if settings.heading else 3
    space = SearchSpace(
        low=low,
        high=high,
        checked_columns=[i for i in range(len(low)) if i % width < 3],
        edge=checks.edge_flat,
        state=checks.state_flat,
    )
    task.add_extras({"setup_s": time.perf_counter() - begin})
    end = begin + time_fraction * max(0.0, task.end - begin)
    reason = ""
    for attempt in range(MAX_ATTEMPTS):
        if attempt and time.perf_counter() >= end:
            break
        try:
            path = _search_path(problem, robots, task, space, checks, end, attempt)
        except NoPathError:
            if reason:  # what was wrong with the way that was found tells more
                break
            raise
        try:
            time_s, path = _time_path(path, problem, list(robots), settings, checks)
        except CurrentTooStrongError as error:
            reason = str(error)
            continue
        if time_s[-1] > problem.horizon_s:
            reason = f"the way takes {time_s[-1]:.0f} s of {problem.horizon_s:.0f} s"
            continue
        delay = _find_delay(
            problem, robots, checks, settings.margin_m, time_s, path, traffic or NO_TRAFFIC
        )
        if delay is not None:
            task.add_extras({"delay_s": delay, "attempts": attempt + 1.0})
            return TeamMotion(time_s=time_s, path=path, delay_s=delay)
        reason = "what moves is in the way, however long it waits"
    raise NoPathError(reason)


def _time_path(
    path: np.ndarray,
    problem: Problem,
    robots: list[int],
    settings: OmplSettings,
    checks: EdgeChecker,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the path in time with few enough points of each robot; None if there is none."""
    time_s, timed_path = time_path(path, problem, robots, settings)
    max_points = settings.points - 1
    if len(time_s) <= max_points:
        return time_s, timed_path
    if (
        max(
            len(robot_waypoints(time_s, timed_path[:, robot], 0.0)[0])
            for robot in range(len(robots))
        )
        <= max_points
    ):
        return time_s, timed_path
    speed = np.asarray(problem.team.cruise_speed_mps, float)[robots]
    return time_path(
        thin_path(path, build_smoothing_problem(checks), speed, max_points),
        problem,
        robots,
        settings,
    )


def _search_path(
    problem: Problem,
    robots: Sequence[int],
    task: TeamTask,
    space: SearchSpace,
    checks: EdgeChecker,
    end: float,
    attempt: int,
) -> np.ndarray:
    """Return a path [k, R, d], simplified as the settings demand."""
    settings = task.settings
    start, goal = problem_setup.start_and_goal(problem, robots, settings.heading)
    remaining_s = max(0.0, end - time.perf_counter())
    order = PlanningOrder(
        planner=task.planner,
        parameters=ompl_parameters(settings),
        seed=(*task.seed, attempt),
        limit_s=SEARCH_TIME_FRACTION * remaining_s,
        edge_limit=settings.edge_limit,
        first=settings.first,
        simplify_s=(1.0 - SEARCH_TIME_FRACTION) * remaining_s
        if settings.simplify == "ompl"
        else 0.0,
    )
    searched_s = task.extras.get("search_s", 0.0)
    result = search_path(space, start.reshape(-1), goal.reshape(-1), order)
    task.add_extras(result.extras)
    task.progress = [(searched_s + when, cost) for when, cost in result.progress]
    if result.points is None:
        raise NoPathError(f"no way found in {order.limit_s:.3g} s")
    path = result.points.reshape(-1, *start.shape)
    path[0], path[-1] = start, goal
    if settings.simplify == "shortcut":
        begin = time.perf_counter()
        speed = np.asarray(problem.team.cruise_speed_mps, float)[list(robots)]
        path = shorten_path(path, build_smoothing_problem(checks), speed, end)
        task.add_extras({"simplify_s": time.perf_counter() - begin})
    return path


def _find_delay(
    problem: Problem,
    robots: Sequence[int],
    checks: EdgeChecker,
    margin_m: float,
    time_s: np.ndarray,
    path: np.ndarray,
    traffic: Traffic,
) -> float | None:
    """Return the wait of all robots that avoids all that moves; None if none does."""
    obstacles = problem.obstacles
    is_moving = np.asarray(obstacles.exists, bool) & np.asarray(obstacles.moves, bool)
    if not is_moving.any() and len(traffic.radius_m) == 0:
        return 0.0
    max_delay_s = max(0.0, problem.horizon_s - time_s[-1])
    delays_s = np.arange(0.0, max_delay_s + 1e-9, max(DELAY_STEP_S, max_delay_s / MAX_DELAYS))
    for stay_s in STAYS_S if is_moving.any() else STAYS_S[:1]:
        static_checks = (
            _checker_without_moving(problem, robots, margin_m) if stay_s < math.inf else checks
        )
        for delay_s in map(float, delays_s):
            is_clear = _is_clear_with_delay(checks, time_s, path, traffic, delay_s, stay_s)
            if is_clear and _can_stay_at_goals(
                static_checks, path[-1], time_s[-1] + delay_s, stay_s, traffic
            ):
                return delay_s
    return None


def _can_stay_at_goals(
    static_checks: EdgeChecker, ends: np.ndarray, arrival_s: float, stay_s: float, traffic: Traffic
) -> bool:
    """Return whether other robots stay clear of robots that stand at their goals.

    Asked only where `_is_clear_with_delay` has looked for a while: it knows already where it looked
    for ever.
    """
    return stay_s == math.inf or all(
        static_checks.timed_edge(k, end[:3], arrival_s, end[:3], math.inf, traffic)
        for k, end in enumerate(ends)
    )


def _checker_without_moving(
    problem: Problem, robots: Sequence[int], margin_m: float
) -> EdgeChecker:
    """Return the edge checker without moving obstacles."""
    obstacles = problem.obstacles
    is_static = np.asarray(obstacles.exists, bool) & ~np.asarray(obstacles.moves, bool)
    return problem_setup.build_checker(
        replace(problem, obstacles=replace(obstacles, exists=is_static)), robots, margin_m
    )


def _is_clear_with_delay(
    checks: EdgeChecker,
    time_s: np.ndarray,
    path: np.ndarray,
    traffic: Traffic,
    delay_s: float,
    stay_s: float,
) -> bool:
    """Return whether all can go after a wait, and stay at their goals."""
    begin = np.concatenate([[0.0], time_s[:-1] + delay_s, [time_s[-1] + delay_s]])
    end = np.concatenate([[delay_s], time_s[1:] + delay_s, [time_s[-1] + delay_s + stay_s]])
    for robot in range(path.shape[1]):
        position_m = path[:, robot, :3]
        a = np.concatenate([position_m[:1], position_m[:-1], position_m[-1:]])
        b = np.concatenate([position_m[:1], position_m[1:], position_m[-1:]])
        if not checks.timed_edges(robot, a, begin, b, end, traffic).all():
            return False
    return True
