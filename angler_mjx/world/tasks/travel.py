"""Path lengths: straight, or along paths free of rock."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx.world import routes
from angler_mjx.world.routes import Routes

DETOUR_FACTOR = 4.0
"""Factor on the straight length where no path is known: from positions where no robot should be."""


def straight_lengths(p: jax.Array, to: jax.Array) -> jax.Array:
    """Return lengths [n, m] of straight lines from points [n, 3] to points [m, 3], m."""
    x, y, z = ((p[:, None, axis] - to[:, axis]) ** 2 for axis in range(3))
    return jnp.sqrt(x + y + z)


@dataclass(frozen=True, kw_only=True)
class Travel:
    """Paths between places of one world."""

    position_m: jax.Array
    """[P, 3] in W."""
    routes: Routes | None = None
    """Paths free of rock to the same places; None: straight."""

    def path_lengths_m(self, p: jax.Array, position_index: jax.Array) -> jax.Array:
        """Return lengths [n, m] of paths from points [n, 3] in W to places int32 [m], m."""
        line = straight_lengths(p, self.position_m[position_index])
        if self.routes is None:
            return line
        to_positions = jax.vmap(routes.distance_to_goal, (None, 0, None))
        length = jax.vmap(to_positions, (None, None, 0))(self.routes, position_index, p)
        return jnp.where(jnp.isfinite(length), length, DETOUR_FACTOR * line)
