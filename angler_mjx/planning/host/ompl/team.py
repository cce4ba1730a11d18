"""From a problem to a motion of some of its robots, planned together.

A search finds a path, shortcuts make it straighter, and it is timed. Where obstacles are known to
move, or other robots' paths are fixed, the robots wait at their starts until the way is free; if it
never is, another path is searched.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from angler_mjx.planning.host.edges import EdgeChecker
from angler_mjx.planning.host.ompl import seeing
from angler_mjx.planning.host.ompl.search import PlanningOrder, Space, search
from angler_mjx.planning.host.ompl.settings import Common, parameters
from angler_mjx.planning.host.ompl.shortcut import NOBODY, shortened, thinned, ways
from angler_mjx.planning.host.ompl.timing import TooStrongError, apart, timed
from angler_mjx.planning.host.timed import Traffic
from angler_mjx.planning.path_search.bodies import STANDS_S
from angler_mjx.planning.problem import Problem

SEARCH = 0.9
"""Of the time that is left, for a search; the rest for what is made of its path."""

ATTEMPTS = 20
"""Paths that are searched where robots cannot wait until the way is free."""

WAITS = 60
"""Times of setting off that are tried, `WAIT_S` or more apart."""

WAIT_S = 1.0

STAYS_S = (math.inf, STANDS_S)
"""How long the goal has to be free of obstacles that move after the arrival: for ever, or this
long. Other robots never go where one stands at its goal."""


class NoWayError(Exception):
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
    """What is planned, and what was noted on the way."""

    planner: str
    """OMPL's name."""
    settings: Common
    seed: tuple[int, ...]
    """Of the problem; and more, for what is tried beside."""
    end: float
    """Of `time.perf_counter`."""
    extras: dict[str, float] = field(default_factory=dict)
    progress: list[tuple[float, float]] = field(default_factory=list)
    """Of the search of the whole team: s since the first one began, and the best cost then."""

    def left(self) -> float:
        """Time that is left, s."""
        return self.end - time.perf_counter()

    def note(self, more: dict[str, float]) -> None:
        """Adds to what was noted."""
        for name, value in more.items():
            self.extras[name] = self.extras.get(name, 0.0) + value


def motion(
    problem: Problem,
    robots: Sequence[int],
    task: TeamTask,
    traffic: Traffic | None = None,
    share: float = 1.0,
) -> TeamMotion:
    """A motion of some robots from their starts to their goals.

    Args:
        problem: arrays of NumPy.
        robots: which.
        task: how.
        traffic: paths of others; none if left out.
        share: of the time that is left, for all of this.

    Raises:
        seeing.CannotError: a start or goal is taken.
        NoWayError: there is no path.
    """
    begin = time.perf_counter()
    settings = task.settings
    checks = seeing.checker(problem, robots, settings.margin_m)
    low, high = seeing.bounds(problem, robots, settings.heading)
    width = 4 if settings.heading else 3
    space = Space(
        low=low,
        high=high,
        looked_at=[i for i in range(len(low)) if i % width < 3],
        edge=checks.edge_flat,
        state=checks.state_flat,
    )
    task.note({"setup_s": time.perf_counter() - begin})
    end = begin + share * max(0.0, task.end - begin)
    reason = ""
    for attempt in range(ATTEMPTS):
        if attempt and time.perf_counter() >= end:
            break
        try:
            path = _searched(problem, robots, task, space, checks, end, attempt)
        except NoWayError:
            if reason:  # what was wrong with the way that was found tells more
                break
            raise
        try:
            when, path = _flown(path, problem, list(robots), settings, checks)
        except TooStrongError as error:
            reason = str(error)
            continue
        if when[-1] > problem.horizon_s:
            reason = f"the way takes {when[-1]:.0f} s of {problem.horizon_s:.0f} s"
            continue
        delay = _delay(problem, robots, checks, settings.margin_m, when, path, traffic or NOBODY)
        if delay is not None:
            task.note({"delay_s": delay, "attempts": attempt + 1.0})
            return TeamMotion(time_s=when, path=path, delay_s=delay)
        reason = "what moves is in the way, however long it waits"
    raise NoWayError(reason)


def _flown(
    path: np.ndarray, problem: Problem, robots: list[int], settings: Common, checks: EdgeChecker
) -> tuple[np.ndarray, np.ndarray]:
    """A path in time, with as few points of each robot as can be flown, if there is such a one."""
    when, flown = timed(path, problem, robots, settings)
    most = settings.points - 1
    if len(when) <= most:
        return when, flown
    if max(len(apart(when, flown[:, robot], 0.0)[0]) for robot in range(len(robots))) <= most:
        return when, flown
    speed = np.asarray(problem.team.cruise_speed_mps, float)[robots]
    return timed(thinned(path, ways(checks), speed, most), problem, robots, settings)


def _searched(
    problem: Problem,
    robots: Sequence[int],
    task: TeamTask,
    space: Space,
    checks: EdgeChecker,
    end: float,
    attempt: int,
) -> np.ndarray:
    """A path [k, R, d], as straight as was chosen."""
    settings = task.settings
    start, goal = seeing.ends(problem, robots, settings.heading)
    left = max(0.0, end - time.perf_counter())
    order = PlanningOrder(
        planner=task.planner,
        parameters=parameters(settings),
        seed=(*task.seed, attempt),
        limit_s=SEARCH * left,
        edge_limit=settings.edge_limit,
        first=settings.first,
        simplify_s=(1.0 - SEARCH) * left if settings.simplify == "ompl" else 0.0,
    )
    before = task.extras.get("search_s", 0.0)
    found = search(space, start.reshape(-1), goal.reshape(-1), order)
    task.note(found.extras)
    task.progress = [(before + when, cost) for when, cost in found.progress]
    if found.points is None:
        raise NoWayError(f"no way found in {order.limit_s:.3g} s")
    path = found.points.reshape(-1, *start.shape)
    path[0], path[-1] = start, goal
    if settings.simplify == "shortcut":
        begin = time.perf_counter()
        speed = np.asarray(problem.team.cruise_speed_mps, float)[list(robots)]
        path = shortened(path, ways(checks), speed, end)
        task.note({"simplify_s": time.perf_counter() - begin})
    return path


def _delay(
    problem: Problem,
    robots: Sequence[int],
    checks: EdgeChecker,
    margin_m: float,
    when: np.ndarray,
    path: np.ndarray,
    traffic: Traffic,
) -> float | None:
    """How long all have to wait so that nothing that moves is met; None if it always is."""
    known = problem.obstacles
    drift = np.asarray(known.exists, bool) & np.asarray(known.moves, bool)
    if not drift.any() and len(traffic.radius_m) == 0:
        return 0.0
    room = max(0.0, problem.horizon_s - when[-1])
    waits = np.arange(0.0, room + 1e-9, max(WAIT_S, room / WAITS))
    for stays in STAYS_S if drift.any() else STAYS_S[:1]:
        alone = _without_drift(problem, robots, margin_m) if stays < math.inf else checks
        for wait in map(float, waits):
            clear = _clear(checks, when, path, traffic, wait, stays)
            if clear and _may_stand(alone, path[-1], when[-1] + wait, stays, traffic):
                return wait
    return None


def _may_stand(
    alone: EdgeChecker, ends: np.ndarray, over: float, stays: float, traffic: Traffic
) -> bool:
    """Whether no other robot ever comes where some stand at their goals.

    Asked only where `_clear` has looked for a while: it knows already where it looked for ever.
    """
    return stays == math.inf or all(
        alone.timed_edge(k, end[:3], over, end[:3], math.inf, traffic) for k, end in enumerate(ends)
    )


def _without_drift(problem: Problem, robots: Sequence[int], margin_m: float) -> EdgeChecker:
    """What looks at edges as if no obstacle moved."""
    known = problem.obstacles
    stay = np.asarray(known.exists, bool) & ~np.asarray(known.moves, bool)
    return seeing.checker(replace(problem, obstacles=replace(known, exists=stay)), robots, margin_m)


def _clear(
    checks: EdgeChecker,
    when: np.ndarray,
    path: np.ndarray,
    traffic: Traffic,
    wait: float,
    stays: float,
) -> bool:
    """Whether all can go after a wait, and stay at their goals."""
    begin = np.concatenate([[0.0], when[:-1] + wait, [when[-1] + wait]])
    end = np.concatenate([[wait], when[1:] + wait, [when[-1] + wait + stays]])
    for robot in range(path.shape[1]):
        place = path[:, robot, :3]
        a = np.concatenate([place[:1], place[:-1], place[-1:]])
        b = np.concatenate([place[:1], place[1:], place[-1:]])
        if not checks.timed_edges(robot, a, begin, b, end, traffic).all():
            return False
    return True
