"""A problem as three flat arrays: what compiled functions are called with at least cost."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.planning.host.compiled.compiling import compiled
from angler_mjx.planning.host.compiled.mapping import measure, words
from angler_mjx.planning.problem import Problem

type Moving = Literal["ignored", "at_start"]
"""What checks without a time make of obstacles that move."""

SLACK_M = 1e-5
"""Added to every distance that is asked for: what float32 rounds off places within 64 m."""


class Packed(NamedTuple):
    """A problem, flat."""

    head: np.ndarray
    """int64: robots, standing obstacles, moving ones, times of their places, how many of those that
    stand never move (they are the first)."""
    reals: np.ndarray
    """float64, in the order of `Fields`."""
    cells: np.ndarray
    """int32 [2, nx, ny, nz] of `mapping.words`."""


class Fields(NamedTuple):
    """Views into the numbers of a `Packed`."""

    box: np.ndarray
    """[10] lower corner of the cells, inverse of their edge, lower corner of what may be flown in,
    upper corner of it."""
    keep: np.ndarray
    """[1] distance that is asked for beyond the radii, m."""
    radius: np.ndarray
    """[R] of the robots."""
    still: np.ndarray
    """[S, 17] of obstacles that stand: kind, size (3), bounding radius, centre (3), rows of the
    matrix that turns W into its frame (9)."""
    drift_radius: np.ndarray
    """[M] of moving obstacles."""
    drift_time: np.ndarray
    """[T]."""
    drift_place: np.ndarray
    """[M, T, 3]."""


@compiled
def fields(head: np.ndarray, reals: np.ndarray) -> Fields:
    """The numbers by their names."""
    robots, still, drift, times = head[0], head[1], head[2], head[3]
    a = 11 + robots
    b = a + 17 * still
    c = b + drift
    d = c + times
    return Fields(
        reals[:10],
        reals[10:11],
        reals[11:a],
        reals[a:b].reshape((still, 17)),
        reals[b:c],
        reals[c:d],
        reals[d:].reshape((drift, times, 3)),
    )


def pack(
    problem: Problem,
    margin_m: float = 0.0,
    robots: Sequence[int] | None = None,
    moving: Moving = "ignored",
    far: bool = True,
) -> Packed:
    """Make a problem ready; see `edges.EdgeChecker` for the arguments.

    Without ``far``, what looks farther than a cell around may be slow.
    """
    if not margin_m >= 0.0:
        raise ConfigError(f"margin_m = {margin_m}: give the distance to keep, 0 or more")
    if moving not in ("ignored", "at_start"):
        raise ConfigError(f"moving = {moving!r}: give 'ignored' or 'at_start'")
    chosen = list(range(problem.robots) if robots is None else robots)
    wrong = [index for index in chosen if not 0 <= index < problem.robots]
    if wrong or not chosen:
        raise ConfigError(f"robots = {chosen}: give some of the team's, 0 to {problem.robots - 1}")
    grid, known = problem.grid, problem.obstacles
    origin = np.asarray(grid.origin_m, float)
    edge = float(grid.cell_m)
    low = origin.copy()
    low[2] = max(low[2], float(problem.floor_z_m))
    high = origin + edge * np.array(grid.occupied.shape)
    exists, moves = np.asarray(known.exists, bool), np.asarray(known.moves, bool)
    still, drift = np.flatnonzero(exists & ~moves), np.flatnonzero(exists & moves)
    stands = np.concatenate([still, drift]) if moving == "at_start" else still
    place = np.asarray(known.p_m, float)
    time = np.asarray(known.time_s, float)
    reals = np.concatenate(
        [
            origin,
            [1.0 / edge],
            low,
            high,
            [margin_m + SLACK_M],
            np.asarray(problem.team.radius_m, float)[chosen],
            *[_still(problem, row) for row in stands],
            np.asarray(known.radius_m, float)[drift],
            time,
            place[drift].reshape(-1),
        ]
    )
    if not np.isfinite(reals).all():
        raise ConfigError("the problem has numbers that are not finite")
    head = np.array([len(chosen), len(stands), len(drift), len(time), len(still)], np.int64)
    cells = words(np.ascontiguousarray(grid.occupied, bool))
    if far:
        measure(cells)
    return Packed(head, np.ascontiguousarray(reals), cells)


def _still(problem: Problem, row: int) -> list[float]:
    """Numbers [17] of one obstacle where it stands at t = 0."""
    known = problem.obstacles
    turned = matrix(np.asarray(known.q[row, 0], float)).T
    return [
        float(known.kind[row]),
        *known.half_size_m[row].tolist(),
        float(known.radius_m[row]),
        *known.p_m[row, 0].tolist(),
        *turned.reshape(-1).tolist(),
    ]


def matrix(q: np.ndarray) -> np.ndarray:
    """Matrix [3, 3] of a quaternion [4] wxyz, which turns the body's frame into W."""
    w, x, y, z = (q / np.linalg.norm(q)).tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
