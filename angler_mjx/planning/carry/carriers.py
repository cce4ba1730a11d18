"""Paths of robots that hold a body, from the path of the body."""

import jax
import jax.numpy as jnp

from angler_mjx.planning.problem import CargoProblem, Team
from angler_mjx.robot.control.commands.joint_trajectory import (
    CUBIC,
    VEHICLE_JOINTS,
    JointTrajectory,
)

PEAK_SPEED = 1.875
"""Greatest speed of a movement of minimum jerk over its mean."""


def ease(fraction: jax.Array) -> jax.Array:
    """Return the part of a movement of minimum jerk that is done after a fraction of its time.

    T. Flash and N. Hogan, "The coordination of arm movements", Journal of Neuroscience 5 (1985).
    """
    return fraction**3 * (10.0 - 15.0 * fraction + 6.0 * fraction**2)


def follow_body(
    team: Team, cargo: CargoProblem, at_m: jax.Array, turn_rad: jax.Array, duration_s: jax.Array
) -> JointTrajectory:
    """Return the paths [R] of robots that keep their poses in the frame of a body.

    Args:
        team: at the start.
        cargo: at the start.
        at_m: [n, 3] centre of the body at equal steps of time, m, in W.
        turn_rad: [n] its turn about z up since the start, then.
        duration_s: [] time of the whole, above 0.
    """
    points, robots = at_m.shape[0], team.start_m.shape[0]
    fraction = jnp.linspace(0.0, 1.0, points, dtype=at_m.dtype)
    offset = team.start_m - cargo.start_m
    c, s = jnp.cos(turn_rad), jnp.sin(turn_rad)
    x, y, z = (offset[:, None, i] for i in range(3))
    turned = jnp.stack(
        [c * x - s * y, s * x + c * y, jnp.broadcast_to(z, (robots, points))], axis=2
    )
    yaw = team.start_yaw_rad[:, None] + turn_rad
    pose = jnp.concatenate([at_m + turned, yaw[..., None]], axis=2)
    return JointTrajectory(
        joints=VEHICLE_JOINTS,
        time_s=jnp.broadcast_to(fraction * duration_s, (robots, points)),
        position=pose,
        velocity=_slopes(pose, fraction) / duration_s,
        acceleration=jnp.zeros_like(pose),
        degree=jnp.full((robots, points), CUBIC, jnp.int32),
        commanded=jnp.ones((robots, len(VEHICLE_JOINTS)), bool),
        found=jnp.ones(robots, bool),
    )


def _slopes(values: jax.Array, at: jax.Array) -> jax.Array:
    """Return central differences [R, n, k] of values by ``at`` [n]; zero at both ends."""
    inner = (values[:, 2:] - values[:, :-2]) / (at[2:] - at[:-2])[:, None]
    return jnp.pad(inner, ((0, 0), (1, 1), (0, 0)))
