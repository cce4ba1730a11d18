"""Known obstacles, robots and current over a horizon."""

import jax
import jax.numpy as jnp

from angler_mjx.sim.information import CurrentInformation, ObstacleInformation
from angler_mjx.world.acoustics.channel import HeardRobots

ABSENT_REACH_M = -1e3
"""Reach of absent bodies."""


def current_along(
    current: CurrentInformation | None, path_m: jax.Array, ahead_s: jax.Array
) -> jax.Array:
    """Return the known velocity [H, 3] of the water in W along positions [H, 3] at times [H]."""
    if current is None:
        return jnp.zeros_like(path_m)
    return jax.vmap(current.velocity)(path_m, ahead_s)


def extrapolate_robots(
    others: HeardRobots, time_s: jax.Array, ahead_s: jax.Array, robot: jax.Array
) -> jax.Array:
    """Return positions [H, R, 3] of robots at times [H] from now, as far as one has heard.

    Args:
        others: received states of the robots.
        time_s: [] now.
        ahead_s: [H]
        robot: int32 [] whose knowledge it is.
    """
    position_m, velocity = others.extrapolate_m(time_s)[robot], others.v_mps[robot]
    return position_m + velocity * ahead_s[:, None, None]


def extrapolate_obstacles(
    information: ObstacleInformation | None, ahead_s: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return positions [n, H, 3] at times [H] from now, and bounding radii [n].

    On lines between places that are told, held after the last; straight on where one is told. What
    does not exist has the radius `ABSENT_REACH_M`.
    """
    if information is None:
        return jnp.zeros((0, ahead_s.shape[0], 3)), jnp.zeros(0)
    if information.time_s.shape[0] == 1:
        position_m = information.p_m[:, :1] + information.velocity_mps[:, None] * ahead_s[:, None]
    else:
        next_index = jnp.searchsorted(information.time_s, ahead_s, side="right")
        next_index = jnp.clip(next_index, 1, information.time_s.shape[0] - 1)
        begin, end = information.time_s[next_index - 1], information.time_s[next_index]
        fraction = jnp.clip((ahead_s - begin) / (end - begin), 0.0, 1.0)[:, None]
        position_m = (
            information.p_m[:, next_index - 1] * (1.0 - fraction)
            + information.p_m[:, next_index] * fraction
        )
    return position_m, jnp.where(information.exists, information.radius_m, ABSENT_REACH_M)
