"""Paths of robots that hold a body, from the path of the body."""

from dataclasses import replace

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


CUBIC_PEAK = 1.5
"""The same of a cubic that begins and ends at rest."""
MIN_LEG_S = 0.1
"""Time of a leg without a way."""
APPROACH_POINTS = 3
"""Points of a path before the body has been lifted."""


def ease(fraction: jax.Array) -> jax.Array:
    """Return the part of a movement of minimum jerk that is done after a fraction of its time.

    T. Flash and N. Hogan, "The coordination of arm movements", Journal of Neuroscience 5 (1985).
    """
    return fraction**3 * (10.0 - 15.0 * fraction + 6.0 * fraction**2)


def hold_positions(team: Team, cargo: CargoProblem) -> jax.Array:
    """Return the positions [R, 3] m, in W, of robots that hold a body at its start."""
    return team.start_m if cargo.grip_m is None else cargo.grip_m


def add_approach(team: Team, cargo: CargoProblem, moving: JointTrajectory) -> JointTrajectory:
    """Return paths [R] of robots that first go to a body and lift it, and then follow it.

    Straight down, as a movement that begins and ends at rest, a time for their grippers, and
    straight up; no robot is faster than its cruise speed.

    Args:
        team: at the start.
        cargo: at the start, with its grips.
        moving: [R] of robots that hold the lifted body, three points shorter than paths may be.
    """
    if cargo.grip_m is None or cargo.wait_s is None or cargo.lift_m is None:
        return moving
    cruise = jnp.min(team.cruise_speed_mps)
    reach_m = jnp.max(jnp.sqrt(jnp.sum((cargo.grip_m - team.start_m) ** 2, axis=1)))
    down_s = CUBIC_PEAK * reach_m / cruise + MIN_LEG_S
    up_s = CUBIC_PEAK * cargo.lift_m / cruise + MIN_LEG_S
    times = jnp.stack([jnp.zeros_like(down_s), down_s, down_s + cargo.wait_s + MIN_LEG_S])
    yaw = team.start_yaw_rad[:, None]
    first = jnp.concatenate([team.start_m, yaw], axis=1)
    held = jnp.concatenate([cargo.grip_m, yaw], axis=1)
    position = jnp.stack([first, held, held], axis=1)
    return replace(
        moving,
        time_s=jnp.concatenate(
            [jnp.broadcast_to(times, (*yaw.shape[:1], 3)), moving.time_s + times[-1] + up_s], axis=1
        ),
        position=jnp.concatenate([position, moving.position], axis=1),
        velocity=jnp.pad(moving.velocity, ((0, 0), (3, 0), (0, 0))),
        acceleration=jnp.pad(moving.acceleration, ((0, 0), (3, 0), (0, 0))),
        degree=jnp.pad(moving.degree, ((0, 0), (3, 0)), constant_values=CUBIC),
    )


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
    offset = hold_positions(team, cargo) - cargo.start_m
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
