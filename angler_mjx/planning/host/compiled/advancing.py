"""Compiled: a team of hulls that move and turn at once, by conservative advancement.

In each step the hulls advance as far as none of their points can reach anything, until the end. An
approach below the required distance plus `TOLERANCE_M` counts as a hit.
"""

import math

import numpy as np

from angler_mjx.planning.host.compiled.compiling import compile_function
from angler_mjx.planning.host.compiled.packed import PackedFields, unpack_fields
from angler_mjx.planning.host.compiled.segments import segment_box, segment_segment
from angler_mjx.planning.host.compiled.sweeping import ball_gap, obstacle_radius, segment_obstacle
from angler_mjx.planning.host.compiled.sweeping import is_team_clear as balls_clear

TOLERANCE_M = 1e-3
"""Distance [m] beyond the required one below which an approach counts as a hit."""


@compile_function
def _capsule_axis(hull: np.ndarray, q: np.ndarray, robot: int, n: int, out: np.ndarray) -> None:
    """Start and way [6] of the axis of capsule n of a robot, W, at q [4 R]."""
    k = 4 * robot
    c, s = math.cos(q[k + 3]), math.sin(q[k + 3])
    row = hull[robot, n]
    out[0] = q[k] + c * row[0] - s * row[1]
    out[1] = q[k + 1] + s * row[0] + c * row[1]
    out[2] = q[k + 2] + row[2]
    dx, dy = row[3] - row[0], row[4] - row[1]
    out[3], out[4], out[5] = c * dx - s * dy, s * dx + c * dy, row[5] - row[2]


@compile_function
def axis_gap(
    world: PackedFields, cells: np.ndarray, v: np.ndarray, r: float, max_gap: float
) -> float:
    """Return the distance of a capsule, axis v [6], radius r, to rock, at most ``max_gap``."""
    box = world.box
    x, y, z, dx, dy, dz = v[0], v[1], v[2], v[3], v[4], v[5]
    for n in range(3):
        low, high = min(v[n], v[n] + v[3 + n]), max(v[n], v[n] + v[3 + n])
        max_gap = min(max_gap, low - r - box[4 + n], box[7 + n] - high - r)
    for n in range(world.still.shape[0]):
        row = world.still[n]
        gap = math.sqrt(segment_obstacle(row, x, y, z, dx, dy, dz)) - obstacle_radius(row) - r
        max_gap = min(max_gap, gap)
    scale = box[3]
    x, y, z = (x - box[0]) * scale, (y - box[1]) * scale, (z - box[2]) * scale
    dx, dy, dz = dx * scale, dy * scale, dz * scale
    wide = max(max_gap + r, 0.0) * scale
    i0, i1 = _cell_range(x, dx, wide, cells.shape[1])
    j0, j1 = _cell_range(y, dy, wide, cells.shape[2])
    k0, k1 = _cell_range(z, dz, wide, cells.shape[3])
    best = (max_gap + r) * scale
    for i in range(i0, i1):
        for j in range(j0, j1):
            for k in range(k0, k1):
                if cells[1, i, j, k] == 0:
                    square = segment_box(
                        x, y, z, dx, dy, dz, i, j, k, i + 1.0, j + 1.0, k + 1.0
                    )  # fmt: skip
                    best = min(best, math.sqrt(square))
    gap_m: float = best / scale - r
    return gap_m


@compile_function
def _cell_range(start: float, delta: float, margin: float, n: int) -> tuple[int, int]:
    """Return the first and past-the-last cell of an axis within ``margin`` of a segment."""
    low, high = min(start, start + delta) - margin, max(start, start + delta) + margin
    return max(math.floor(low), 0), min(math.floor(high) + 1, n)


@compile_function
def _world_gap(
    world: PackedFields, cells: np.ndarray, hull: np.ndarray, q: np.ndarray, i: int, near: float
) -> float:
    """Return a lower bound of the distance of a hull to still bodies; exact below ``near``.

    ``near`` is at most the radius of its sphere.
    """
    radius_m: float = world.radius[i]
    ball = ball_gap(world, cells, q[4 * i], q[4 * i + 1], q[4 * i + 2], near + radius_m) - radius_m
    if ball >= near:
        return ball
    axis, best = np.empty(6), radius_m
    for n in range(hull.shape[1]):
        _capsule_axis(hull, q, i, n, axis)
        best = min(best, axis_gap(world, cells, axis, hull[i, n, 6], best))
    return best


@compile_function
def _pair_gap(
    world: PackedFields, hull: np.ndarray, q: np.ndarray, i: int, j: int, near: float
) -> float:
    """Return the same bound for two hulls."""
    wx, wy, wz = (
        q[4 * i] - q[4 * j],
        q[4 * i + 1] - q[4 * j + 1],
        q[4 * i + 2] - q[4 * j + 2],
    )
    balls: float = math.sqrt(wx * wx + wy * wy + wz * wz) - world.radius[i] - world.radius[j]
    if balls >= near:
        return balls
    first, second, best = np.empty(6), np.empty(6), math.inf
    for n in range(hull.shape[1]):
        _capsule_axis(hull, q, i, n, first)
        for m in range(hull.shape[1]):
            _capsule_axis(hull, q, j, m, second)
            distance = math.sqrt(
                segment_segment(
                    first[0], first[1], first[2], first[3], first[4], first[5],
                    second[0], second[1], second[2], second[3], second[4], second[5],
                )
            )  # fmt: skip
            best = min(best, distance - hull[i, n, 6] - hull[j, m, 6])
    return best


@compile_function
def team_gap(world: PackedFields, cells: np.ndarray, hull: np.ndarray, q: np.ndarray) -> float:
    """Return the least distance of any hull to anything, exact up to the least sphere radius."""
    best = math.inf
    for i in range(hull.shape[0]):
        best = min(best, _world_gap(world, cells, hull, q, i, world.radius[i]))
        for j in range(i):
            best = min(best, _pair_gap(world, hull, q, i, j, world.radius[i]))
    return best


@compile_function
def is_team_clear(
    world: PackedFields,
    cells: np.ndarray,
    hull: np.ndarray,
    turning: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
) -> bool:
    """Return whether all hulls go from a to b [4 R] without contact.

    Args:
        world: numbers.
        cells: of `cell_map.build_cell_map`.
        hull: [R, c, 7] ends and radius of each capsule, body frame.
        turning: [R] how far a hull reaches from its vertical axis.
        a: x, y, z, heading of each robot.
        b: the same; a heading goes from the one number straight to the other.
    """
    keep, n = world.keep[0], hull.shape[0]
    speed, q, first, last = np.empty(n), np.empty(4 * n), np.empty(3 * n), np.empty(3 * n)
    for i in range(n):
        for k in range(3):
            first[3 * i + k], last[3 * i + k] = a[4 * i + k], b[4 * i + k]
        dx, dy, dz = b[4 * i] - a[4 * i], b[4 * i + 1] - a[4 * i + 1], b[4 * i + 2] - a[4 * i + 2]
        turn = abs(b[4 * i + 3] - a[4 * i + 3])
        speed[i] = math.sqrt(dx * dx + dy * dy + dz * dz) + turning[i] * turn
        if not speed[i] < math.inf:
            return False
    if balls_clear(world, cells, first, last):
        return True
    s = 0.0
    while True:
        step = math.inf
        for k in range(4 * n):
            q[k] = b[k] if s >= 1.0 else a[k] + s * (b[k] - a[k])
        for i in range(n):
            near = 0.5 * world.radius[i]
            slack = _world_gap(world, cells, hull, q, i, near) - keep
            if not slack > TOLERANCE_M:
                return False
            if speed[i] > 0.0:
                step = min(step, slack / speed[i])
            for j in range(i):
                slack = _pair_gap(world, hull, q, i, j, near) - keep
                if not slack > TOLERANCE_M:
                    return False
                if speed[i] + speed[j] > 0.0:
                    step = min(step, slack / (speed[i] + speed[j]))
        if s >= 1.0:
            return True
        s = min(s + step, 1.0)


@compile_function
def are_edges_free(
    head: np.ndarray,
    reals: np.ndarray,
    cells: np.ndarray,
    hull: np.ndarray,
    turning: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
) -> np.ndarray:
    """Check many edges, a and b float64 [n, 4 R]."""
    world = unpack_fields(head, reals)
    free = np.empty(a.shape[0], np.bool_)
    for n in range(a.shape[0]):
        free[n] = is_team_clear(world, cells, hull, turning, a[n], b[n])
    return free


@compile_function
def is_edge_free(
    head: np.ndarray,
    reals: np.ndarray,
    cells: np.ndarray,
    hull: np.ndarray,
    turning: np.ndarray,
    a: np.ndarray,
    b: np.ndarray,
) -> bool:
    """Check one edge, a and b float64 [4 R]."""
    return is_team_clear(unpack_fields(head, reals), cells, hull, turning, a, b)


@compile_function
def team_clearances(
    head: np.ndarray, reals: np.ndarray, cells: np.ndarray, hull: np.ndarray, q: np.ndarray
) -> np.ndarray:
    """Return the least distance [n] of any hull to anything, q float64 [n, 4 R]; see `team_gap`."""
    world = unpack_fields(head, reals)
    gaps = np.empty(q.shape[0])
    for n in range(q.shape[0]):
        gaps[n] = team_gap(world, cells, hull, q[n])
    return gaps
