"""Bodies of a problem that robots can touch, as named geometries of coal."""

from collections.abc import Iterator
from typing import NamedTuple

import coal
import numpy as np

from angler_mjx.planning.host.compiled.packed import rotation_matrix
from angler_mjx.planning.problem import Problem

_WALLS = ("west", "east", "south", "north", "floor", "ceiling")


class SceneryBody(NamedTuple):
    """Something that is no robot."""

    name: str
    shape: coal.CollisionGeometry
    """Geometry of coal about its own centre."""
    rotation: np.ndarray
    """[3, 3] its frame to W."""
    centre_m: np.ndarray
    """[3] W."""


def enclosed_rock(occupied: np.ndarray) -> np.ndarray:
    """Return rock bool [nx, ny, nz] with rock across all six faces, which nothing touches first."""
    solid = np.pad(np.asarray(occupied, bool), 1)
    core = (slice(1, -1),) * 3
    inside = solid[core].copy()
    for axis in range(3):
        for shift in (-1, 1):
            inside &= np.roll(solid, shift, axis)[core]
    return inside


def rock_bodies(problem: Problem) -> Iterator[SceneryBody]:
    """Return boxes of the rock that can be touched: ``cell_I_J_K``."""
    grid = problem.grid
    edge, origin = float(grid.cell_m), np.asarray(grid.origin_m, float)
    rock = np.asarray(grid.occupied, bool)
    for index in np.argwhere(rock & ~enclosed_rock(rock)):
        name = "cell_" + "_".join(str(i) for i in index)
        yield SceneryBody(
            name, coal.Box(edge, edge, edge), np.eye(3), origin + edge * (index + 0.5)
        )


def wall_bodies(problem: Problem) -> Iterator[SceneryBody]:
    """Return boxes around the cube and the floor, each as thick as the cube is wide."""
    grid = problem.grid
    low = np.asarray(grid.origin_m, float).copy()
    high = low + float(grid.cell_m) * np.array(grid.occupied.shape)
    low[2] = max(low[2], float(problem.floor_z_m))
    size = high - low
    thick = size.max()
    for number, name in enumerate(_WALLS):
        axis, upper = divmod(number, 2)
        extent, centre = size + 2.0 * thick, 0.5 * (low + high)
        extent[axis] = thick
        centre[axis] = high[axis] + 0.5 * thick if upper else low[axis] - 0.5 * thick
        yield SceneryBody(name, coal.Box(*extent), np.eye(3), centre)


def obstacle_bodies(problem: Problem) -> Iterator[SceneryBody]:
    """Return known obstacles where they are at t = 0: ``obstacle_N``."""
    information = problem.obstacles
    for row in np.flatnonzero(information.exists):
        size = np.asarray(information.half_size_m[row], float)
        shape = (
            coal.Sphere(size[0]),
            coal.Box(*(2.0 * size)),
            coal.Capsule(size[0], 2.0 * size[1]),
        )[int(information.kind[row])]
        yield SceneryBody(f"obstacle_{row}", shape, *obstacle_pose(problem, int(row), 0.0))


def obstacle_pose(problem: Problem, row: int, time_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return matrix [3, 3] and centre [3] of an obstacle, on the line between known positions.

    Attitudes between are the normed mean of their quaternions; the last is held.
    """
    obstacles = problem.obstacles
    times = np.asarray(obstacles.time_s, float)
    next_index = int(
        np.clip(np.searchsorted(times, time_s, side="right"), 1, max(len(times) - 1, 1))
    )
    row_before, next_row = (0, 0) if len(times) == 1 else (next_index - 1, next_index)
    span = times[next_row] - times[row_before]
    fraction = float(np.clip((time_s - times[row_before]) / span, 0.0, 1.0)) if span > 0.0 else 0.0
    p, q = np.asarray(obstacles.p_m[row], float), np.asarray(obstacles.q[row], float)
    next_q = q[next_row] if q[row_before] @ q[next_row] >= 0.0 else -q[next_row]
    centre = (1.0 - fraction) * p[row_before] + fraction * p[next_row]
    return rotation_matrix((1.0 - fraction) * q[row_before] + fraction * next_q), centre
