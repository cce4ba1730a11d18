"""Sound loss by rock between robots."""

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx.world.rock.grid import Grid

CUT_DB = 1e3
"""Loss of a blocked path: no modem is that loud."""


@dataclass(frozen=True, kw_only=True)
class RockLoss:
    """Loss of sound in rock."""

    db_per_m: float | None
    """Loss per length in rock; None where rock blocks sound."""

    def loss_db(self, grid: Grid, a_m: jax.Array, b_m: jax.Array) -> jax.Array:
        """Return the loss [] on the straight path from a [3] to b [3], dB."""
        within = rock_between_m(grid, a_m, b_m)
        if self.db_per_m is None:
            return jnp.where(within > 0.0, CUT_DB, 0.0)
        return jnp.minimum(self.db_per_m * within, CUT_DB)


def rock_between_m(grid: Grid, a_m: jax.Array, b_m: jax.Array) -> jax.Array:
    """Return the length [] of the straight path from a [3] to b [3] in occupied cells, m.

    Samples points evenly along the path, at most a cell's edge apart within the grid: short cuts
    across a corner can be missed, and the length is accurate to about an edge. Sea floor and
    surface cast no shadow.
    """
    shape = grid.occupied.shape
    count = math.ceil(math.sqrt(sum(n * n for n in shape)))
    fraction = (jnp.arange(count) + 0.5) / count
    points = a_m + fraction[:, None] * (b_m - a_m)
    cell = jnp.floor((points - grid.origin_m) / grid.cell_m).astype(jnp.int32)
    inside = jnp.all((cell >= 0) & (cell < jnp.array(shape)), axis=-1)
    x, y, z = jnp.moveaxis(jnp.clip(cell, 0, jnp.array(shape) - 1), -1, 0)
    rock = inside & grid.occupied[x, y, z]
    length = jnp.sqrt(jnp.sum((b_m - a_m) ** 2))
    return length * jnp.mean(rock, dtype=length.dtype)
