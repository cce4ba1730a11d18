"""The static cells of one world."""

from dataclasses import dataclass

import jax


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
