"""A problem as three flat arrays, the cheapest arguments of compiled functions."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.planning.host.compiled.cell_map import build_cell_map, measure_rings
from angler_mjx.planning.host.compiled.compiling import compile_function
from angler_mjx.planning.problem import Problem

type Moving = Literal["ignored", "at_start"]
"""Treatment of moving obstacles by checks without a time."""

SLACK_M = 1e-5
"""Distance [m] added to all required ones: rounding of float32 positions within 64 m."""


class PackedProblem(NamedTuple):
    """A problem, flat."""

    head: np.ndarray
    """int64: robots, standing obstacles, moving ones, times of their places, how many of those that
    stand never move (they are the first)."""
    reals: np.ndarray
    """float64, in the order of `PackedFields`."""
    cells: np.ndarray
    """int32 [2, nx, ny, nz] of `cell_map.build_cell_map`."""


class PackedFields(NamedTuple):
    """Views into the numbers of a `PackedProblem`."""

    box: np.ndarray
    """[10] lower corner of the cells, inverse of their edge, lower corner of the flight volume,
    its upper corner."""
    keep: np.ndarray
    """[1] required distance beyond the radii, m."""
    radius: np.ndarray
    """[R] of the robots."""
    still: np.ndarray
    """[S, 17] of obstacles that stand: kind, size (3), bounding radius, centre (3), rows of the
    matrix that turns W into its frame (9)."""
    drift_radius: np.ndarray
    """[M] of moving obstacles."""
    drift_time: np.ndarray
    """[T]."""
    drift_position: np.ndarray
    """[M, T, 3]."""


@compile_function
def unpack_fields(head: np.ndarray, reals: np.ndarray) -> PackedFields:
    """Return the numbers by their names."""
    robots, still, drift, times = head[0], head[1], head[2], head[3]
    a = 11 + robots
    b = a + 17 * still
    c = b + drift
    d = c + times
    return PackedFields(
        reals[:10],
        reals[10:11],
        reals[11:a],
        reals[a:b].reshape((still, 17)),
        reals[b:c],
        reals[c:d],
        reals[d:].reshape((drift, times, 3)),
    )


def pack_problem(
    problem: Problem,
    margin_m: float = 0.0,
    robots: Sequence[int] | None = None,
    moving: Moving = "ignored",
    far: bool = True,
) -> PackedProblem:
    """Make a problem ready; see `edges.EdgeChecker` for the arguments.

    Without ``far``, tests farther than a cell around may be slow.
    """
    if not margin_m >= 0.0:
        raise ConfigError(f"margin_m = {margin_m}: give the distance to keep, 0 or more")
    if moving not in ("ignored", "at_start"):
        raise ConfigError(f"moving = {moving!r}: give 'ignored' or 'at_start'")
    chosen = list(range(problem.robots) if robots is None else robots)
    invalid = [index for index in chosen if not 0 <= index < problem.robots]
    if invalid or not chosen:
        raise ConfigError(f"robots = {chosen}: give some of the team's, 0 to {problem.robots - 1}")
    grid, obstacles = problem.grid, problem.obstacles
    origin = np.asarray(grid.origin_m, float)
    edge = float(grid.cell_m)
    low = origin.copy()
    low[2] = max(low[2], float(problem.floor_z_m))
    high = origin + edge * np.array(grid.occupied.shape)
    exists, moves = np.asarray(obstacles.exists, bool), np.asarray(obstacles.moves, bool)
    still, drift = np.flatnonzero(exists & ~moves), np.flatnonzero(exists & moves)
    standing = np.concatenate([still, drift]) if moving == "at_start" else still
    position_m = np.asarray(obstacles.p_m, float)
    time = np.asarray(obstacles.time_s, float)
    reals = np.concatenate(
        [
            origin,
            [1.0 / edge],
            low,
            high,
            [margin_m + SLACK_M],
            np.asarray(problem.team.radius_m, float)[chosen],
            *[_obstacle_row(problem, row) for row in standing],
            np.asarray(obstacles.radius_m, float)[drift],
            time,
            position_m[drift].reshape(-1),
        ]
    )
    if not np.isfinite(reals).all():
        raise ConfigError("the problem has numbers that are not finite")
    head = np.array([len(chosen), len(standing), len(drift), len(time), len(still)], np.int64)
    cells = build_cell_map(np.ascontiguousarray(grid.occupied, bool))
    if far:
        measure_rings(cells)
    return PackedProblem(head, np.ascontiguousarray(reals), cells)


def _obstacle_row(problem: Problem, row: int) -> list[float]:
    """Return the numbers [17] of one obstacle at t = 0."""
    obstacles = problem.obstacles
    rotation = rotation_matrix(np.asarray(obstacles.q[row, 0], float)).T
    return [
        float(obstacles.kind[row]),
        *obstacles.half_size_m[row].tolist(),
        float(obstacles.radius_m[row]),
        *obstacles.p_m[row, 0].tolist(),
        *rotation.reshape(-1).tolist(),
    ]


def rotation_matrix(q: np.ndarray) -> np.ndarray:
    """Return the matrix [3, 3] of a quaternion [4] wxyz, from the body's frame to W."""
    w, x, y, z = (q / np.linalg.norm(q)).tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
