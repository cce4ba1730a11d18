"""What is known of obstacles and of the current, over a horizon."""

import jax
import jax.numpy as jnp

from angler_mjx.sim.information import CurrentInformation, ObstacleInformation
from angler_mjx.world.acoustics.channel import HeardRobots

NOBODY_M = -1e3
"""Reach of what is not there."""


def flow(known: CurrentInformation | None, way_m: jax.Array, ahead_s: jax.Array) -> jax.Array:
    """Velocity [H, 3] of the water in W, as far as it is known, along a way [H, 3] at times [H]."""
    if known is None:
        return jnp.zeros_like(way_m)
    found: jax.Array = jax.vmap(known.velocity)(way_m, ahead_s)
    return found


def straight(
    others: HeardRobots, time_s: jax.Array, ahead_s: jax.Array, robot: jax.Array
) -> jax.Array:
    """Places [H, R, 3] of robots at times [H] from now, as far as one of them has heard.

    Args:
        others: what all have heard of each other.
        time_s: [] now.
        ahead_s: [H]
        robot: int32 [] whose knowledge it is.
    """
    here, velocity = others.place_m(time_s)[robot], others.v_mps[robot]
    return here + velocity * ahead_s[:, None, None]


def obstacles(known: ObstacleInformation | None, ahead_s: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Places [n, H, 3] at times [H] from now, and bounding radii [n].

    On lines between places that are told, held after the last; straight on where one is told. What
    does not exist has the radius `NOBODY_M`.
    """
    if known is None:
        return jnp.zeros((0, ahead_s.shape[0], 3)), jnp.zeros(0)
    if known.time_s.shape[0] == 1:
        place = known.p_m[:, :1] + known.velocity_mps[:, None] * ahead_s[:, None]
    else:
        after = jnp.searchsorted(known.time_s, ahead_s, side="right")
        after = jnp.clip(after, 1, known.time_s.shape[0] - 1)
        begin, end = known.time_s[after - 1], known.time_s[after]
        share = jnp.clip((ahead_s - begin) / (end - begin), 0.0, 1.0)[:, None]
        place = known.p_m[:, after - 1] * (1.0 - share) + known.p_m[:, after] * share
    return place, jnp.where(known.exists, known.radius_m, NOBODY_M)
