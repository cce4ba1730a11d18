"""Rock between those who talk."""

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx.world.grid import Grid

CUT_DB = 1e3
"""Loss of what is cut off: no modem is that loud."""


@dataclass(frozen=True, kw_only=True)
class RockLoss:
    """What rock does to sound."""

    db_per_m: float | None
    """Loss on the way through it; None where it lets nothing pass."""

    def loss_db(self, grid: Grid, a_m: jax.Array, b_m: jax.Array) -> jax.Array:
        """Loss [] on the straight way from a [3] to b [3], dB."""
        within = rock_between_m(grid, a_m, b_m)
        if self.db_per_m is None:
            return jnp.where(within > 0.0, CUT_DB, 0.0)
        return jnp.minimum(self.db_per_m * within, CUT_DB)


def rock_between_m(grid: Grid, a_m: jax.Array, b_m: jax.Array) -> jax.Array:
    """Length [] of the straight way from a [3] to b [3] that lies in occupied cells, m.

    By places evenly along it, at most an edge of a cell apart within the grid: what is cut across a
    corner can be missed, and the length is right to about an edge. Sea floor and surface throw no
    shadow.
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
