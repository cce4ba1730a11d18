"""How far it is: straight, or along ways free of rock."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx.world import routes
from angler_mjx.world.routes import Routes

UNLED = 4.0
"""Times the straight way that is taken where no way is known: from where no robot should be."""


def straight(p: jax.Array, to: jax.Array) -> jax.Array:
    """Lengths [n, m] of straight lines from points [n, 3] to points [m, 3], m."""
    x, y, z = ((p[:, None, axis] - to[:, axis]) ** 2 for axis in range(3))
    return jnp.sqrt(x + y + z)


@dataclass(frozen=True, kw_only=True)
class Travel:
    """Ways between places of one world."""

    place_m: jax.Array
    """[P, 3] in W."""
    routes: Routes | None = None
    """Ways free of rock to the same places; None: straight."""

    def ways(self, p: jax.Array, place: jax.Array) -> jax.Array:
        """Lengths [n, m] of ways from points [n, 3] in W to places int32 [m], m."""
        line = straight(p, self.place_m[place])
        if self.routes is None:
            return line
        of_place = jax.vmap(routes.distance, (None, 0, None))
        way = jax.vmap(of_place, (None, None, 0))(self.routes, place, p)
        return jnp.where(jnp.isfinite(way), way, UNLED * line)
