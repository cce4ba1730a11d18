"""Compiled: states and edges of a team of hulls with arms, by joints and capsules.

A team is a tree of joints, and capsules fixed to them (`angler_mjx.planning.host.arm_checks`). An
edge is free where its states at equal parts are; a state whose distance to everything exceeds what
any point moves in between stands for its neighbours, which are then not computed.
"""

import math

import numpy as np

from angler_mjx.planning.host.compiled.advancing import axis_gap
from angler_mjx.planning.host.compiled.cells import point_gap
from angler_mjx.planning.host.compiled.compiling import compile_function
from angler_mjx.planning.host.compiled.packed import PackedFields, unpack_fields
from angler_mjx.planning.host.compiled.segments import segment_segment

TRANSLATION, REVOLUTE, PRISMATIC = 0, 1, 2
"""Kinds of joints: three coordinates along the axes of the parent, an angle, or a length."""

NEAR_M = 0.4
"""Distance up to which gaps of links are computed; beyond, they count as this."""

ROUNDING_M = 1e-6
"""Distance by which a state has to be farther from everything than its neighbours move."""

FIRST_PARTS = 8
"""Parts of an edge between whose ends states are checked first, so that hits are found early."""


@compile_function
def _locate_joints(
    kinds: np.ndarray, joints: np.ndarray, q: np.ndarray, rotation: np.ndarray, origin: np.ndarray
) -> None:
    """Compute rotations [K, 3, 3] and origins [K, 3] of joints in W, parents first.

    Args:
        kinds: int64 [K, 3] of each joint: kind, row of its parent (-1: W), its first column in q.
        joints: [K, 15] rotation (9) and translation (3) in the parent's frame at 0, axis (3).
        q: columns of the configuration.
        rotation: result.
        origin: result.
    """
    turn, mounted = np.empty((3, 3)), np.empty((3, 3))
    for k in range(kinds.shape[0]):
        kind, parent, column = kinds[k, 0], kinds[k, 1], kinds[k, 2]
        row = joints[k]
        for i in range(3):
            if parent < 0:
                origin[k, i] = row[9 + i]
                for j in range(3):
                    mounted[i, j] = row[3 * i + j]
                continue
            origin[k, i] = origin[parent, i]
            for m in range(3):
                origin[k, i] += rotation[parent, i, m] * row[9 + m]
            for j in range(3):
                mounted[i, j] = 0.0
                for m in range(3):
                    mounted[i, j] += rotation[parent, i, m] * row[3 * m + j]
        if kind == REVOLUTE:
            x, y, z = row[12], row[13], row[14]
            s, c = math.sin(q[column]), math.cos(q[column])
            v = 1.0 - c
            turn[0, 0], turn[0, 1], turn[0, 2] = c + v * x * x, v * x * y - s * z, v * x * z + s * y
            turn[1, 0], turn[1, 1], turn[1, 2] = v * x * y + s * z, c + v * y * y, v * y * z - s * x
            turn[2, 0], turn[2, 1], turn[2, 2] = v * x * z - s * y, v * y * z + s * x, c + v * z * z
            for i in range(3):
                for j in range(3):
                    rotation[k, i, j] = 0.0
                    for m in range(3):
                        rotation[k, i, j] += mounted[i, m] * turn[m, j]
            continue
        for i in range(3):
            for j in range(3):
                rotation[k, i, j] = mounted[i, j]
                along = q[column + j] if kind == TRANSLATION else q[column] * row[12 + j]
                origin[k, i] += mounted[i, j] * along


@compile_function
def _locate_bodies(
    body_joint: np.ndarray,
    bodies: np.ndarray,
    rotation: np.ndarray,
    origin: np.ndarray,
    axes: np.ndarray,
) -> None:
    """Compute starts and vectors [B, 6] of the capsules' axes in W.

    Args:
        body_joint: int64 [B] joint of each capsule.
        bodies: [B, 7] ends and radius of each, in the frame of its joint.
        rotation: of the joints.
        origin: of the joints.
        axes: result.
    """
    for b in range(bodies.shape[0]):
        k, row = body_joint[b], bodies[b]
        for i in range(3):
            start, along = origin[k, i], 0.0
            for m in range(3):
                start += rotation[k, i, m] * row[m]
                along += rotation[k, i, m] * (row[3 + m] - row[m])
            axes[b, i], axes[b, 3 + i] = start, along


@compile_function
def _end_radius(axis: np.ndarray, r: float, x: float, y: float, z: float) -> float:
    """Return the distance from a point within which a capsule lies."""
    ux, uy, uz = axis[0] - x, axis[1] - y, axis[2] - z
    wx, wy, wz = ux + axis[3], uy + axis[4], uz + axis[5]
    far = max(ux * ux + uy * uy + uz * uz, wx * wx + wy * wy + wz * wz)
    return math.sqrt(far) + r


@compile_function
def _ball_gap(
    world: PackedFields, cells: np.ndarray, x: float, y: float, z: float, max_gap: float
) -> float:
    """Return a lower bound of the distance of a point to still bodies, at most ``max_gap``."""
    box = world.box
    gap: float = min(
        max_gap, x - box[4], y - box[5], z - box[6], box[7] - x, box[8] - y, box[9] - z
    )
    for n in range(world.still.shape[0]):
        row = world.still[n]
        dx, dy, dz = x - row[5], y - row[6], z - row[7]
        gap = min(gap, math.sqrt(dx * dx + dy * dy + dz * dz) - row[4])
    if not gap > 0.0:
        return gap
    u, v, w = (x - box[0]) * box[3], (y - box[1]) * box[3], (z - box[2]) * box[3]
    to_rock: float = point_gap(cells, u, v, w, gap * box[3]) / box[3]
    return min(gap, to_rock)


@compile_function
def _team_gap(
    world: PackedFields,
    cells: np.ndarray,
    first: np.ndarray,
    bodies: np.ndarray,
    centers: np.ndarray,
    axes: np.ndarray,
) -> float:
    """Return a lower bound of the distance of a team to everything; 0 or less on contact.

    Pairs of robots count by half of their distance: both move.

    Args:
        world: numbers of the problem.
        cells: of `cell_map.build_cell_map`.
        first: int64 [R + 1] first capsule of each robot.
        bodies: [B, 7] of `_locate_bodies`.
        centers: [R, 3] origins of the bases.
        axes: [B, 6] of `_locate_bodies`.
    """
    robots = first.shape[0] - 1
    radius, best = np.empty(robots), math.inf
    pair: float
    for i in range(robots):
        x, y, z = centers[i, 0], centers[i, 1], centers[i, 2]
        radius[i] = 0.0
        for b in range(first[i], first[i + 1]):
            radius[i] = max(radius[i], _end_radius(axes[b], bodies[b, 6], x, y, z))
    for i in range(robots):
        x, y, z = centers[i, 0], centers[i, 1], centers[i, 2]
        # Beyond a few metres the search among cells costs more than the states that it saves.
        ball = _ball_gap(world, cells, x, y, z, radius[i] + 10.0 * NEAR_M) - radius[i]
        if ball < NEAR_M:
            gap = NEAR_M
            for b in range(first[i], first[i + 1]):
                gap = axis_gap(world, cells, axes[b], bodies[b, 6], gap)
                if not gap > 0.0:
                    return gap
            ball = max(ball, gap)
        best = min(best, ball)
        for j in range(i):
            dx, dy, dz = x - centers[j, 0], y - centers[j, 1], z - centers[j, 2]
            pair = math.sqrt(dx * dx + dy * dy + dz * dz) - radius[i] - radius[j]
            if pair < NEAR_M:
                pair = _pair_gap(bodies, axes, first[i], first[i + 1], first[j], first[j + 1])
            if not pair > 0.0:
                return pair
            best = min(best, 0.5 * pair)
    return best


@compile_function
def _pair_gap(
    bodies: np.ndarray, axes: np.ndarray, a: int, a_end: int, b: int, b_end: int
) -> float:
    """Return the distance of the capsules a to a_end from the capsules b to b_end."""
    best = math.inf
    for i in range(a, a_end):
        u = axes[i]
        for j in range(b, b_end):
            v = axes[j]
            square = segment_segment(
                u[0], u[1], u[2], u[3], u[4], u[5], v[0], v[1], v[2], v[3], v[4], v[5]
            )
            best = min(best, math.sqrt(square) - bodies[i, 6] - bodies[j, 6])
    return best


@compile_function
def _gap_at(
    world: PackedFields,
    cells: np.ndarray,
    kinds: np.ndarray,
    joints: np.ndarray,
    body_joint: np.ndarray,
    bodies: np.ndarray,
    first: np.ndarray,
    bases: np.ndarray,
    q: np.ndarray,
    rotation: np.ndarray,
    origin: np.ndarray,
    axes: np.ndarray,
    centers: np.ndarray,
) -> float:
    """Return `_team_gap` at a configuration q; the last four arguments are scratch."""
    _locate_joints(kinds, joints, q, rotation, origin)
    _locate_bodies(body_joint, bodies, rotation, origin, axes)
    for i in range(bases.shape[0]):
        for n in range(3):
            centers[i, n] = origin[bases[i], n]
    return _team_gap(world, cells, first, bodies, centers, axes)


@compile_function
def is_path_free(
    head: np.ndarray,
    reals: np.ndarray,
    cells: np.ndarray,
    kinds: np.ndarray,
    joints: np.ndarray,
    body_joint: np.ndarray,
    bodies: np.ndarray,
    first: np.ndarray,
    bases: np.ndarray,
    lever: np.ndarray,
    resolution: float,
    points: np.ndarray,
) -> bool:
    """Return whether a team touches nothing at its states along a path of straight edges.

    Args:
        head: of `packed.PackedProblem`.
        reals: the same.
        cells: the same.
        kinds: int64 [K, 3] of `_locate_joints`.
        joints: [K, 15] of `_locate_joints`.
        body_joint: int64 [B] of `_locate_bodies`.
        bodies: [B, 7] of `_locate_bodies`, robot by robot.
        first: int64 [R + 1] first capsule of each robot.
        bases: int64 [R] joint of each base.
        lever: [R, d] how far a unit of each column moves a point of the hull at most; x, y and z
            are the first.
        resolution: no point of a hull moves farther from one state of an edge to the next, m.
        points: [k, R, d] configurations; one is a path of one state.
    """
    world = unpack_fields(head, reals)
    robots, width = points.shape[1], points.shape[2]
    rotation, origin = np.empty((kinds.shape[0], 3, 3)), np.empty((kinds.shape[0], 3))
    axes, centers = np.empty((bodies.shape[0], 6)), np.empty((robots, 3))
    q = np.empty(robots * width)
    for edge in range(max(points.shape[0] - 1, 1)):
        a, b = points[edge], points[min(edge + 1, points.shape[0] - 1)]
        turned, gone = 0.0, 0.0
        for i in range(robots):
            square, turn = 0.0, 0.0
            for n in range(3):
                square += (b[i, n] - a[i, n]) ** 2
            for n in range(3, width):
                turn += abs(b[i, n] - a[i, n]) * lever[i, n]
            # False for NaN, too, which max would pass over.
            if not square + turn < math.inf:
                return False
            gone, turned = max(gone, math.sqrt(square)), max(turned, turn)
        moved = gone + turned
        count = max(1, math.ceil(moved / resolution))
        step = moved / count
        # States between the first parts, then all from the beginning.
        coarse = max(1, count // FIRST_PARTS)
        for sweep in range(2):
            k = 0
            while k <= count:
                for i in range(robots):
                    for n in range(width):
                        q[i * width + n] = a[i, n] + (b[i, n] - a[i, n]) * (k / count)
                gap = _gap_at(
                    world, cells, kinds, joints, body_joint, bodies, first, bases, q,
                    rotation, origin, axes, centers,
                )  # fmt: skip
                if not gap > 0.0:
                    return False
                if sweep == 0:
                    k = count if k < count < k + coarse else k + coarse
                else:
                    ahead = (gap - ROUNDING_M) / step if step > 0.0 else 0.0
                    k += 1 + (int(min(ahead, float(count))) if ahead > 0.0 else 0)
    return True
