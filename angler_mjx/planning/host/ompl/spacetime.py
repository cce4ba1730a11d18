"""One robot's search in space and time, where it cannot just set off later.

States are x, y, z and the time, as the metres that the robot could have gone by then; an edge goes
forward in time, is no faster than the robot may be, and meets nothing on its way. The goal is to be
reached at a chosen time, and several are tried, the earliest first. OMPL's tree planners ask for
edges from the earlier state to the later; where a planner takes an edge for one that can be flown
both ways, its path may run back in time, and is not taken.
"""

import time
from collections.abc import Sequence

import numpy as np

from angler_mjx.planning.host.edges import EdgeChecker
from angler_mjx.planning.host.ompl import seeing
from angler_mjx.planning.host.ompl.search import PlanningOrder, Space, search
from angler_mjx.planning.host.ompl.settings import parameters
from angler_mjx.planning.host.ompl.shortcut import shortened, thinned, ways
from angler_mjx.planning.host.ompl.still import SAFE
from angler_mjx.planning.host.ompl.team import NoWayError, TeamMotion, TeamTask
from angler_mjx.planning.host.ompl.timing import fastest, limits, water_at
from angler_mjx.planning.host.timed import Traffic
from angler_mjx.planning.problem import Problem

LONGER = (1.2, 1.6, 2.4, 4.0)
"""Times of arrival that are tried, in times that the straight way takes."""

SHORTEST_WAY_M = 2.0
"""Of a way that is shorter, the time is reckoned as for this."""


class _Clock:
    """Edges of one robot in space and time."""

    def __init__(self, checks: EdgeChecker, speed: float, traffic: Traffic) -> None:
        self.checks, self.speed, self.traffic = checks, speed, traffic
        self.ways = ways(checks, traffic, speed)

    def edge(self, a: np.ndarray, b: np.ndarray) -> bool:
        gone, way = b[3] - a[3], b[:3] - a[:3]
        if gone <= 0.0 or way @ way > (SAFE * gone) ** 2:
            return False
        return self.checks.timed_edge(
            0, a[:3], a[3] / self.speed, b[:3], b[3] / self.speed, self.traffic
        )

    def state(self, p: np.ndarray) -> bool:
        when = p[3] / self.speed
        return self.checks.timed_edge(0, p[:3], when, p[:3], when, self.traffic)

    def edges(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Of a, b [n, 1, 4]."""
        a, b = a[:, 0], b[:, 0]
        gone, way = b[:, 3] - a[:, 3], np.linalg.norm(b[:, :3] - a[:, :3], axis=1)
        slow = (gone > 0.0) & (way <= SAFE * gone)
        free = np.zeros(len(a), bool)
        free[slow] = self.checks.timed_edges(
            0,
            a[slow, :3],
            a[slow, 3] / self.speed,
            b[slow, :3],
            b[slow, 3] / self.speed,
            self.traffic,
        )
        return free

    def stays(self, p: np.ndarray, when: float) -> bool:
        return self.checks.timed_edge(0, p, when, p, np.inf, self.traffic)


def motion(
    problem: Problem, robots: Sequence[int], task: TeamTask, traffic: Traffic, share: float
) -> TeamMotion:
    """A motion of one robot among the paths of others.

    Args:
        problem: arrays of NumPy.
        robots: which; one.
        task: how.
        traffic: paths of the others.
        share: of the time that is left, for all of this.

    Raises:
        seeing.CannotError: its start or goal is taken.
        NoWayError: there is no path.
    """
    begin = time.perf_counter()
    end = begin + share * max(0.0, task.end - begin)
    checks = seeing.checker(problem, robots, task.settings.margin_m)
    (start,), (goal,) = seeing.ends(problem, robots, heading=False)
    bounds = limits(problem, list(robots), task.settings.thrust_share, task.settings.turn_radps)
    speed = float(bounds.cruise_mps[0])
    straight = max(SHORTEST_WAY_M, float(np.linalg.norm(goal - start))) / speed
    reason = "what moves is in the way at every time that was tried"
    for attempt, longer in enumerate(LONGER):
        arrival = longer * straight
        clock = _Clock(checks, speed, traffic)
        if arrival > problem.horizon_s or not clock.stays(goal, arrival):
            continue
        spent = (time.perf_counter() - begin) / max(end - begin, 1e-9)
        if spent >= 1.0:
            break
        limit = (end - time.perf_counter()) / (len(LONGER) - attempt)
        path = _searched(problem, robots, task, clock, (start, goal), arrival, limit, attempt)
        if path is None:
            continue
        when = path[:, 3] / speed
        if not _slow(problem, path, when, robots, task):
            reason = "the current is too strong for the times that were tried"
            continue
        place = path[:, None, :3]
        if task.settings.heading:
            yaw = float(np.asarray(problem.team.start_yaw_rad)[robots[0]])
            place = np.concatenate([place, np.full_like(place[..., :1], yaw)], axis=-1)
        task.note({"attempts": attempt + 1.0})
        return TeamMotion(time_s=when, path=place, delay_s=0.0)
    raise NoWayError(reason)


def _searched(
    problem: Problem,
    robots: Sequence[int],
    task: TeamTask,
    clock: _Clock,
    ends: tuple[np.ndarray, np.ndarray],
    arrival: float,
    limit: float,
    attempt: int,
) -> np.ndarray | None:
    """States [k, 4] from the start at t = 0 to the goal at its time; None where none was found."""
    low, high = seeing.bounds(problem, robots, heading=False)
    last = arrival * clock.speed
    space = Space(
        low=np.append(low, 0.0),
        high=np.append(high, last),
        looked_at=[0, 1, 2, 3],
        edge=clock.edge,
        state=clock.state,
    )
    start, goal = np.append(ends[0], 0.0), np.append(ends[1], last)
    if clock.edge(start, goal):
        path = np.stack([start, goal])
    else:
        order = PlanningOrder(
            planner=task.planner,
            parameters=parameters(task.settings),
            seed=(*task.seed, attempt),
            limit_s=limit,
            edge_limit=task.settings.edge_limit,
            first=True,
        )
        found = search(space, start, goal, order)
        task.note(found.extras)
        if found.points is None:
            return None
        path = found.points
    path[0], path[-1] = start, goal
    if not clock.edges(path[:-1, None], path[1:, None]).all():
        return None
    if task.settings.simplify != "none":
        until = time.perf_counter() + limit
        path = shortened(path[:, None], clock.ways, np.array([clock.speed]), until)[:, 0]
    most = task.settings.points
    if len(path) > most:
        path = thinned(path[:, None], clock.ways, np.array([clock.speed]), most)[:, 0]
    return path


def _slow(
    problem: Problem, path: np.ndarray, when: np.ndarray, robots: Sequence[int], task: TeamTask
) -> bool:
    """Whether the robot can be as fast as that in the current, at both ends of each edge."""
    if not problem.current.components:
        return True
    bounds = limits(problem, list(robots), task.settings.thrust_share, task.settings.turn_radps)
    way = np.diff(path[:, :3], axis=0)
    length = np.linalg.norm(way, axis=1)
    ahead = way / np.maximum(length, 1e-12)[:, None]
    most = np.inf
    for part in (0.0, 0.5, 1.0):
        water = water_at(problem, path[:, None, :3], when, part)
        most = np.minimum(most, fastest(ahead[:, None], water, bounds)[:, 0])
    return bool((length <= most * np.diff(when) + 1e-6).all())
