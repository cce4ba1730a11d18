"""Proofs that a team cannot be planned whole, in NumPy, for tests and studies.

Each proof is a necessary condition of the planners' task: spheres that keep a clearance from each
other all the time and from rock, lines at cruise speed, arrival by the horizon and standing there.
Without a proof the team may still be impossible.
"""

import itertools

import numpy as np
from numpy.typing import NDArray

from angler_mjx.planning.problem import Problem

_TOLERANCE = 1e-3
"""Rounding must not prove anything, m and share."""


def prove_unsolvable(problem: Problem, margin_m: float) -> str | None:
    """Return the reason why a team cannot be planned whole; None without a proof.

    Args:
        problem: arrays of NumPy.
        margin_m: that is kept beyond the radii between robots.
    """
    team = problem.team
    start, goal = np.asarray(team.start_m, float), np.asarray(team.goal_m, float)
    radius, speed = np.asarray(team.radius_m, float), np.asarray(team.cruise_speed_mps, float)
    for i, j in itertools.combinations(range(len(radius)), 2):
        reach = radius[i] + radius[j] + margin_m - _TOLERANCE
        for end_name, position_m in (("starts", start), ("goals", goal)):
            if np.linalg.norm(position_m[i] - position_m[j]) < reach:
                return f"{end_name} of robots {i} and {j} are nearer to each other than they may be"
    needed_s = np.linalg.norm(goal - start, axis=1) / speed
    too_late = np.flatnonzero(needed_s > (1.0 + _TOLERANCE) * problem.horizon_s)
    if too_late.size:
        return f"robot {too_late[0]} needs {needed_s[too_late[0]]:.0f} s along the straight line"
    rock = np.asarray(problem.grid.occupied)
    for robot, (a, b) in enumerate(zip(start, goal, strict=True)):
        first, last = _cell_of(problem, a), _cell_of(problem, b)
        if not _are_connected(~rock, first, last):
            return f"robot {robot} has rock between its start and its goal on all ways"
    return None


def _cell_of(problem: Problem, p: NDArray[np.float64]) -> tuple[int, ...]:
    """Return the cell that holds p [3]."""
    at = np.floor((p - np.asarray(problem.grid.origin_m)) / float(problem.grid.cell_m)).astype(int)
    inside = np.clip(at, 0, np.array(problem.grid.occupied.shape) - 1)
    return tuple(int(k) for k in inside)


def _are_connected(free: NDArray[np.bool_], a: tuple[int, ...], b: tuple[int, ...]) -> bool:
    """Return whether two cells are joined over faces.

    A body with a radius passes no edge or corner between free cells if all else there is rock.
    """
    reached = np.zeros_like(free)
    reached[a] = free[a]
    while not reached[b]:
        padded = np.pad(reached, 1)
        next_reached = reached.copy()
        for axis in range(3):
            for step in (-1, 1):
                next_reached |= np.roll(padded, step, axis)[1:-1, 1:-1, 1:-1]
        next_reached &= free
        if (next_reached == reached).all():
            return False
        reached = next_reached
    return True
