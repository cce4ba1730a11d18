"""Contents of a world: static cells, obstacles, currents, and starts and goals of the robots.

Pytrees of one world; a batch of worlds has one more leading axis on every leaf. All quantities are
in the world frame W (x east, y north, z up, metres, water surface at z = 0).
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx.world.currents import Current
from angler_mjx.world.obstacles import Obstacles
from angler_mjx.world.rock.grid import Grid


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Environment:
    """A complete world, without the robots' own parameters and state."""

    grid: Grid
    floor_z_m: jax.Array
    """[] height of the sea floor, m (negative)."""
    obstacles: Obstacles
    """Explicit and sampled obstacles, [n_obstacle] rows; rows with exists = False are padding."""
    current: Current
    start_m: jax.Array
    """[n_robot, 3] start of each robot's centre of mass."""
    start_yaw_rad: jax.Array
    """[n_robot] heading at the start, about z up, 0 = east."""
    goal_m: jax.Array
    """[n_robot, 3] goal of each robot."""
    density: jax.Array
    """[] fraction of occupied cells."""
    path_ratio: jax.Array
    """[n_robot] shortest 26-connected free path over the straight line, start to goal; >= 1."""
    line_free: jax.Array
    """bool [n_robot] whether the straight line from start to goal meets no occupied cell."""
    redraws: jax.Array
    """int32 [] number of samples rejected before this one could hold the fleet."""
    valid: jax.Array
    """bool [] False only where the redraw limit was reached; such a world is never simulated."""


def region_corners(environment: Environment) -> tuple[jax.Array, jax.Array]:
    """Return the lower and upper corner [3] of the cube that fleets work in, m, in W."""
    grid = environment.grid
    size = jnp.array(grid.occupied.shape, grid.origin_m.dtype) * grid.cell_m
    return grid.origin_m, grid.origin_m + size
