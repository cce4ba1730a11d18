"""From ArduSub's six demands between -1 and 1 to PWM: frame factors and limits.

The frames that are meant are "BlueROV2" (vectored: four vectored and two vertical thrusters) and
"BlueROV2 Heavy" (vectored_6dof: four and four). Their factors are +-1 or 0 and follow from where
the thrusters are and point, so they are read from the wrench matrix; axes are those of F here
(forward, left, up), where the firmware has forward, right, down: both ends are mirrored alike.
"""

import jax
import jax.numpy as jnp

from angler_mjx.robot.control.laws.model import limit_norm

_DIRECTION = 0.5
"""Cosine above which a thruster pushes along an axis: 45 degrees count, rounding does not."""
_ARM_M = 0.02
"""Arm above which a thruster turns the vehicle; offsets of the centre of mass are less."""


def frame_factors(B: jax.Array) -> jax.Array:
    """Factors [6, n_t] of forward, left, up, roll, pitch, yaw from a wrench matrix [6, n_t].

    Vertical thrusters roll, pitch and lift; the others move horizontally and yaw.
    """
    vertical = (jnp.abs(B[2]) > _DIRECTION).astype(B.dtype)
    level = 1.0 - vertical
    rows = [
        level * _threshold_sign(B[0], _DIRECTION),
        level * _threshold_sign(B[1], _DIRECTION),
        vertical * _threshold_sign(B[2], _DIRECTION),
        vertical * _threshold_sign(B[3], _ARM_M),
        vertical * _threshold_sign(B[4], _ARM_M),
        level * _threshold_sign(B[5], _ARM_M),
    ]
    return jnp.stack(rows)


def mix_demand(
    factors: jax.Array, demand: jax.Array, coupling: float
) -> tuple[jax.Array, jax.Array]:
    """Thruster outputs [n_t] between -1 and 1 for a demand [6], and whether any was cut (bool []).

    A frame that can pitch (vectored_6dof) has two groups, roll-pitch-throttle and
    yaw-forward-lateral; each is scaled down as a whole if one of its thrusters would pass 1. The
    other (vectored) adds up and clips, after forward was limited to 1 - K |throttle|.

    Args:
        factors: [6, n_t] of `frame_factors`.
        demand: [6] forward, left, up, roll, pitch, yaw.
        coupling: K, ``MOT_FV_CPLNG_K``.
    """
    demand = jnp.clip(demand, -1.0, 1.0)
    attitude = _sum_rows(factors, demand, (2, 3, 4))
    plane = _sum_rows(factors, demand, (0, 1, 5))
    largest_attitude, largest_plane = jnp.max(jnp.abs(attitude)), jnp.max(jnp.abs(plane))
    grouped = attitude / jnp.maximum(1.0, largest_attitude) + plane / jnp.maximum(
        1.0, largest_plane
    )
    limit = jnp.maximum(1.0 - coupling * jnp.abs(demand[2]), 0.0)
    forward = jnp.clip(demand[0], -limit, limit)
    added = attitude + plane + factors[0] * (forward - demand[0])
    pitches = jnp.max(jnp.abs(factors[4])) > 0
    output = jnp.where(pitches, grouped, added)
    cut = jnp.where(
        pitches,
        (largest_attitude > 1.0) | (largest_plane > 1.0),
        jnp.max(jnp.abs(added)) > 1.0,
    )
    return jnp.clip(output, -1.0, 1.0), cut


def lean_demand(acceleration: jax.Array, angle_max: float, gravity: float) -> jax.Array:
    """Forward and left demand [2] of a horizontal acceleration [2], m/s^2, in the level frame.

    The firmware turns it into a lean angle as for a multicopter, atan(a / g), and gives the share
    of ``ANGLE_MAX`` (rad here) to the mixer instead of leaning.
    """
    max_acceleration = gravity * jnp.tan(jnp.asarray(angle_max, acceleration.dtype))
    return jnp.arctan(limit_norm(acceleration, max_acceleration) / gravity) / angle_max


def _sum_rows(factors: jax.Array, demand: jax.Array, rows: tuple[int, ...]) -> jax.Array:
    first, second, third = rows
    return (
        factors[first] * demand[first]
        + factors[second] * demand[second]
        + factors[third] * demand[third]
    )


def _threshold_sign(row: jax.Array, threshold: float) -> jax.Array:
    return jnp.where(row > threshold, 1.0, jnp.where(row < -threshold, -1.0, 0.0)).astype(row.dtype)
