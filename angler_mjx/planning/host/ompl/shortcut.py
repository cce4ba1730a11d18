"""Straightening and thinning of a team's path, by whole batches of edges.

Edges between all points of the path, and some between them, are checked, and the quickest path over
free edges is taken; then single robots are straightened while the others keep their paths. There
are no random draws, so equal paths have equal results.
"""

import time

import numpy as np

from angler_mjx.planning.host.edges import EdgeChecker
from angler_mjx.planning.host.ompl.straightening import (
    SmoothingProblem,
    reduce_points,
    shortest_through_points,
    straighten_path,
)
from angler_mjx.planning.host.timed import Traffic

MAX_ROUNDS = 4
"""Of straightening, each from the path of the one before."""

MIN_IMPROVEMENT = 1e-3
"""Share of its cost by which a round has to shorten a path for another."""

MAX_PIECES = 96
"""Pieces of a path in which no path through its own points has few enough."""

MAX_THINNED_POINTS = 400
"""Points of a path that is thinned; one with more is left."""

NO_TRAFFIC = Traffic.none()
"""Nothing is met."""


def build_smoothing_problem(
    checks: EdgeChecker, traffic: Traffic = NO_TRAFFIC, clock_mps: float = 0.0
) -> SmoothingProblem:
    """Build the problem against which edges are checked.

    Args:
        checks: of the team.
        traffic: that one robot meets in space and time.
        clock_mps: over which the fourth number of its places is its time; 0: places have no time.
    """
    return SmoothingProblem(
        *checks.packed, traffic.time_s, traffic.position_m, traffic.radius_m, float(clock_mps)
    )


def shorten_path(
    points: np.ndarray, smoothing: SmoothingProblem, speed: np.ndarray, end: float
) -> np.ndarray:
    """Return a quicker path, or the same.

    Args:
        points: [k, R, d] of the team; x, y, z first. Its edges are free.
        smoothing: problem of the edge checks.
        speed: [R] m/s of each robot.
        end: of `time.perf_counter`; no round begins after it.
    """
    path = shortest_through_points(smoothing, np.ascontiguousarray(points), speed)
    for _ in range(MAX_ROUNDS):
        if time.perf_counter() > end or len(path) == 2:
            break
        path, before, after = straighten_path(smoothing, path, speed)
        if after > (1.0 - MIN_IMPROVEMENT) * before:
            break
    return path


def thin_path(
    points: np.ndarray, smoothing: SmoothingProblem, speed: np.ndarray, max_points: int
) -> np.ndarray:
    """Return the quickest path through few enough points of a path, or the same.

    Args:
        points: [k, R, d] of the team; its edges are free.
        smoothing: problem of the edge checks.
        speed: [R] m/s of each robot.
        max_points: points that there may be.
    """
    if not 2 <= max_points < len(points) <= MAX_THINNED_POINTS:
        return points
    for pieces in (0, MAX_PIECES):
        thin = reduce_points(smoothing, np.ascontiguousarray(points), speed, max_points, pieces)
        if len(thin):
            return thin
    return points
