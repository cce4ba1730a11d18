"""Single instruments of one robot: exact value and noise, as pure functions.

With ``noise`` False a function returns the exact value unchanged.
"""

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.robot.sensing.params import (
    AhrsParams,
    DepthParams,
    DvlParams,
    GpsParams,
    TruthNoiseParams,
    UsblParams,
)
from angler_mjx.robot.sensing.readings import SensorCarry, Truth


def is_due(every: jax.Array, step: jax.Array, phase: jax.Array | int = 0) -> jax.Array:
    """Return whether an instrument gives a reading (bool []) at a step from 0.

    ``every`` 0: never.
    """
    return (every > 0) & (step % jnp.maximum(every, 1) == phase)


def point_position(truth: Truth, offset: jax.Array) -> jax.Array:
    """Return the position [3] of a point of the robot, in W; ``offset`` [3] in F."""
    return truth.p + quaternion.rotate(truth.q, offset)


def velocity_at(nu: jax.Array, offset: jax.Array) -> jax.Array:
    """Return the velocity [3] of a point of the robot, in F: v + omega x offset."""
    return nu[:3] + jnp.cross(nu[3:], offset)


def rotation_between(before: jax.Array, after: jax.Array) -> jax.Array:
    """Return the rotation vector [3], rad, of conj(before) after, between two attitudes [4].

    The logarithm of SO(3), 2 atan2(|u|, w) u / |u|; its series 2 u / w for the smallest angles.
    """
    r = quaternion.multiply(quaternion.conjugate(before), after)
    r = jnp.where(r[0] < 0, -r, r)
    square = jnp.sum(r[1:] * r[1:])
    small = square < 1e-12
    length = jnp.sqrt(jnp.where(small, 1.0, square))
    series = 2.0 / jnp.where(small, r[0], 1.0)
    return r[1:] * jnp.where(small, series, 2.0 * jnp.arctan2(length, r[0]) / length)


def measure_inertial(
    before_q: jax.Array,
    before_velocity: jax.Array,
    q: jax.Array,
    velocity: jax.Array,
    dt: jax.Array,
    gravity: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Return mean angular velocity and mean specific force of an IMU in a period.

    omega = log(q0* q1) / dt, f = R(q0 exp(dt omega / 2))^T ((v1 - v0) / dt + gravity z).

    Args:
        before_q: [4] attitude at the beginning.
        before_velocity: [3] velocity of the IMU, in W, m/s.
        q: [4] attitude at the end.
        velocity: [3] velocity at the end.
        dt: [] period, s.
        gravity: [] m/s^2.

    Returns:
        [3] rad/s and [3] m/s^2, in F.
    """
    rotation = rotation_between(before_q, q)
    middle = quaternion.multiply(before_q, quaternion.exp(0.5 * rotation))
    up = jnp.stack([jnp.zeros_like(gravity), jnp.zeros_like(gravity), gravity])
    return rotation / dt, quaternion.rotate_inverse(middle, (velocity - before_velocity) / dt + up)


def measure_depth(
    params: DepthParams, surface: jax.Array, truth: Truth, normal: jax.Array, noise: bool
) -> jax.Array:
    """Return the depth [] of the sensor, m: -z + offset of the scale + noise, in whole steps."""
    exact = -point_position(truth, params.offset_m)[2]
    if not noise:
        return exact
    value = exact + surface + params.std_m * normal
    step = jnp.where(params.resolution_m > 0, params.resolution_m, 1.0)
    return jnp.where(params.resolution_m > 0, jnp.round(value / step) * step, value)


def measure_attitude(
    params: AhrsParams, carry: SensorCarry, truth: Truth, normal: jax.Array, noise: bool
) -> jax.Array:
    """Return the attitude [4] of the AHRS: the true attitude, rotated in W by its errors.

    The tilt of the robot is left out of `iron_error`, as a compass corrects for it.
    """
    if not noise:
        return truth.q
    iron = iron_error(carry.hard_iron, quaternion.yaw(truth.q))
    error = jnp.stack(
        [
            params.level_std_rad * normal[0],
            params.level_std_rad * normal[1],
            params.heading_std_rad * normal[2] + carry.heading_bias_rad + iron,
        ]
    )
    return quaternion.multiply(quaternion.exp(error), truth.q)


def iron_error(iron: jax.Array, heading: jax.Array) -> jax.Array:
    """Return the error [] of a compass, rad, by the robot's own field h [2].

    It sees the Earth's horizontal field, in F (sin psi, cos psi) for a heading psi from east, plus
    h: atan2(h_x cos psi - h_y sin psi, 1 + h_x sin psi + h_y cos psi).
    """
    sin, cos = jnp.sin(heading), jnp.cos(heading)
    return jnp.arctan2(iron[0] * cos - iron[1] * sin, 1.0 + iron[0] * sin + iron[1] * cos)


def dvl_velocity(params: DvlParams, truth: Truth, normal: jax.Array, noise: bool) -> jax.Array:
    """Return the velocity [3] over ground of the DVL, in F, m/s; ``normal`` [3]."""
    exact = velocity_at(truth.nu, params.offset_m)
    return exact + dvl_std(params, exact) * normal if noise else exact


def dvl_std(params: DvlParams, velocity: jax.Array) -> jax.Array:
    """Return standard deviation [] of a DVL's axis, m/s: additive, and in proportion to speed."""
    square = jnp.sum(velocity * velocity)
    return jnp.sqrt(params.std_mps**2 + params.std_per_speed**2 * square)


def dvl_locked(params: DvlParams, truth: Truth, normal: jax.Array, noise: bool) -> jax.Array:
    """Return whether a DVL gives a velocity (bool []): bottom lock, no dropout; ``normal`` []."""
    altitude, tilt = truth.altitude_m, quaternion.world_up(truth.q)[2]
    lock = (altitude >= params.min_altitude_m) & (altitude <= params.max_altitude_m)
    lock &= tilt >= params.min_cos_tilt
    return lock & ~(normal < params.dropout_below) if noise else lock


def usbl_fix(params: UsblParams, truth: Truth, normal: jax.Array, noise: bool) -> jax.Array:
    """Return position [3] of the transponder in W, m; ``normal`` [7]: noise, outlier, choice."""
    exact = point_position(truth, params.offset_m)
    if not noise:
        return exact
    outlier = jnp.where(normal[6] < params.outlier_below, params.outlier_std_m, 0.0)
    return exact + usbl_std(params, exact) * normal[:3] + outlier * normal[3:6]


def usbl_std(params: UsblParams, position: jax.Array) -> jax.Array:
    """Return standard deviation [] of a USBL's axis, m: additive, and in proportion to range."""
    offset = position - params.transceiver_m
    return jnp.sqrt(params.std_m**2 + params.std_per_range**2 * jnp.sum(offset * offset))


def gps_position(params: GpsParams, truth: Truth, normal: jax.Array, noise: bool) -> jax.Array:
    """Return the position [2] of the antenna, east and north, m; ``normal`` [2]."""
    exact = point_position(truth, params.offset_m)[:2]
    return exact + params.std_m * normal if noise else exact


def gps_received(params: GpsParams, truth: Truth) -> jax.Array:
    """Return whether the antenna is at the surface (bool [])."""
    return -point_position(truth, params.offset_m)[2] <= params.max_depth_m


def disturb_truth(params: TruthNoiseParams, truth: Truth, normal: jax.Array, noise: bool) -> Truth:
    """Return the true state with white noise; ``normal`` [12]. The altitude is unchanged."""
    if not noise:
        return truth
    turn = quaternion.exp(params.attitude_std_rad * normal[3:6])
    return Truth(
        p=truth.p + params.position_std_m * normal[:3],
        q=quaternion.multiply(turn, truth.q),
        nu=truth.nu
        + jnp.concatenate(
            [params.velocity_std_mps * normal[6:9], params.rate_std_radps * normal[9:]]
        ),
        altitude_m=truth.altitude_m,
    )
