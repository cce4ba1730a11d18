"""Distances to a regular grid of cubes, from the 3 x 3 x 3 cells around a point.

No mesh and no tree: every surface nearer than one cell edge lies among the 27 cells around the cell
of the point. Near the border of the grid the window is moved inside it, where it still holds every
cell that it would have held.
"""

import jax
import jax.numpy as jnp

from angler_kernels.clearance.shapes import point_box, segment_box


def capsules_grid(
    a: jax.Array,
    b: jax.Array,
    r: jax.Array,
    centre: jax.Array,
    occupied: jax.Array,
    origin: jax.Array,
    cell: jax.Array,
) -> jax.Array:
    """Return the distance [] of a union of capsules to the occupied cells; negative is overlap.

    Exact up to ``cell - hull radius`` and never greater: a cell outside the window is at least one
    edge away from ``centre``, so at least that far from the hull. The hull radius is that of the
    sphere about ``centre`` that holds all capsules; it has to be smaller than ``cell``, else an
    answer may be negative with no cell near. Overlap is counted as distance of the axis minus the
    radius, so at the most minus the radius.

    Args:
        a: [c, 3] one end of each capsule's axis, m.
        b: [c, 3] other end.
        r: [c] radii.
        centre: [3] point of the hull that the window is centred on.
        occupied: bool [nx, ny, nz]; everything outside the grid is free.
        origin: [3] lower corner of cell (0, 0, 0).
        cell: [] edge of a cell.
    """
    lo, present = _cell_window(centre, occupied, origin, cell)
    to_boxes = jax.vmap(segment_box, in_axes=(None, None, 0, 0))
    gap = jax.vmap(to_boxes, in_axes=(0, 0, None, None))(a, b, lo, lo + cell)
    gap = jnp.where(present, gap - r[:, None], jnp.inf)
    reach = jnp.maximum(jnp.sum((a - centre) ** 2, axis=1), jnp.sum((b - centre) ** 2, axis=1))
    cap = cell - jnp.max(jnp.sqrt(jax.lax.stop_gradient(reach)) + r)
    return jnp.minimum(jnp.min(gap), cap)


def point_grid(
    p: jax.Array, occupied: jax.Array, origin: jax.Array, cell: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return the distance [] of a point to the occupied cells and the direction [3] away from them.

    Exact up to ``cell``, and ``cell`` where nothing is nearer (the direction, a unit vector, then
    means nothing). Inside a cell the distance is 0 and the direction points from that cell's centre
    to the point.

    Args:
        p: [3] m.
        occupied: bool [nx, ny, nz]; everything outside the grid is free.
        origin: [3] lower corner of cell (0, 0, 0).
        cell: [] edge of a cell.
    """
    lo, present = _cell_window(p, occupied, origin, cell)
    gap = jnp.where(present, jax.vmap(point_box, in_axes=(None, 0, 0))(p, lo, lo + cell), cell)
    nearest = jnp.argmin(gap)
    low = lo[nearest]
    distance = jnp.minimum(gap[nearest], cell)
    surface = jnp.clip(p, low, low + cell)
    away = p - jnp.where(distance > 0.0, surface, low + 0.5 * cell)
    square = jnp.sum(away * away)
    up = jnp.zeros_like(p).at[2].set(1.0)
    length = jnp.sqrt(jnp.where(square > 0.0, square, 1.0))
    return distance, jnp.where(square > 0.0, away / length, up)


def _cell_window(
    p: jax.Array, occupied: jax.Array, origin: jax.Array, cell: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return lower corners [m, 3] and occupancy [m] of the cells around the cell that holds p."""
    size = tuple(min(3, n) for n in occupied.shape)
    limit = jnp.array([n - s for n, s in zip(occupied.shape, size, strict=True)])
    start = jnp.floor((p - origin) / cell).astype(jnp.int32) - 1
    start = jnp.clip(start, 0, limit)
    present = jax.lax.dynamic_slice(occupied, (start[0], start[1], start[2]), size)
    offset = jnp.stack(jnp.meshgrid(*(jnp.arange(s) for s in size), indexing="ij"), axis=-1)
    lo = origin + cell * (start + offset.reshape(-1, 3)).astype(p.dtype)
    return lo, present.reshape(-1)
