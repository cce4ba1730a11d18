"""How far it is: straight, or along ways free of rock."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp


def straight(p: jax.Array, to: jax.Array) -> jax.Array:
    """Lengths [n, m] of straight lines from points [n, 3] to points [m, 3], m."""
    apart = p[:, None] - to
    return jnp.sqrt(jnp.sum(apart * apart, axis=-1))


@dataclass(frozen=True, kw_only=True)
class Travel:
    """Ways between places of one world."""

    place_m: jax.Array
    """[P, 3] in W."""

    def ways(self, p: jax.Array, place: jax.Array) -> jax.Array:
        """Lengths [n, m] of ways from points [n, 3] in W to places int32 [m], m."""
        return straight(p, self.place_m[place])
