"""Where a robot believes it is: an error-state Kalman filter on its instruments, for one robot.

The believed state is position and velocity of the IMU's place in W, attitude, the biases of
gyroscopes and accelerometers, and the constant errors of depth and compass; [19] errors of it have
a covariance (`error_state`). The IMU moves the state once in a control period, then whatever is
fresh corrects it (`measurements`), without branches. After Sola, Quaternion kinematics for the
error-state Kalman filter, 2017, with the attitude error in W. A fix that arrives late is moved
forward by the way that was reckoned since it was taken.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.robot.control import error_state, measurements
from angler_mjx.robot.control.commands import Estimate
from angler_mjx.robot.control.error_state import (
    ACCEL_BIAS,
    DEPTH,
    GYRO_BIAS,
    HEADING,
    IRON,
    N_STATE,
    THETA,
    P,
    V,
)
from angler_mjx.robot.control.measurements import NavigationCarry
from angler_mjx.robot.sensing import instruments
from angler_mjx.robot.sensing.params import SensorParams
from angler_mjx.robot.sensing.readings import Reading

GATES = (10.828, 13.816, 16.266)
"""0.999 quantiles of chi-square with 1, 2 and 3 degrees of freedom: one good reading in a thousand
is thrown away."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class NavigationParams:
    """What the filter takes for granted about one robot."""

    sensors: SensorParams
    """As the filter believes they are: places, noise."""
    initial_position_m: jax.Array | float = 0.1
    """Standard deviations of one axis at the beginning. Assumed, as those below."""
    initial_velocity_mps: jax.Array | float = 0.02
    initial_level_rad: jax.Array | float = 0.01
    initial_heading_rad: jax.Array | float = 0.03


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class NavigationOutput:
    """What the filter gives at a control step."""

    estimate: Estimate
    """Of the centre of mass, as a controller takes it."""
    std: jax.Array
    """[19] standard deviations of the error state."""
    rejected: jax.Array
    """bool [5] depth, attitude, DVL, USBL, GPS: fresh, but not believed."""


def reset(params: NavigationParams, estimate: Estimate, key: jax.Array) -> NavigationCarry:
    """Begin with a state and the initial standard deviations.

    With noise switched on the state is off by what they say, drawn from ``key``; else it is exact.

    Args:
        params: of the robot.
        estimate: the true state.
        key: of the robot, for nothing else.
    """
    sensors, dtype = params.sensors, estimate.p.dtype
    imu = sensors.imu
    stds = [
        params.initial_position_m,
        params.initial_velocity_mps,
        params.initial_heading_rad,
        imu.gyro_turn_on_std,
        imu.accel_turn_on_std,
    ]
    std = jnp.repeat(jnp.stack([jnp.asarray(x, dtype) for x in stds]), 3)
    std = std.at[6:8].set(params.initial_level_rad)
    ahrs, scale = sensors.ahrs, sensors.depth.surface_std_m
    constant = [scale, ahrs.heading_bias_std_rad, ahrs.hard_iron_std, ahrs.hard_iron_std]
    std = jnp.concatenate([std, jnp.stack(constant).astype(dtype)])
    zero = jnp.zeros(3, dtype)
    velocity = instruments.velocity_at(estimate.nu, imu.offset_m)
    carry = NavigationCarry(
        p=estimate.p + quaternion.rotate(estimate.q, imu.offset_m),
        v=quaternion.rotate(estimate.q, velocity),
        q=estimate.q,
        gyro_bias=zero,
        accel_bias=zero,
        depth_offset=jnp.zeros((), dtype),
        heading_bias=jnp.zeros((), dtype),
        hard_iron=jnp.zeros(2, dtype),
        covariance=jnp.eye(N_STATE, dtype=dtype) * std**2,
        from_ping=zero,
    )
    if not sensors.noise:
        return carry
    off = std[:9] * jax.random.normal(key, (9,), dtype)
    return _apply_error(carry, jnp.concatenate([off, jnp.zeros(N_STATE - 9, dtype)]))


def step(
    params: NavigationParams, carry: NavigationCarry, reading: Reading
) -> tuple[NavigationCarry, NavigationOutput]:
    """One control step: move with the IMU, correct with what is fresh.

    Args:
        params: of the robot.
        carry: memory.
        reading: of its instruments at this step.

    Returns:
        The memory, and the estimate with its standard deviations.
    """
    carry = predict(params.sensors, carry, reading)
    arm = measurements.lever_arm(params.sensors, carry, params.sensors.usbl.offset_m)
    carry = replace(carry, from_ping=jnp.where(reading.usbl_pinged, -arm, carry.from_ping))
    carry, rejected = correct(params.sensors, carry, reading)
    rate = reading.imu.rate_radps - carry.gyro_bias
    offset = params.sensors.imu.offset_m
    velocity = quaternion.rotate_inverse(carry.q, carry.v) - jnp.cross(rate, offset)
    return carry, NavigationOutput(
        estimate=Estimate(
            p=carry.p - quaternion.rotate(carry.q, offset),
            q=carry.q,
            nu=jnp.concatenate([velocity, rate]),
        ),
        std=_standard_deviations(carry),
        rejected=rejected,
    )


def _standard_deviations(carry: NavigationCarry) -> jax.Array:
    """Standard deviations [19]."""
    variance = jnp.stack([carry.covariance[i, i] for i in range(N_STATE)])
    return jnp.sqrt(jnp.maximum(variance, 0.0))


def predict(sensors: SensorParams, carry: NavigationCarry, reading: Reading) -> NavigationCarry:
    """Move the state and its covariance by what the IMU felt since the last step.

    q' = q exp(dt omega), v' = v + dt (R_mid f - g z), p' = p + dt (v + v') / 2: the inverse of
    what the IMU's means are of, so nothing is lost by the long period but in p.
    """
    imu, dt = sensors.imu, sensors.dt_s
    fresh = reading.imu.fresh
    rotation = (reading.imu.mean_rate_radps - carry.gyro_bias) * dt
    middle = quaternion.multiply(carry.q, quaternion.exp(0.5 * rotation))
    force = quaternion.rotate(middle, reading.imu.specific_force_mps2 - carry.accel_bias)
    zero = jnp.zeros_like(dt)
    v = carry.v + dt * (force - jnp.stack([zero, zero, sensors.gravity_mps2]))
    displacement = 0.5 * dt * (carry.v + v)
    covariance = error_state.propagate_covariance(
        carry.covariance, quaternion.to_matrix(middle), force, dt
    )
    covariance = error_state.add_noise(
        covariance, imu.gyro_std, imu.accel_std, imu.gyro_walk_std, imu.accel_walk_std, dt
    )
    displacement = jnp.where(fresh, displacement, 0.0)
    q = quaternion.multiply(carry.q, quaternion.exp(rotation))
    return replace(
        carry,
        p=carry.p + displacement,
        v=jnp.where(fresh, v, carry.v),
        q=jnp.where(fresh, q, carry.q),
        covariance=jnp.where(fresh, covariance, carry.covariance),
        from_ping=carry.from_ping + displacement,
    )


def correct(
    sensors: SensorParams, carry: NavigationCarry, reading: Reading
) -> tuple[NavigationCarry, jax.Array]:
    """Correct the state with all fresh readings, each against its own gate.

    All are linearised about the same state, corrected once at the end.

    Returns:
        The memory, and bool [5] what was fresh but not believed.
    """
    fresh = [
        (reading.depth_fresh, measurements.linearize_depth(sensors, carry, reading)),
        (reading.ahrs_fresh, measurements.linearize_attitude(sensors, carry, reading)),
        (reading.dvl_fresh, measurements.linearize_dvl(sensors, carry, reading)),
        (reading.usbl_fresh, measurements.linearize_usbl(sensors, carry, reading)),
        (reading.gps_fresh, measurements.linearize_gps(sensors, carry, reading)),
    ]
    covariance, error = carry.covariance, jnp.zeros_like(carry.covariance[0])
    rejected = []
    for is_fresh, (matrix, residual, variance) in fresh:
        gate = GATES[matrix.shape[0] - 1]
        covariance, error, taken = error_state.fuse_measurement(
            covariance, error, matrix, residual, variance, gate, is_fresh
        )
        rejected.append(is_fresh & ~taken)
    carry = _apply_error(replace(carry, covariance=covariance), error)
    return carry, jnp.stack(rejected)


def _apply_error(carry: NavigationCarry, error: jax.Array) -> NavigationCarry:
    """The believed state with an error [19] taken out of it."""
    q = quaternion.multiply(quaternion.exp(error[THETA]), carry.q)
    return replace(
        carry,
        p=carry.p + error[P],
        v=carry.v + error[V],
        q=q * jax.lax.rsqrt(jnp.sum(q * q)),
        gyro_bias=carry.gyro_bias + error[GYRO_BIAS],
        accel_bias=carry.accel_bias + error[ACCEL_BIAS],
        depth_offset=carry.depth_offset + error[DEPTH][0],
        heading_bias=carry.heading_bias + error[HEADING][0],
        hard_iron=carry.hard_iron + error[IRON],
    )
