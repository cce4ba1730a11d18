"""Signed distance and outward normal of the surface of a regular grid of cubes, for contact.

The nearest surface of a point is that of the nearest cell of the other kind, free or occupied, than
the cell of the point. All cells nearer than one edge are among the 26 around the cell of the point,
and everything outside the grid is free. Cells are compared in coordinates of the grid, in cell
edges, where the planes between cells are whole numbers: rounding opens no gap between two occupied
cells, so a flat wall has one normal, across seams between its cells and on both sides of its
surface.
"""

import itertools

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels.clearance.shapes import LineSegment

_OFFSETS = np.array(
    sorted(itertools.product((-1, 0, 1), repeat=3), key=lambda offset: np.abs(offset).sum())
)
"""[27, 3] offsets of the cells around a cell: the cell itself, then neighbours by face, by edge and
by corner. Of equally near cells the first is taken."""

_SAMPLES = np.linspace(0.0, 1.0, 9)
"""Points [9] of a segment's part in rock among which the deepest is chosen."""


def point_surface(
    p: jax.Array, neighbours: jax.Array, origin: jax.Array, cell: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return the signed distance [] of a point to the occupied cells and the outward normal [3].

    Outside, the distance is that to the nearest occupied cell, and the normal points from the
    nearest point of the surface to p. Inside, it is minus the distance to the nearest free space,
    and the normal points there. Exact from ``-cell`` to ``cell`` and not beyond; the normal, a unit
    vector, means nothing where no surface is nearer than ``cell``. On the surface the distance is 0
    and the normal that of a face; on an edge or corner it may be a diagonal between faces. Where
    two surfaces are equally near, the normal is that of one of them.

    Args:
        p: [3] m.
        neighbours: int32 [nx + 2, ny + 2, nz + 2] of `cell_neighbours`; everything outside the grid
            is free.
        origin: [3] lower corner of cell (0, 0, 0).
        cell: [] edge of a cell.
    """
    distance, normal = _surface_at((p - origin) / cell, neighbours)
    return cell * distance, normal


def segment_surface(
    a: jax.Array, b: jax.Array, neighbours: jax.Array, origin: jax.Array, cell: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return parameter [], signed distance [] and normal [3] at a segment's point nearest to rock.

    The point is ``a + t (b - a)``; distance and normal are those of `point_surface` there. Where
    the segment is outside rock, the point is the nearest one, and the distance is exact up to
    ``cell - |b - a| / 2`` and never greater, as that of `capsules_grid` with the centre at the
    middle of the segment; for a capsule of radius r, ``|b - a| / 2 + r`` has to be smaller than
    ``cell``. Where the segment enters rock, the point is the deepest of nine, evenly spaced from
    its first to its last point in rock: the greatest depth, up to ``cell - |b - a| / 2``, is missed
    by at most a sixteenth of the length between these two. Of equally near or deep points one is
    taken, so t jumps from end to end where a segment parallel to a wall tilts.

    Args:
        a: [3] one end, m.
        b: [3] other end, at most ``cell`` away from a; b = a is allowed.
        neighbours: int32 [nx + 2, ny + 2, nz + 2] of `cell_neighbours`; everything outside the grid
            is free.
        origin: [3] lower corner of cell (0, 0, 0).
        cell: [] edge of a cell.
    """
    start, end = (_clip_to_grid((x - origin) / cell, neighbours) for x in (a, b))
    t = _lowest_parameter(start, end, neighbours)
    distance, normal = _surface_at(start + t * (end - start), neighbours)
    cap = cell - 0.5 * jnp.sqrt(jnp.sum((b - a) ** 2))
    return t, jnp.minimum(cell * distance, cap), normal


def _surface_at(x: jax.Array, neighbours: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return signed distance [], in cell edges, and normal [3] at x [3] in coordinates of cells."""
    x = _clip_to_grid(x, neighbours)
    index = jnp.floor(x)
    fraction = x - index
    around = _cells_around(index, neighbours)
    is_inside, present = around[0], around[1:]
    offsets = _OFFSETS[1:]
    to_cells = jnp.where(offsets < 0, -fraction, jnp.where(offsets > 0, 1.0 - fraction, 0.0))
    square = jnp.where(present != is_inside, jnp.sum(to_cells**2, axis=1), jnp.inf)
    nearest = jnp.argmin(square)
    to_nearest = to_cells[nearest]
    # On the surface the direction to the nearest cell is that of the cells' centres.
    offset = jnp.asarray(offsets, x.dtype)[nearest]
    is_at_surface = jnp.all(to_nearest == 0.0)
    length, direction = _normalise(jnp.where(is_at_surface, offset, to_nearest))
    length = jnp.where(is_at_surface, 0.0, length)
    depth = jnp.where(jnp.isinf(square[nearest]), 1.0, jnp.minimum(length, 1.0))
    return jnp.where(is_inside, -depth, depth), jnp.where(is_inside, direction, -direction)


def _lowest_parameter(start: jax.Array, end: jax.Array, neighbours: jax.Array) -> jax.Array:
    """Return the parameter [] of a segment's point nearest to rock, or deepest in it.

    Both ends [3] are in coordinates of cells. The cells around that of the middle are all that are
    nearer than ``1 - |end - start| / 2`` to any point of the segment.
    """
    index = jnp.floor(_clip_to_grid(0.5 * (start + end), neighbours))
    present = _cells_around(index, neighbours)
    low = jnp.asarray(_OFFSETS.T, start.dtype)
    high = low + 1.0
    line = LineSegment.from_ends(start - index, end - index)
    nearest_parameters = line.nearest_parameter(low, high)
    gap = jnp.where(present, line.gap_at(nearest_parameters, low, high), jnp.inf)

    enter, leave = _crossing(line, low, high)
    is_crossed = present & (enter <= leave)
    first = jnp.min(jnp.where(is_crossed, enter, 1.0))
    last = jnp.max(jnp.where(is_crossed, leave, 0.0))
    samples = first + (last - first) * jnp.asarray(_SAMPLES, start.dtype)
    square = jnp.zeros((), start.dtype)
    for i in range(3):
        at = (line.a[i] + samples * line.d[i])[:, None]
        square = square + jnp.maximum(jnp.maximum(low[i] - at, at - high[i]), 0.0) ** 2
    depth = jnp.min(jnp.where(present, jnp.inf, square), axis=1)
    return jnp.where(
        jnp.any(is_crossed), samples[jnp.argmax(depth)], nearest_parameters[jnp.argmin(gap)]
    )


def _crossing(line: LineSegment, low: jax.Array, high: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the parameters [m] in [0, 1] at which a segment enters and leaves boxes.

    The boxes are low [3, m] to high [3, m]; a segment misses a box that it enters after leaving it.
    """
    enter, leave = jnp.zeros_like(low[0]), jnp.ones_like(low[0])
    for i in range(3):
        u, v = (low[i] - line.a[i]) * line.inverse[i], (high[i] - line.a[i]) * line.inverse[i]
        # A segment parallel to the planes is between them everywhere or nowhere.
        is_between = (low[i] <= line.a[i]) & (line.a[i] <= high[i])
        is_oblique = line.weight[i] > 0.0
        enter = jnp.maximum(enter, jnp.where(is_oblique, jnp.minimum(u, v), 0.0))
        parallel_leave = jnp.where(is_between, 1.0, -jnp.inf)
        leave = jnp.minimum(leave, jnp.where(is_oblique, jnp.maximum(u, v), parallel_leave))
    return enter, leave


def _clip_to_grid(x: jax.Array, neighbours: jax.Array) -> jax.Array:
    """Return x [3], in coordinates of cells, moved to at most two edges outside the grid.

    A point that is moved has no rock within one edge, before and after; nor has a segment of one
    edge with such an end.
    """
    return jnp.clip(x, -2.0, jnp.asarray(neighbours.shape, x.dtype))


def _cells_around(index: jax.Array, neighbours: jax.Array) -> jax.Array:
    """Return the occupancy [27] of the cells at `_OFFSETS` from the cell ``index`` [3]."""
    entry, shape = index.astype(jnp.int32) + 1, np.array(neighbours.shape, np.int32)
    is_near = jnp.all((entry >= 0) & (entry < shape))
    entry = jnp.clip(entry, 0, shape - 1)
    packed = neighbours.at[entry[0], entry[1], entry[2]].get(mode="promise_in_bounds")
    bits = (_OFFSETS + 1) @ np.array([9, 3, 1])
    present: jax.Array = ((packed >> bits.astype(np.int32)) & 1) != 0
    return present & is_near


def _normalise(v: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return length [] and direction [3] of a vector [3] that is not zero.

    Divided by its greatest component first, a vector along an axis keeps its length and direction
    exactly, and no square underflows.
    """
    greatest = jnp.max(jnp.abs(v))
    v = v / greatest
    length = jnp.sqrt(jnp.sum(v * v))
    return greatest * length, v / length
