"""Cells of a world that the robots of a fleet can reach."""

import jax
import jax.numpy as jnp

from angler_kernels.bit_grid import pack_grid, unpack_grid
from angler_kernels.caverns import largest_cavern
from angler_mjx.world.environment import Environment
from angler_mjx.world.obstacles import STATIC
from angler_mjx.world.placement import obstacle_gap, passable_cells

_WIDEST_CELLS = 1.49
"""Max clearance for which cells are checked; they are not checked beyond one and a half."""


def reachable_cells(environment: Environment, clearance_m: jax.Array) -> jax.Array:
    """Return the largest region of cells, joined by faces, whose centres keep a clearance.

    Args:
        environment: environment of one world.
        clearance_m: [] clearance from rock, floor, faces of the grid and static obstacles.

    Returns:
        bool [nx, ny, nz].
    """
    grid = environment.grid
    shape = grid.occupied.shape
    axes = [grid.origin_m[i] + (jnp.arange(n) + 0.5) * grid.cell_m for i, n in enumerate(shape)]
    centre = jnp.stack(jnp.meshgrid(*axes, indexing="ij"), axis=-1)
    gap = centre[..., 2] - environment.floor_z_m
    if STATIC in environment.obstacles.motions:
        gap = jnp.minimum(gap, obstacle_gap(environment.obstacles, centre, only_static=True))
    # Lengths in cell edges: the edge is a number of the world.
    radius = jnp.minimum(clearance_m / grid.cell_m, _WIDEST_CELLS)[None]
    passable = passable_cells(pack_grid(~grid.occupied[..., None]), gap / grid.cell_m, 1.0, radius)
    return unpack_grid(largest_cavern(passable, shape[2]), shape[2])[..., 0]
