"""What the navigation filter makes of each instrument: residual, its derivatives, its variance.

Each is linearised about the believed state of one robot, in the error state of `error_state`.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.robot.control import error_state
from angler_mjx.robot.control.error_state import (
    DEPTH,
    GYRO_BIAS,
    HEADING,
    IRON,
    THETA,
    P,
    V,
    build_rows,
    skew,
)
from angler_mjx.robot.sensing import instruments
from angler_mjx.robot.sensing.params import SensorParams
from angler_mjx.robot.sensing.readings import Reading


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class NavigationCarry:
    """The filter's memory."""

    p: jax.Array
    """[3] of the IMU's place, m in W."""
    v: jax.Array
    """[3] of the IMU's place, m/s in W."""
    q: jax.Array
    """[4] attitude, F to W."""
    gyro_bias: jax.Array
    """[3] rad/s"""
    accel_bias: jax.Array
    """[3] m/s^2"""
    depth_offset: jax.Array
    """[] of the depth's scale, m."""
    heading_bias: jax.Array
    """[] of the compass, rad."""
    hard_iron: jax.Array
    """[2] along x and y of F, in parts of the Earth's horizontal field."""
    covariance: jax.Array
    """[19, 19] of the error state."""
    from_ping: jax.Array
    """[3] reckoned way from where the transponder was at the last USBL ping to where the IMU is
    now, m in W."""


type Measurement = tuple[jax.Array, jax.Array, jax.Array]
"""Rows [m, 19], residual [m] and variance [m] of a measurement."""


def _position_rows(arm: jax.Array) -> jax.Array:
    """[3, 19]: how the place at an arm [3] (in W) from the IMU follows from the error state."""
    return build_rows((P, jnp.eye(3, dtype=arm.dtype)), (THETA, -skew(arm)))


def lever_arm(sensors: SensorParams, carry: NavigationCarry, offset: jax.Array) -> jax.Array:
    """Way [3] from the IMU to an instrument, in W."""
    return quaternion.rotate(carry.q, offset - sensors.imu.offset_m)


def linearize_depth(sensors: SensorParams, carry: NavigationCarry, reading: Reading) -> Measurement:
    """Height of the sensor by the pressure, less the believed offset of its scale."""
    gauge = sensors.depth
    arm_m = lever_arm(sensors, carry, gauge.offset_m)
    residual = carry.depth_offset - reading.depth_m - (carry.p + arm_m)[2:]
    # A rounding error is spread evenly over one step of the resolution.
    variance = gauge.std_m**2 + gauge.resolution_m**2 / 12.0
    unit = jnp.ones((1, 1), residual.dtype)
    up = jnp.eye(3, dtype=residual.dtype)[2:]
    matrix = build_rows((P, up), (THETA, -skew(arm_m)[2:]), (DEPTH, -unit))
    return matrix, residual, variance[None]


def linearize_attitude(
    sensors: SensorParams, carry: NavigationCarry, reading: Reading
) -> Measurement:
    """Turned back about z by the compass' believed error, against the believed attitude.

    How the error by iron follows from an error in heading is left out: a hundredth of that.
    """
    ahrs, heading = sensors.ahrs, quaternion.yaw(carry.q)
    error_rad = carry.heading_bias + instruments.iron_error(carry.hard_iron, heading)
    zero = jnp.zeros_like(error_rad)
    back = quaternion.exp(jnp.stack([zero, zero, -error_rad]))
    turned_back = quaternion.multiply(back, reading.ahrs_q)
    measured = jnp.where(reading.ahrs_fresh, turned_back, carry.q)
    residual = instruments.rotation_between(
        quaternion.conjugate(carry.q), quaternion.conjugate(measured)
    )
    identity = jnp.eye(3, dtype=residual.dtype)
    by_iron = jnp.stack([jnp.cos(heading), -jnp.sin(heading)])
    matrix = build_rows(
        (THETA, identity), (HEADING, identity[:, 2:]), (IRON, identity[:, 2:] * by_iron)
    )
    level = ahrs.level_std_rad**2
    return matrix, -residual, jnp.stack([level, level, ahrs.heading_std_rad**2])


def linearize_dvl(sensors: SensorParams, carry: NavigationCarry, reading: Reading) -> Measurement:
    """Turned into W, where the noise, the same along all axes, stays uncorrelated.

    R (z - omega x l) = v - dtheta x v + R [l]x dbg, with the arm l from the IMU to the DVL.
    """
    lever = sensors.dvl.offset_m - sensors.imu.offset_m
    rate = reading.imu.rate_radps - carry.gyro_bias
    measured = quaternion.rotate(carry.q, reading.dvl_velocity_mps - jnp.cross(rate, lever))
    by_bias = error_state.multiply_3x3(quaternion.to_matrix(carry.q), skew(lever))
    identity = jnp.eye(3, dtype=rate.dtype)
    matrix = build_rows((V, identity), (THETA, skew(carry.v)), (GYRO_BIAS, by_bias))
    variance = instruments.dvl_std(sensors.dvl, reading.dvl_velocity_mps) ** 2
    return matrix, measured - carry.v, jnp.stack([variance] * 3)


def linearize_usbl(sensors: SensorParams, carry: NavigationCarry, reading: Reading) -> Measurement:
    """Moved forward by the way reckoned since the ping.

    That way is off by the error of velocity times the latency, which is added to the noise.
    """
    beacon = sensors.usbl
    residual = reading.usbl_position_m + carry.from_ping - carry.p
    of_velocity = jnp.stack([carry.covariance[i, i] for i in range(V.start, V.stop)])
    variance = instruments.usbl_std(beacon, carry.p) ** 2 + beacon.latency_s**2 * of_velocity
    return _position_rows(lever_arm(sensors, carry, beacon.offset_m)), residual, variance


def linearize_gps(sensors: SensorParams, carry: NavigationCarry, reading: Reading) -> Measurement:
    """Horizontal place of the antenna."""
    arm_m = lever_arm(sensors, carry, sensors.gps.offset_m)
    residual = reading.gps_position_m - (carry.p + arm_m)[:2]
    return _position_rows(arm_m)[:2], residual, jnp.stack([sensors.gps.std_m**2] * 2)
