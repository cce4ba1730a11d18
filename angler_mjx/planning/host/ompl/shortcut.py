"""Straightening a team's path, and thinning it, by whole batches of edges.

All points of the path and some between them are tried against each other, and the quickest way
through those that can be joined is taken; then single robots are straightened while the others
keep their ways. Nothing is drawn, so the same path becomes the same.
"""

import time

import numpy as np

from angler_mjx.planning.host.edges import EdgeChecker
from angler_mjx.planning.host.ompl.straightening import SmoothingProblem, fewer, straighter, through
from angler_mjx.planning.host.timed import Traffic

ROUNDS = 4
"""Of straightening, each from the path of the one before."""

BETTER = 1e-3
"""Share of its cost by which a round has to shorten a path for another."""

FINEST = 96
"""Pieces into which a path is cut where no way through its own points has few enough."""

MOST_TRIED = 400
"""Points of a path that is thinned; one with more is left."""

NOBODY = Traffic.none()
"""Nothing is met."""


def ways(
    checks: EdgeChecker, traffic: Traffic = NOBODY, clock_mps: float = 0.0
) -> SmoothingProblem:
    """What edges are looked at among.

    Args:
        checks: of the team.
        traffic: that one robot meets in space and time.
        clock_mps: over which the fourth number of its places is its time; 0: places have no time.
    """
    return SmoothingProblem(
        *checks.packed, traffic.time_s, traffic.position_m, traffic.radius_m, float(clock_mps)
    )


def shortened(
    points: np.ndarray, among: SmoothingProblem, speed: np.ndarray, end: float
) -> np.ndarray:
    """A path that is quicker, or as it was.

    Args:
        points: [k, R, d] of the team; x, y, z first. Its edges are free.
        among: what edges are looked at among.
        speed: [R] m/s of each robot.
        end: of `time.perf_counter`; no round begins after it.
    """
    path = through(among, np.ascontiguousarray(points), speed)
    for _ in range(ROUNDS):
        if time.perf_counter() > end or len(path) == 2:
            break
        path, before, after = straighter(among, path, speed)
        if after > (1.0 - BETTER) * before:
            break
    return path


def thinned(
    points: np.ndarray, among: SmoothingProblem, speed: np.ndarray, most: int
) -> np.ndarray:
    """The quickest path through points of one, or between them, with few enough; or as it was.

    Args:
        points: [k, R, d] of the team; its edges are free.
        among: what edges are looked at among.
        speed: [R] m/s of each robot.
        most: points that there may be.
    """
    if not 2 <= most < len(points) <= MOST_TRIED:
        return points
    for pieces in (0, FINEST):
        found = fewer(among, np.ascontiguousarray(points), speed, most, pieces)
        if len(found):
            return found
    return points
