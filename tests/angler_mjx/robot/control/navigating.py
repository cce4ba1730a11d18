"""A robot on a figure of eight, known in closed form, and filters that follow it."""

from functools import partial

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.robot.control import navigation
from angler_mjx.robot.control.commands import Estimate
from angler_mjx.robot.sensing import config as sensing_config
from angler_mjx.robot.sensing import instruments, params, suite
from angler_mjx.robot.sensing.readings import Truth

from ...compiling import quickly, thoroughly

DT = 0.05
GRAVITY = 9.81
ALTITUDE = 5.0


def pose(t):
    """An eight of 6 x 3 m in 31 s, at up to 0.85 m/s, bow ahead, swaying by up to 6 degrees."""

    def place(t):
        x, y = 3.0 * jnp.sin(0.2 * t), 1.5 * jnp.sin(0.4 * t)
        return jnp.stack([x, y, -5.0 + 0.5 * jnp.sin(0.14 * t)])

    p, v = jax.jvp(place, (t,), (jnp.ones_like(t),))
    turns = [0.1 * jnp.sin(0.9 * t), 0.08 * jnp.sin(1.3 * t), jnp.arctan2(v[1], v[0])]
    x, y, z = (quaternion.exp(a * axis) for a, axis in zip(turns, jnp.eye(3), strict=True))
    return p, v, quaternion.multiply(z, quaternion.multiply(y, x))


def motion(t):
    """Truth at a time []."""
    (p, _, q), (v, _, dq) = jax.jvp(pose, (t,), (jnp.ones_like(t),))
    omega = 2.0 * quaternion.multiply(quaternion.conjugate(q), dq)[1:]
    nu = jnp.concatenate([quaternion.rotate_inverse(q, v), omega])
    return Truth(p=p, q=q, nu=nu, altitude_m=jnp.full((), ALTITUDE, p.dtype))


def build(noise=True, **tables):
    """Sensor parameters with parts of the configuration replaced."""
    chosen = sensing_config.SensorsConfig.model_validate({"noise": noise, **tables})
    return params.build_sensors(chosen, DT, GRAVITY)


def believed(truth):
    return Estimate(p=truth.p, q=truth.q, nu=truth.nu)


def errors(sensors, sensed, carry, truth):
    """Error state [19]: true minus believed."""
    velocity = instruments.velocity_at(truth.nu, sensors.imu.offset_m)
    turn = instruments.rotation_between(
        quaternion.conjugate(truth.q), quaternion.conjugate(carry.q)
    )
    return jnp.concatenate(
        [
            instruments.point_position(truth, sensors.imu.offset_m) - carry.p,
            quaternion.rotate(truth.q, velocity) - carry.v,
            turn,
            sensed.gyro_turn_on + sensed.gyro_walk - carry.gyro_bias,
            sensed.accel_turn_on + sensed.accel_walk - carry.accel_bias,
            (sensed.surface_m - carry.depth_offset)[None],
            (sensed.heading_bias_rad - carry.heading_bias)[None],
            sensed.hard_iron - carry.hard_iron,
        ]
    )


def follow(sensors, truths, key):
    """One run: errors, covariances, standard deviations and rejections at the end of each second.

    ``truths`` has leaves [seconds, steps in a second, ...].
    """
    first = jax.tree.map(lambda x: x[0, 0], truths)
    believes = navigation.NavigationParams(sensors=sensors)
    of_sensors, of_filter = jax.random.split(key)
    sensed = suite.reset(sensors, of_sensors, first)
    carry = navigation.reset(believes, believed(first), of_filter)

    def one(state, truth):
        k, sensed, carry = state
        sensed, reading = suite.step(sensors, sensed, of_sensors, k, truth)
        carry, out = navigation.step(believes, carry, reading)
        return (k + 1, sensed, carry), out

    def second(state, truths):
        state, out = jax.lax.scan(one, state, truths)
        truth = jax.tree.map(lambda x: x[-1], truths)
        return state, (
            errors(sensors, state[1], state[2], truth),
            state[2].covariance,
            out.std[-1],
            jnp.sum(out.rejected, axis=0),
        )

    return jax.lax.scan(second, (jnp.zeros((), jnp.int32), sensed, carry), truths)[1]


@partial(quickly, static_argnums=(0, 1))
def times(dtype, seconds):
    t = jnp.arange(seconds * 20, dtype=dtype) * DT
    truths = jax.vmap(motion)(t)
    return jax.tree.map(lambda x: x.reshape(seconds, 20, *x.shape[1:]), truths)


many = jax.vmap(follow, (None, None, 0))
"""Many runs of the same motion: leaves [run, second, ...]."""
fleet = thoroughly(many)
"""The same for hundreds of runs, which take a quarter of the time so ..."""
alone = quickly(many)
"""... and for one, of which most is compiling."""
