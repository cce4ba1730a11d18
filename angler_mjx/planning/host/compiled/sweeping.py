"""Compiled: a team of balls that all go along straight lines at once, among all there is."""

import math

import numpy as np

from angler_mjx.planning.host.compiled.cells import ball_touches, point_gap, swept_ball_touches
from angler_mjx.planning.host.compiled.compiling import compile_function
from angler_mjx.planning.host.compiled.packed import PackedFields, unpack_fields
from angler_mjx.planning.host.compiled.segments import segment_box, segment_point, segment_segment


@compile_function
def is_inside(box: np.ndarray, p: np.ndarray, i: int, reach: float) -> bool:
    """Return whether a ball is within the cube and above the floor; False for NaN."""
    for n in range(3):
        x = p[3 * i + n]
        if not (box[4 + n] + reach <= x <= box[7 + n] - reach):
            return False
    return True


@compile_function
def segment_obstacle(
    row: np.ndarray, ax: float, ay: float, az: float, dx: float, dy: float, dz: float
) -> float:
    """Return the squared distance of a segment to an obstacle's core, and the core's radius.

    A sphere is spanned by its centre, a capsule by its axis; a box is all its own, with no radius.
    """
    px, py, pz = row[5], row[6], row[7]
    if row[0] == 0.0:
        return segment_point(ax, ay, az, dx, dy, dz, px, py, pz)
    if row[0] == 1.0:
        wx, wy, wz = ax - px, ay - py, az - pz
        return segment_box(
            row[8] * wx + row[9] * wy + row[10] * wz,
            row[11] * wx + row[12] * wy + row[13] * wz,
            row[14] * wx + row[15] * wy + row[16] * wz,
            row[8] * dx + row[9] * dy + row[10] * dz,
            row[11] * dx + row[12] * dy + row[13] * dz,
            row[14] * dx + row[15] * dy + row[16] * dz,
            -row[1], -row[2], -row[3], row[1], row[2], row[3],
        )  # fmt: skip
    hx, hy, hz = row[2] * row[14], row[2] * row[15], row[2] * row[16]
    return segment_segment(
        ax, ay, az, dx, dy, dz, px - hx, py - hy, pz - hz, 2.0 * hx, 2.0 * hy, 2.0 * hz
    )


@compile_function
def obstacle_radius(row: np.ndarray) -> float:
    """Return the distance from an obstacle's core to its surface."""
    return 0.0 if row[0] == 1.0 else row[1]


@compile_function
def is_clear_of_obstacles(
    still: np.ndarray,
    ax: float, ay: float, az: float, bx: float, by: float, bz: float,
    reach: float,
) -> bool:  # fmt: skip
    """Return whether a ball of radius ``reach`` from a to b meets no standing obstacle."""
    dx, dy, dz = bx - ax, by - ay, bz - az
    for n in range(still.shape[0]):
        row = still[n]
        bound = reach + row[4]
        if segment_point(ax, ay, az, dx, dy, dz, row[5], row[6], row[7]) > bound * bound:
            continue
        min_distance = reach + obstacle_radius(row)
        if segment_obstacle(row, ax, ay, az, dx, dy, dz) <= min_distance * min_distance:
            return False
    return True


@compile_function
def is_clear_of_rock(
    box: np.ndarray,
    cells: np.ndarray,
    ax: float, ay: float, az: float, bx: float, by: float, bz: float,
    reach: float,
) -> bool:  # fmt: skip
    """Return whether a ball of radius ``reach`` from a to b inside the cube meets no cell."""
    n = box[3]
    return not swept_ball_touches(
        cells,
        (ax - box[0]) * n, (ay - box[1]) * n, (az - box[2]) * n,
        (bx - box[0]) * n, (by - box[1]) * n, (bz - box[2]) * n,
        reach * n,
    )  # fmt: skip


@compile_function
def _are_pairs_clear(radius: np.ndarray, keep: float, a: np.ndarray, b: np.ndarray) -> bool:
    """Return whether no two balls meet, by the closest approach of two motions in one time."""
    n = radius.shape[0]
    for i in range(n):
        for j in range(i):
            wx, wy, wz = (
                a[3 * i] - a[3 * j],
                a[3 * i + 1] - a[3 * j + 1],
                a[3 * i + 2] - a[3 * j + 2],
            )
            dx = b[3 * i] - b[3 * j] - wx
            dy = b[3 * i + 1] - b[3 * j + 1] - wy
            dz = b[3 * i + 2] - b[3 * j + 2] - wz
            min_distance = radius[i] + radius[j] + keep
            if segment_point(wx, wy, wz, dx, dy, dz, 0.0, 0.0, 0.0) <= min_distance * min_distance:
                return False
    return True


@compile_function
def is_motion_clear(world: PackedFields, cells: np.ndarray, a: np.ndarray, b: np.ndarray) -> bool:
    """Return whether all balls go from a [3 R] to b [3 R], which are clear, without contact."""
    radius, keep = world.radius, world.keep[0]
    if not _are_pairs_clear(radius, keep, a, b):
        return False
    for i in range(radius.shape[0]):
        ax, ay, az, reach = a[3 * i], a[3 * i + 1], a[3 * i + 2], radius[i] + keep
        bx, by, bz = b[3 * i], b[3 * i + 1], b[3 * i + 2]
        if not is_clear_of_rock(world.box, cells, ax, ay, az, bx, by, bz, reach):
            return False
        if not is_clear_of_obstacles(world.still, ax, ay, az, bx, by, bz, reach):
            return False
    return True


@compile_function
def is_team_clear(world: PackedFields, cells: np.ndarray, a: np.ndarray, b: np.ndarray) -> bool:
    """Return whether all balls go from a [3 R] to b [3 R] without contact; cheap tests first."""
    box, radius, keep = world.box, world.radius, world.keep[0]
    n = radius.shape[0]
    for i in range(n):
        reach = radius[i] + keep
        if not (is_inside(box, b, i, reach) and is_inside(box, a, i, reach)):
            return False
        if ball_touches(
            cells,
            (b[3 * i] - box[0]) * box[3],
            (b[3 * i + 1] - box[1]) * box[3],
            (b[3 * i + 2] - box[2]) * box[3],
            reach * box[3],
        ):
            return False
    return is_motion_clear(world, cells, a, b)


@compile_function
def is_robot_clear(
    world: PackedFields, cells: np.ndarray, a: np.ndarray, b: np.ndarray, i: int
) -> bool:
    """Return whether ball i touches nothing as all go from a to b; others are not tested."""
    box, radius, keep = world.box, world.radius, world.keep[0]
    reach = radius[i] + keep
    if not (is_inside(box, b, i, reach) and is_inside(box, a, i, reach)):
        return False
    ax, ay, az, bx, by, bz = (
        a[3 * i],
        a[3 * i + 1],
        a[3 * i + 2],
        b[3 * i],
        b[3 * i + 1],
        b[3 * i + 2],
    )
    for j in range(radius.shape[0]):
        if j == i:
            continue
        wx, wy, wz = ax - a[3 * j], ay - a[3 * j + 1], az - a[3 * j + 2]
        dx, dy, dz = bx - b[3 * j] - wx, by - b[3 * j + 1] - wy, bz - b[3 * j + 2] - wz
        min_distance = radius[i] + radius[j] + keep
        if segment_point(wx, wy, wz, dx, dy, dz, 0.0, 0.0, 0.0) <= min_distance * min_distance:
            return False
    return is_clear_of_rock(box, cells, ax, ay, az, bx, by, bz, reach) and is_clear_of_obstacles(
        world.still, ax, ay, az, bx, by, bz, reach
    )


@compile_function
def is_edge_free(
    head: np.ndarray, reals: np.ndarray, cells: np.ndarray, a: np.ndarray, b: np.ndarray
) -> bool:
    """Check one edge, a and b float64 [3 R]."""
    return is_team_clear(unpack_fields(head, reals), cells, a, b)


@compile_function
def is_state_free(head: np.ndarray, reals: np.ndarray, cells: np.ndarray, p: np.ndarray) -> bool:
    """Check one state, p float64 [3 R]."""
    return is_team_clear(unpack_fields(head, reals), cells, p, p)


@compile_function
def are_edges_free(
    head: np.ndarray, reals: np.ndarray, cells: np.ndarray, a: np.ndarray, b: np.ndarray
) -> np.ndarray:
    """Check many edges, a and b float64 [n, 3 R]."""
    world = unpack_fields(head, reals)
    free = np.empty(a.shape[0], np.bool_)
    for n in range(a.shape[0]):
        free[n] = is_team_clear(world, cells, a[n], b[n])
    return free


@compile_function
def team_clearances(
    head: np.ndarray, reals: np.ndarray, cells: np.ndarray, p: np.ndarray
) -> np.ndarray:
    """Return the least distance [n] of any ball to anything, p float64 [n, 3 R]."""
    world = unpack_fields(head, reals)
    gaps = np.empty(p.shape[0])
    for n in range(p.shape[0]):
        gaps[n] = _team_gap(world, cells, p[n])
    return gaps


@compile_function
def _team_gap(world: PackedFields, cells: np.ndarray, p: np.ndarray) -> float:
    """Return the least distance of any ball to anything."""
    best = math.inf
    for i in range(world.radius.shape[0]):
        x, y, z, radius_m = p[3 * i], p[3 * i + 1], p[3 * i + 2], world.radius[i]
        best = min(best, ball_gap(world, cells, x, y, z, best + radius_m) - radius_m)
        for j in range(i):
            wx, wy, wz = x - p[3 * j], y - p[3 * j + 1], z - p[3 * j + 2]
            distance = math.sqrt(wx * wx + wy * wy + wz * wz)
            best = min(best, distance - radius_m - world.radius[j])
    return best


@compile_function
def ball_gap(
    world: PackedFields, cells: np.ndarray, x: float, y: float, z: float, max_gap: float
) -> float:
    """Return the distance of a point to still bodies, or at least ``max_gap`` beyond it."""
    box = world.box
    max_gap = min(max_gap, x - box[4], y - box[5], z - box[6], box[7] - x, box[8] - y, box[9] - z)
    for n in range(world.still.shape[0]):
        row = world.still[n]
        gap = math.sqrt(segment_obstacle(row, x, y, z, 0.0, 0.0, 0.0)) - obstacle_radius(row)
        max_gap = min(max_gap, gap)
    if max_gap <= 0.0:
        return max_gap
    u, v, w = (x - box[0]) * box[3], (y - box[1]) * box[3], (z - box[2]) * box[3]
    to_rock: float = point_gap(cells, u, v, w, max_gap * box[3]) / box[3]
    return min(max_gap, to_rock)
