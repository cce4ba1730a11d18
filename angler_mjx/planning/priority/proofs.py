"""Which teams nobody can plan whole: what can be proved, in NumPy, for tests and studies.

Each proof is a necessary condition of the planners' task: spheres that keep a clearance from each
other all the time and from rock, lines at cruise speed, arrival by the horizon and standing there.
That none of them holds proves nothing.
"""

import itertools

import numpy as np
from numpy.typing import NDArray

from angler_mjx.planning.problem import Problem

_SAFE = 1e-3
"""Rounding must not prove anything, m and share."""


def unsolvable(problem: Problem, margin_m: float) -> str | None:
    """Why the team of one world cannot be planned whole; None where that is not proved.

    Args:
        problem: arrays of NumPy.
        margin_m: that is kept beyond the radii between robots.
    """
    team = problem.team
    start, goal = np.asarray(team.start_m, float), np.asarray(team.goal_m, float)
    radius, speed = np.asarray(team.radius_m, float), np.asarray(team.cruise_speed_mps, float)
    for i, j in itertools.combinations(range(len(radius)), 2):
        reach = radius[i] + radius[j] + margin_m - _SAFE
        for what, place in (("starts", start), ("goals", goal)):
            if np.linalg.norm(place[i] - place[j]) < reach:
                return f"{what} of robots {i} and {j} are nearer to each other than they may be"
    needed = np.linalg.norm(goal - start, axis=1) / speed
    late = np.flatnonzero(needed > (1.0 + _SAFE) * problem.horizon_s)
    if late.size:
        return f"robot {late[0]} needs {needed[late[0]]:.0f} s along the straight line"
    rock = np.asarray(problem.grid.occupied)
    for robot, (a, b) in enumerate(zip(start, goal, strict=True)):
        first, last = _cell(problem, a), _cell(problem, b)
        if not _joined(~rock, first, last):
            return f"robot {robot} has rock between its start and its goal on all ways"
    return None


def _cell(problem: Problem, p: NDArray[np.float64]) -> tuple[int, ...]:
    """Cell that holds p [3]."""
    at = np.floor((p - np.asarray(problem.grid.origin_m)) / float(problem.grid.cell_m)).astype(int)
    inside = np.clip(at, 0, np.array(problem.grid.occupied.shape) - 1)
    return tuple(int(k) for k in inside)


def _joined(free: NDArray[np.bool_], a: tuple[int, ...], b: tuple[int, ...]) -> bool:
    """Whether two cells are joined over faces.

    A body with a radius passes no edge or corner between free cells if all else there is rock.
    """
    seen = np.zeros_like(free)
    seen[a] = free[a]
    while not seen[b]:
        wide = np.pad(seen, 1)
        grown = seen.copy()
        for axis in range(3):
            for step in (-1, 1):
                grown |= np.roll(wide, step, axis)[1:-1, 1:-1, 1:-1]
        grown &= free
        if (grown == seen).all():
            return False
        seen = grown
    return True
