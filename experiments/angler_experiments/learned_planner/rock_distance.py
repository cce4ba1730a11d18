"""Distances to fixed boundaries: rock, the faces of the cube, the sea floor."""

import jax
import jax.numpy as jnp

from angler_mjx.planning.path_search.lattice import span_bits
from angler_mjx.world.rock.grid import Grid

_REACH_CELLS = 4
"""Range of distances in cells."""
_ROUNDING_M = 1e-3


def compute_depth_field(grid: Grid, floor_z_m: jax.Array) -> jax.Array:
    """Return signed distance [nx, ny, nz] of cells' centres to fixed boundaries, m.

    Negative inside.

    Exact outside to cells, up to `_REACH_CELLS` of them; inside rock it is that to the nearest free
    cell. It guides paths out of rock; `is_segment_clear` checks whether a path is clear.
    """
    solid = jnp.pad(grid.occupied, _REACH_CELLS, constant_values=True)
    outside = _distance_to(solid, grid.cell_m)
    inside = _distance_to(jnp.pad(~grid.occupied, _REACH_CELLS), grid.cell_m)
    height = (jnp.arange(grid.occupied.shape[2]) + 0.5) * grid.cell_m + grid.origin_m[2]
    return jnp.minimum(jnp.where(grid.occupied, -inside, outside), height - floor_z_m)


def _distance_to(is_target: jax.Array, cell_m: jax.Array) -> jax.Array:
    max_square = (_REACH_CELLS + 0.5) ** 2
    square = jnp.where(is_target, 0.0, max_square).astype(cell_m.dtype)
    for axis in range(3):
        inner = square.shape[axis] - 2 * _REACH_CELLS
        rows = [
            jax.lax.slice_in_dim(square, _REACH_CELLS + k, _REACH_CELLS + k + inner, axis=axis)
            + max(abs(k) - 0.5, 0.0) ** 2
            for k in range(-_REACH_CELLS, _REACH_CELLS + 1)
        ]
        square = jnp.stack(rows).min(axis=0)
    return jnp.sqrt(jnp.minimum(square, max_square)) * cell_m


def interpolate_field(grid: Grid, field: jax.Array, position_m: jax.Array) -> jax.Array:
    """Interpolate a field [nx, ny, nz] of cells' centres at positions [..., 3]: values [...].

    Outside the grid it falls by a metre per metre, so that its gradient leads back.
    """
    top = jnp.array(field.shape) - 1
    at = (position_m - grid.origin_m) / grid.cell_m - 0.5
    clamped = jnp.clip(at, 0.0, top)
    lower = jnp.minimum(jnp.floor(clamped), jnp.maximum(top - 1, 0)).astype(jnp.int32)
    fraction = clamped - lower
    value = jnp.zeros(position_m.shape[:-1], field.dtype)
    for corner in range(8):
        step = jnp.array([corner >> 2 & 1, corner >> 1 & 1, corner & 1])
        i, j, k = jnp.moveaxis(jnp.minimum(lower + step, top), -1, 0)
        weight = jnp.prod(jnp.where(step == 1, fraction, 1.0 - fraction), axis=-1)
        value += weight * field[i, j, k]
    beside = jnp.sum(jnp.abs(at - clamped), axis=-1) * grid.cell_m
    return value - beside


def is_segment_clear(
    grid: Grid, columns: jax.Array, a: jax.Array, b: jax.Array, clearance_m: jax.Array
) -> jax.Array:
    """Return whether the segment a [3], b [3] keeps ``clearance_m`` [] from every rock; bool [].

    Rock is grown by the clearance along each axis, which requires up to sqrt(3) times more at its
    edges and corners. The segment is clipped to each grown column, and the bits of the column that
    its heights there cover must be free.

    Args:
        grid: cells.
        columns: uint32 [nx, ny] columns of the cells (`lattice.column_bits`).
        a: start.
        b: end.
        clearance_m: required clearance.
    """
    cell, origin = grid.cell_m, grid.origin_m
    d = jnp.where(jnp.abs(b - a) < 1e-6, 1e-6, b - a)
    enter, leave = [], []
    for axis in (0, 1):
        low = origin[axis] + cell * jnp.arange(columns.shape[axis]) - a[axis]
        ends = jnp.stack([low - clearance_m, low + cell + clearance_m]) / d[axis]
        enter.append(jnp.min(ends, axis=0))
        leave.append(jnp.max(ends, axis=0))
    first = jnp.maximum(jnp.maximum(enter[0][:, None], enter[1][None]), 0.0)
    last = jnp.minimum(jnp.minimum(leave[0][:, None], leave[1][None]), 1.0)
    z_first, z_last = a[2] + first * d[2], a[2] + last * d[2]
    low_z = (jnp.minimum(z_first, z_last) - clearance_m - origin[2]) / cell
    high_z = (jnp.maximum(z_first, z_last) + clearance_m - origin[2]) / cell
    covered = span_bits(
        jnp.floor(jnp.clip(low_z, -1.0, 32.0)).astype(jnp.int32),
        jnp.floor(jnp.clip(high_z, -1.0, 32.0)).astype(jnp.int32),
    )
    return ~jnp.any((first <= last) & ((covered & columns) != 0))


def is_within_bounds(
    grid: Grid, floor_z_m: jax.Array, position_m: jax.Array, clearance_m: jax.Array
) -> jax.Array:
    """Return whether positions [n, 3] all keep ``clearance_m`` from faces and floor; bool []."""
    top = grid.origin_m + grid.cell_m * jnp.array(grid.occupied.shape)
    keep = clearance_m - _ROUNDING_M
    low = grid.origin_m.at[2].max(floor_z_m) + keep
    return jnp.all((position_m >= low) & (position_m <= top - keep))
