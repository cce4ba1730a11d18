"""The static cells of one world."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Grid:
    """Static cells: a regular boolean grid of cubes."""

    occupied: jax.Array
    """bool [nx, ny, nz]; cell (i, j, k) is the cube of edge cell_m from origin_m + cell_m (i, j, k)
    upwards."""
    origin_m: jax.Array
    """[3] lower corner of cell (0, 0, 0), in W."""
    cell_m: jax.Array
    """[] edge of a cell, m."""


def height_above_bottom(grid: Grid, floor_z_m: jax.Array, p: jax.Array) -> jax.Array:
    """Return the height [] of a point above the first rock below it, or above the sea floor; m.

    Args:
        grid: static cells.
        floor_z_m: [] height of the floor.
        p: [3] in W; outside the grid there is only the floor.
    """
    shape = grid.occupied.shape
    cell = jnp.floor((p - grid.origin_m) / grid.cell_m).astype(jnp.int32)
    inside = jnp.all((cell[:2] >= 0) & (cell[:2] < jnp.array(shape[:2])))
    column = grid.occupied[jnp.clip(cell[0], 0, shape[0] - 1), jnp.clip(cell[1], 0, shape[1] - 1)]
    top = grid.origin_m[2] + grid.cell_m * jnp.arange(1, shape[2] + 1)
    below = inside & column & (top <= p[2])
    return p[2] - jnp.maximum(floor_z_m, jnp.max(jnp.where(below, top, -jnp.inf)))
