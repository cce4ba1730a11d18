"""Where a robot believes it is: an error-state Kalman filter on its instruments, for one robot.

The believed state is position and velocity of the IMU's place in W, attitude, and the biases of
gyroscopes and accelerometers; [15] errors of it have a covariance (`error_state`). The IMU moves
the state once in a control period, then whatever is fresh corrects it, without branches. After
Sola, Quaternion kinematics for the error-state Kalman filter, 2017, with the attitude error in W.
A fix that arrives late is moved forward by the way that was reckoned since it was taken.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.control import error_state
from angler_mjx.control.commands import Estimate
from angler_mjx.control.error_state import ACCEL_BIAS, GYRO_BIAS, N_STATE, THETA, P, V, skew
from angler_mjx.sensing import instruments
from angler_mjx.sensing.params import SensorParams
from angler_mjx.sensing.readings import Reading

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
    covariance: jax.Array
    """[15, 15] of the error state."""
    from_ping: jax.Array
    """[3] reckoned way from where the transponder was at the last USBL ping to where the IMU is
    now, m in W."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Navigated:
    """What the filter gives at a control step."""

    estimate: Estimate
    """Of the centre of mass, as a controller takes it."""
    std: jax.Array
    """[15] standard deviations of the error state, constant errors of the instruments included."""
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
    zero = jnp.zeros(3, dtype)
    velocity = instruments.velocity_at(estimate.nu, imu.offset_m)
    carry = NavigationCarry(
        p=estimate.p + quaternion.rotate(estimate.q, imu.offset_m),
        v=quaternion.rotate(estimate.q, velocity),
        q=estimate.q,
        gyro_bias=zero,
        accel_bias=zero,
        covariance=jnp.eye(N_STATE, dtype=dtype) * std**2,
        from_ping=zero,
    )
    if not sensors.noise:
        return carry
    off = std[:9] * jax.random.normal(key, (9,), dtype)
    return _corrected(carry, jnp.concatenate([off, jnp.zeros(6, dtype)]))


def step(
    params: NavigationParams, carry: NavigationCarry, reading: Reading
) -> tuple[NavigationCarry, Navigated]:
    """One control step: move with the IMU, correct with what is fresh.

    Args:
        params: of the robot.
        carry: memory.
        reading: of its instruments at this step.

    Returns:
        The memory, and the estimate with its standard deviations.
    """
    carry = predict(params.sensors, carry, reading)
    arm = _arm(params.sensors, carry, params.sensors.usbl.offset_m)
    carry = replace(carry, from_ping=jnp.where(reading.usbl_pinged, -arm, carry.from_ping))
    carry, rejected = correct(params.sensors, carry, reading)
    rate = reading.imu.rate_radps - carry.gyro_bias
    offset = params.sensors.imu.offset_m
    velocity = quaternion.rotate_inverse(carry.q, carry.v) - jnp.cross(rate, offset)
    return carry, Navigated(
        estimate=Estimate(
            p=carry.p - quaternion.rotate(carry.q, offset),
            q=carry.q,
            nu=jnp.concatenate([velocity, rate]),
        ),
        std=_std(params.sensors, carry),
        rejected=rejected,
    )


def _std(sensors: SensorParams, carry: NavigationCarry) -> jax.Array:
    """Standard deviations [15], with what depth and heading may be off by for good.

    No other instrument sees those two, so the covariance shrinks past them.
    """
    variance = jnp.stack([carry.covariance[i, i] for i in range(N_STATE)])
    depth = sensors.depth.surface_std_m**2
    heading = sensors.ahrs.heading_bias_std_rad**2 + sensors.ahrs.hard_iron_std**2
    zero = jnp.zeros_like(depth)
    constant = jnp.stack([zero, zero, depth, *[zero] * 5, heading, *[zero] * 6])
    return jnp.sqrt(jnp.maximum(variance, 0.0) + constant)


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
    way = 0.5 * dt * (carry.v + v)
    covariance = error_state.propagate(carry.covariance, quaternion.to_matrix(middle), force, dt)
    covariance = error_state.add_noise(
        covariance, imu.gyro_std, imu.accel_std, imu.gyro_walk_std, imu.accel_walk_std, dt
    )
    way = jnp.where(fresh, way, 0.0)
    q = quaternion.multiply(carry.q, quaternion.exp(rotation))
    return NavigationCarry(
        p=carry.p + way,
        v=jnp.where(fresh, v, carry.v),
        q=jnp.where(fresh, q, carry.q),
        gyro_bias=carry.gyro_bias,
        accel_bias=carry.accel_bias,
        covariance=jnp.where(fresh, covariance, carry.covariance),
        from_ping=carry.from_ping + way,
    )


def correct(
    sensors: SensorParams, carry: NavigationCarry, reading: Reading
) -> tuple[NavigationCarry, jax.Array]:
    """Correct the state with all fresh readings, each against its own gate.

    All are linearised about the same state, corrected once at the end.

    Returns:
        The memory, and bool [5] what was fresh but not believed.
    """
    measurements = [
        (reading.depth_fresh, _depth(sensors, carry, reading)),
        (reading.ahrs_fresh, _attitude(sensors, carry, reading)),
        (reading.dvl_fresh, _dvl(sensors, carry, reading)),
        (reading.usbl_fresh, _usbl(sensors, carry, reading)),
        (reading.gps_fresh, _gps(sensors, carry, reading)),
    ]
    covariance, error = carry.covariance, jnp.zeros_like(carry.covariance[0])
    rejected = []
    for is_fresh, (rows, residual, variance) in measurements:
        gate = GATES[rows.shape[0] - 1]
        covariance, error, taken = error_state.fuse(
            covariance, error, rows, residual, variance, gate, is_fresh
        )
        rejected.append(is_fresh & ~taken)
    carry = _corrected(replace(carry, covariance=covariance), error)
    return carry, jnp.stack(rejected)


type Measurement = tuple[jax.Array, jax.Array, jax.Array]
"""Rows [m, 15], residual [m] and variance [m] of a measurement."""


def _position_rows(arm: jax.Array) -> jax.Array:
    """[3, 15]: how the place at an arm [3] (in W) from the IMU follows from the error state."""
    zero = jnp.zeros((3, 3), arm.dtype)
    return jnp.concatenate([jnp.eye(3, dtype=arm.dtype), zero, -skew(arm), zero, zero], axis=1)


def _arm(sensors: SensorParams, carry: NavigationCarry, offset: jax.Array) -> jax.Array:
    """Way [3] from the IMU to an instrument, in W."""
    return quaternion.rotate(carry.q, offset - sensors.imu.offset_m)


def _depth(sensors: SensorParams, carry: NavigationCarry, reading: Reading) -> Measurement:
    depth = sensors.depth
    arm = _arm(sensors, carry, depth.offset_m)
    residual = -reading.depth_m - (carry.p + arm)[2:]
    # A rounding error is spread evenly over one step of the resolution.
    variance = depth.std_m**2 + depth.surface_std_m**2 + depth.resolution_m**2 / 12.0
    return _position_rows(arm)[2:], residual, variance[None]


def _attitude(sensors: SensorParams, carry: NavigationCarry, reading: Reading) -> Measurement:
    ahrs = sensors.ahrs
    measured = jnp.where(reading.ahrs_fresh, reading.ahrs_q, carry.q)
    residual = instruments.turned(quaternion.conjugate(carry.q), quaternion.conjugate(measured))
    zero = jnp.zeros((3, 3), residual.dtype)
    rows = jnp.concatenate([zero, zero, jnp.eye(3, dtype=residual.dtype), zero, zero], axis=1)
    level = ahrs.level_std_rad**2
    heading = ahrs.heading_std_rad**2 + ahrs.heading_bias_std_rad**2 + ahrs.hard_iron_std**2
    return rows, -residual, jnp.stack([level, level, heading])


def _dvl(sensors: SensorParams, carry: NavigationCarry, reading: Reading) -> Measurement:
    """Turned into W, where the noise, the same along all axes, stays uncorrelated.

    R (z - omega x l) = v - dtheta x v + R [l]x dbg, with the arm l from the IMU to the DVL.
    """
    arm = sensors.dvl.offset_m - sensors.imu.offset_m
    rate = reading.imu.rate_radps - carry.gyro_bias
    measured = quaternion.rotate(carry.q, reading.dvl_velocity_mps - jnp.cross(rate, arm))
    by_bias = error_state.times(quaternion.to_matrix(carry.q), skew(arm))
    zero, one = jnp.zeros((3, 3), rate.dtype), jnp.eye(3, dtype=rate.dtype)
    rows = jnp.concatenate([zero, one, skew(carry.v), by_bias, zero], axis=1)
    variance = instruments.dvl_std(sensors.dvl, reading.dvl_velocity_mps) ** 2
    return rows, measured - carry.v, jnp.stack([variance] * 3)


def _usbl(sensors: SensorParams, carry: NavigationCarry, reading: Reading) -> Measurement:
    """Moved forward by the way reckoned since the ping.

    That way is off by the error of velocity times the latency, which is added to the noise.
    """
    usbl = sensors.usbl
    residual = reading.usbl_position_m + carry.from_ping - carry.p
    of_velocity = jnp.stack([carry.covariance[i, i] for i in range(V.start, V.stop)])
    variance = instruments.usbl_std(usbl, carry.p) ** 2 + usbl.latency_s**2 * of_velocity
    return _position_rows(_arm(sensors, carry, usbl.offset_m)), residual, variance


def _gps(sensors: SensorParams, carry: NavigationCarry, reading: Reading) -> Measurement:
    arm = _arm(sensors, carry, sensors.gps.offset_m)
    residual = reading.gps_position_m - (carry.p + arm)[:2]
    return _position_rows(arm)[:2], residual, jnp.stack([sensors.gps.std_m**2] * 2)


def _corrected(carry: NavigationCarry, error: jax.Array) -> NavigationCarry:
    """The believed state with an error [15] taken out of it."""
    q = quaternion.multiply(quaternion.exp(error[THETA]), carry.q)
    return replace(
        carry,
        p=carry.p + error[P],
        v=carry.v + error[V],
        q=q * jax.lax.rsqrt(jnp.sum(q * q)),
        gyro_bias=carry.gyro_bias + error[GYRO_BIAS],
        accel_bias=carry.accel_bias + error[ACCEL_BIAS],
    )
