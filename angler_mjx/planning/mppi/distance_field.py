"""Fields of one world for a robot: gap to rock, faces and floor, and length of path to the goal.

Both are numbers at nodes half a cell apart, at the centres of cells and in the middles of their
faces, edges and corners, read by trilinear interpolation. Along a flat wall, and in a passage of
one cell, the interpolated gap is exact.
"""

import itertools
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx.world.rock.grid import Grid

FAR = 1e6
"""Remaining path [m] of nodes before their first value."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class DistanceField:
    """Numbers at the nodes of one world."""

    values: jax.Array
    """[nx, ny, nz, k] at 2 n + 1 nodes along an axis of n cells."""
    origin_m: jax.Array
    """[3] the first node, in W."""
    spacing_m: jax.Array
    """[] between nodes."""


def nodes_m(grid: Grid) -> jax.Array:
    """Return the positions [nx, ny, nz, 3] of the nodes, m, W."""
    axes = [
        grid.origin_m[i] + 0.5 * grid.cell_m * jnp.arange(2 * n + 1)
        for i, n in enumerate(grid.occupied.shape)
    ]
    return jnp.stack(jnp.meshgrid(*axes, indexing="ij"), axis=-1)


def obstacle_distance(grid: Grid, floor_z_m: jax.Array) -> jax.Array:
    """Return the distance from the nodes to rock, to the cube's faces and to the floor.

    Args:
        grid: rock; in it the distance to free water counts, below zero.
        floor_z_m: [] height of the floor.

    Returns:
        [nx, ny, nz] m.
    """
    node = nodes_m(grid)
    upper = grid.origin_m + grid.cell_m * jnp.array(grid.occupied.shape)
    to_face = jnp.min(jnp.minimum(node - grid.origin_m, upper - node), axis=-1)
    outside = _distance_to_cells(grid.occupied) - _distance_to_cells(~grid.occupied)
    return jnp.minimum(jnp.minimum(outside * grid.cell_m, to_face), node[..., 2] - floor_z_m)


def _distance_to_cells(cells: jax.Array) -> jax.Array:
    """Return distances [nx, ny, nz] in cells from nodes to the set cells [n, n, n].

    Squared distance to boxes of one grid is a sum over axes: its minimum is taken one by one.
    """
    square = jnp.where(cells, 0.0, FAR)
    for axis, n in enumerate(cells.shape):
        off = jnp.abs(0.5 * jnp.arange(2 * n + 1)[:, None] - (jnp.arange(n) + 0.5)) - 0.5
        step = jnp.maximum(off, 0.0) ** 2
        rows = jnp.moveaxis(square, axis, -1)
        square = jnp.moveaxis(jnp.min(rows[..., None, :] + step, axis=-1), -1, axis)
    return jnp.sqrt(square)


def path_length_to_goal(
    free: jax.Array, goal_m: jax.Array, origin_m: jax.Array, h: jax.Array
) -> jax.Array:
    """Return the length [nx, ny, nz] of the shortest free path from each node to a goal.

    Solves |grad V| = 1 by upwind differences (Godunov's; first order), all nodes at once, until
    nothing changes. Nodes near the goal are given their distance from it. What is not free takes
    the value of its nearest free neighbours and a step, layer by layer, so that interpolation
    beside a wall has something to read.

    Args:
        free: bool [nx, ny, nz] nodes where a robot may be.
        goal_m: [3] in W.
        origin_m: [3] the first node.
        h: [] m between nodes.
    """
    index = jnp.stack(jnp.meshgrid(*(jnp.arange(n) for n in free.shape), indexing="ij"), axis=-1)
    to_goal = jnp.sqrt(jnp.sum((origin_m + h * index - goal_m) ** 2, axis=-1))
    near = to_goal < 2.0 * h
    # A goal whose surroundings are all taken must still be found.
    start = jnp.where(near & (free | (to_goal < h)), to_goal, FAR)
    max_sweeps = 4 * sum(free.shape)

    def is_changing(carry: tuple[jax.Array, jax.Array, jax.Array]) -> jax.Array:
        _, change, count = carry
        return (change > 1e-3 * h) & (count < max_sweeps)

    def sweep(
        carry: tuple[jax.Array, jax.Array, jax.Array],
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        value, _, count = carry
        new = jnp.where(free, jnp.minimum(value, _upwind_solution(value, h)), value)
        return new, jnp.max(value - new), count + 1

    value, _, _ = jax.lax.while_loop(
        is_changing, sweep, (start, jnp.full_like(h, FAR), jnp.array(0))
    )

    def fill(_: int, value: jax.Array) -> jax.Array:
        nearest_value = _min_neighbour(value) + h
        return jnp.where((value >= FAR) & (nearest_value < FAR), nearest_value, value)

    filled: jax.Array = jax.lax.fori_loop(0, max(free.shape), fill, value)
    return filled


def _neighbour_values(value: jax.Array, step: tuple[int, ...]) -> jax.Array:
    """Return the value of each node's neighbour; `FAR` beyond the border."""
    padded = jnp.pad(value, 1, constant_values=FAR)
    return jax.lax.slice(
        padded,
        [1 + i for i in step],
        [1 + i + n for i, n in zip(step, value.shape, strict=True)],
    )


def _min_neighbour(value: jax.Array) -> jax.Array:
    """Return the least of the 26 neighbours, less the excess of a diagonal over a step."""
    best = value
    for axis in range(3):
        ahead = tuple(int(i == axis) for i in range(3))
        back = tuple(-i for i in ahead)
        best = jnp.minimum(
            best, jnp.minimum(_neighbour_values(best, ahead), _neighbour_values(best, back))
        )
    return best


def _upwind_solution(value: jax.Array, h: jax.Array) -> jax.Array:
    """Return the solution at each node for the present values of its neighbours."""
    axis_values = []
    for axis in range(3):
        ahead = tuple(int(i == axis) for i in range(3))
        back = tuple(-i for i in ahead)
        axis_values.append(
            jnp.minimum(_neighbour_values(value, ahead), _neighbour_values(value, back))
        )
    low, high = (
        jnp.minimum(axis_values[0], axis_values[1]),
        jnp.maximum(axis_values[0], axis_values[1]),
    )
    a, rest = jnp.minimum(low, axis_values[2]), jnp.maximum(low, axis_values[2])
    b, c = jnp.minimum(rest, high), jnp.maximum(rest, high)
    one_axis = a + h
    # Differences to the least: FAR squared would leave no digits.
    db, dc = jnp.minimum(b - a, 2.0 * h), jnp.minimum(c - a, 2.0 * h)
    two_axes = a + 0.5 * (db + jnp.sqrt(jnp.maximum(2.0 * h * h - db * db, 0.0)))
    s, square = db + dc, db * db + dc * dc
    root = jnp.sqrt(jnp.maximum(s * s - 3.0 * (square - h * h), 0.0))
    three_axes = a + (s + root) / 3.0
    solution = jnp.where(one_axis > b, two_axes, one_axis)
    return jnp.where(solution > c, three_axes, solution)


def interpolate(field: DistanceField, p: tuple[jax.Array, jax.Array, jax.Array]) -> list[jax.Array]:
    """Interpolate numbers at points, trilinearly; held beyond the border.

    Args:
        field: [nx, ny, nz, k].
        p: x, y, z in W, each [S].

    Returns:
        k arrays [S].
    """
    shape = field.values.shape
    rows = field.values.reshape(-1, shape[-1])
    low, fractions = [], []
    for i in range(3):
        at = jnp.clip((p[i] - field.origin_m[i]) / field.spacing_m, 0.0, shape[i] - 1.0)
        cell = jnp.minimum(at.astype(jnp.int32), shape[i] - 2)
        low.append(cell)
        fractions.append(at - cell)
    first = (low[0] * shape[1] + low[1]) * shape[2] + low[2]
    total = [jnp.zeros_like(p[0]) for _ in range(shape[-1])]
    for corner in itertools.product((0, 1), repeat=3):
        offset = (corner[0] * shape[1] + corner[1]) * shape[2] + corner[2]
        row = jnp.take(rows, first + offset, axis=0, mode="clip")
        weight = jnp.ones_like(p[0])
        for far, fraction in zip(corner, fractions, strict=True):
            weight = weight * (fraction if far else 1.0 - fraction)
        total = [value + weight * row[..., k] for k, value in enumerate(total)]
    return total
