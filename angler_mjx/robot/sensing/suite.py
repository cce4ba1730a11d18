"""Step of all instruments of one robot, with explicit memory and randomness.

Randomness comes in as standard normal numbers. ``sample_noise`` makes them from the robot's key and
the number of the step, nothing else; ``read_instruments`` is elementwise arithmetic, so it runs
under ``vmap``, in ``scan`` and on `angler_kernels.lanes` alike; ``step`` is both.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.robot.sensing import instruments
from angler_mjx.robot.sensing.instruments import is_due
from angler_mjx.robot.sensing.params import SensorParams
from angler_mjx.robot.sensing.readings import ImuReading, Reading, SensorCarry, Truth

N_NORMAL = 29
"""Random numbers of a step: gyro 3, accelerometer 3, their biases 3 + 3, depth 1, attitude 3, DVL 3
+ 1, USBL 7, GPS 2."""


def sample_noise(params: SensorParams, key: jax.Array, step: jax.Array) -> jax.Array:
    """Sample the standard normal numbers [N_NORMAL] of a robot's step.

    Args:
        params: instruments of the robot.
        key: key of the robot: the world's key folded with the robot's index.
        step: int32 [] control steps since the beginning.
    """
    dtype = params.dt_s.dtype
    if not params.noise:
        return jnp.zeros(N_NORMAL, dtype)
    # 0 belongs to the reset.
    return jax.random.normal(jax.random.fold_in(key, step + 1), (N_NORMAL,), dtype)


def reset(params: SensorParams, key: jax.Array, truth: Truth) -> SensorCarry:
    """Start the instruments: sample the constant errors.

    Args:
        params: instruments of the robot.
        key: key of the robot, as for ``sample_noise``.
        truth: its motion at the first step.
    """
    dtype = truth.p.dtype
    normal = jnp.zeros(10, dtype)
    if params.noise:
        normal = jax.random.normal(jax.random.fold_in(key, 0), (10,), dtype)
    zero = jnp.zeros(3, dtype)
    return SensorCarry(
        started=jnp.zeros((), bool),
        before_q=truth.q,
        before_velocity=_imu_velocity(params, truth),
        gyro_turn_on=params.imu.gyro_turn_on_std * normal[:3],
        gyro_walk=zero,
        accel_turn_on=params.imu.accel_turn_on_std * normal[3:6],
        accel_walk=zero,
        surface_m=params.depth.surface_std_m * normal[6],
        heading_bias_rad=params.ahrs.heading_bias_std_rad * normal[7],
        hard_iron=params.ahrs.hard_iron_std * normal[8:10],
        usbl_fix_m=zero,
    )


def step(
    params: SensorParams, carry: SensorCarry, key: jax.Array, step: jax.Array, truth: Truth
) -> tuple[SensorCarry, Reading]:
    """Read all instruments: ``read_instruments`` with the numbers of ``sample_noise``."""
    return read_instruments(params, carry, sample_noise(params, key, step), step, truth)


def read_instruments(
    params: SensorParams, carry: SensorCarry, normal: jax.Array, step: jax.Array, truth: Truth
) -> tuple[SensorCarry, Reading]:
    """Read all instruments.

    Args:
        params: instruments of the robot.
        carry: their memory.
        normal: [N_NORMAL] standard normal numbers of this step.
        step: int32 [] control steps since the beginning; call with every one from 0 on.
        truth: motion now.

    Returns:
        The memory and the readings.
    """
    noise, depth, dvl, usbl, gps = params.noise, params.depth, params.dvl, params.usbl, params.gps
    carry, imu = _measure_imu(params, carry, normal[:12], truth)
    depth_fresh = is_due(depth.every, step)
    ahrs_fresh = is_due(params.ahrs.every, step)
    dvl_fresh = is_due(dvl.every, step) & instruments.dvl_locked(dvl, truth, normal[19], noise)
    gps_fresh = is_due(gps.every, step) & instruments.gps_received(gps, truth)
    pinged = is_due(usbl.every, step)
    fix = instruments.usbl_fix(usbl, truth, normal[20:27], noise)
    fix = jnp.where(pinged, fix, carry.usbl_fix_m)
    usbl_fresh = is_due(usbl.every, step, usbl.latency)
    depth_m = instruments.measure_depth(depth, carry.surface_m, truth, normal[12], noise)
    ahrs_q = instruments.measure_attitude(params.ahrs, carry, truth, normal[13:16], noise)
    velocity = instruments.dvl_velocity(dvl, truth, normal[16:19], noise)
    gps_m = instruments.gps_position(gps, truth, normal[27:29], noise)
    return replace(carry, usbl_fix_m=fix), Reading(
        imu=imu,
        depth_fresh=depth_fresh,
        depth_m=jnp.where(depth_fresh, depth_m, 0.0),
        ahrs_fresh=ahrs_fresh,
        ahrs_q=jnp.where(ahrs_fresh, ahrs_q, 0.0),
        dvl_fresh=dvl_fresh,
        dvl_velocity_mps=jnp.where(dvl_fresh, velocity, 0.0),
        usbl_pinged=pinged,
        usbl_fresh=usbl_fresh,
        usbl_position_m=jnp.where(usbl_fresh, fix, 0.0),
        gps_fresh=gps_fresh,
        gps_position_m=jnp.where(gps_fresh, gps_m, 0.0),
    )


def disturb_truth(params: SensorParams, key: jax.Array, step: jax.Array, truth: Truth) -> Truth:
    """Return the true state with white noise, without instruments; exact with ``noise`` False."""
    if not params.noise:
        return truth
    # A branch of its own: its samples must not depend on whether instruments are read too.
    key = jax.random.fold_in(jax.random.fold_in(key, step + 1), 1)
    normal = jax.random.normal(key, (12,), truth.p.dtype)
    return instruments.disturb_truth(params.truth, truth, normal, params.noise)


def disturb_current(
    params: SensorParams, key: jax.Array, step: jax.Array, current: jax.Array
) -> jax.Array:
    """Return the true current [3] with white noise, m/s; exact with ``noise`` False."""
    if not params.noise:
        return current
    key = jax.random.fold_in(jax.random.fold_in(key, step + 1), 2)
    normal = jax.random.normal(key, (3,), current.dtype)
    return current + params.truth.current_std_mps * normal


def _imu_velocity(params: SensorParams, truth: Truth) -> jax.Array:
    """Return the velocity [3] of the IMU, m/s in W."""
    velocity = instruments.velocity_at(truth.nu, params.imu.offset_m)
    return quaternion.rotate(truth.q, velocity)


def _measure_imu(
    params: SensorParams, carry: SensorCarry, normal: jax.Array, truth: Truth
) -> tuple[SensorCarry, ImuReading]:
    """Read the IMU: advance the biases, then add the same noise to mean and present values."""
    imu, velocity = params.imu, _imu_velocity(params, truth)
    mean_rate, force = instruments.measure_inertial(
        carry.before_q, carry.before_velocity, truth.q, velocity, params.dt_s, params.gravity_mps2
    )
    rate = truth.nu[3:]
    after = replace(
        carry, started=jnp.ones_like(carry.started), before_q=truth.q, before_velocity=velocity
    )
    if params.noise:
        gyro_walk = imu.gyro_walk_kept * carry.gyro_walk + imu.gyro_walk_std * normal[6:9]
        accel_walk = imu.accel_walk_kept * carry.accel_walk + imu.accel_walk_std * normal[9:12]
        gyro_error = carry.gyro_turn_on + gyro_walk + imu.gyro_std * normal[:3]
        rate, mean_rate = rate + gyro_error, mean_rate + gyro_error
        force = force + (carry.accel_turn_on + accel_walk + imu.accel_std * normal[3:6])
        after = replace(after, gyro_walk=gyro_walk, accel_walk=accel_walk)
    fresh = carry.started
    return after, ImuReading(
        fresh=fresh,
        rate_radps=rate,
        mean_rate_radps=jnp.where(fresh, mean_rate, 0.0),
        specific_force_mps2=jnp.where(fresh, force, 0.0),
    )
