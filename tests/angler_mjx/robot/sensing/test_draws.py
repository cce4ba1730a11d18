"""Instruments, axes, robots and steps draw for themselves."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import quaternion
from angler_mjx.robot.control import navigation
from angler_mjx.robot.control.commands import Estimate
from angler_mjx.robot.control.navigation import NavigationParams
from angler_mjx.robot.sensing import instruments, params, suite
from angler_mjx.robot.sensing.config import SensorsConfig
from angler_mjx.robot.sensing.readings import Truth
from angler_mjx.sim.sensing import FILTER_STEP

from ...compiling import thoroughly
from ...independence import assert_uncorrelated

DT, G = 0.05, 9.81
N = 4000
WHITE = SensorsConfig.model_validate(
    {
        "noise": True,
        "depth": {"rate_hz": 20.0, "resolution_m": 0.0},
        "ahrs": {"rate_hz": 20.0, "hard_iron": 0.0},
        "dvl": {"rate_hz": 20.0, "dropout": 0.0},
        "usbl": {"fitted": True, "period_s": 0.05, "latency_s": 0.0, "outlier": 0.0},
        "gps": {"fitted": True, "rate_hz": 20.0, "max_depth_m": 100.0},
    }
)
"""Every instrument speaks at every step, and nothing rounds or hides its noise."""


@pytest.fixture(scope="module")
def sensors():
    return params.build_sensors(WHITE, DT, G)


def at_rest():
    return Truth(
        p=jnp.array([1.0, 2.0, -5.0]),
        q=quaternion.exp(jnp.array([0.1, -0.2, 0.3])),
        nu=jnp.zeros(6),
        altitude_m=jnp.asarray(5.0),
    )


def turned(truth, q):
    """[3] rad about the axes of W: in F those of a robot that leans would be mixed."""
    return quaternion.rotate(truth.q, instruments.rotation_between(truth.q, q))


NAMES = [
    *[f"gyro {axis}" for axis in "xyz"],
    *[f"accelerometer {axis}" for axis in "xyz"],
    "depth",
    *[f"attitude {axis}" for axis in "xyz"],
    *[f"DVL {axis}" for axis in "xyz"],
    *[f"USBL {axis}" for axis in "xyz"],
    *[f"GPS {axis}" for axis in "xy"],
]


def numbers(reading, truth):
    """[18] all that one robot's instruments say at a step, in the order of `NAMES`."""
    return jnp.concatenate(
        [
            reading.imu.mean_rate_radps,
            reading.imu.specific_force_mps2,
            reading.depth_m[None],
            turned(truth, reading.ahrs_q),
            reading.dvl_velocity_mps,
            reading.usbl_position_m,
            reading.gps_position_m,
        ]
    )


@thoroughly
def _watch(sensors, keys):
    """Readings [robot, step, 18] at rest."""
    truth = at_rest()

    def robot(key):
        def one(carry, k):
            carry, reading = suite.step(sensors, carry, key, k, truth)
            return carry, numbers(reading, truth)

        _, seen = jax.lax.scan(one, suite.reset(sensors, key, truth), jnp.arange(N + 1))
        return seen

    return jax.vmap(robot)(keys)


def test_instruments_axes_robots_and_steps_are_independent(sensors):
    keys = jax.vmap(jax.random.fold_in, (None, 0))(jax.random.key(11), jnp.arange(2))
    seen = np.asarray(_watch(sensors, keys))[:, 1:]  # there is no mean over no step
    # Biases wander slowly; what is left of a reading without that of the step before is noise.
    steps = np.diff(seen, axis=1)[:, ::2]
    both = np.concatenate(list(steps), axis=1)
    names = [f"{name} of robot {i}" for i in range(2) for name in NAMES]
    assert_uncorrelated(both, names)
    # And with what comes two steps later.
    late = np.concatenate([both[1:], both[:-1]], axis=1)
    assert_uncorrelated(late, [f"{name}, next" for name in names] + names)


def test_what_is_drawn_at_the_beginning_and_at_a_step_is_independent(sensors):
    """Over many robots: turn-on errors, the filter's start, readings, and noise on the truth."""
    believes = NavigationParams(sensors=sensors)
    truth = at_rest()

    @jax.jit
    @jax.vmap
    def one(key):
        carry = suite.reset(sensors, key, truth)
        estimate = Estimate(p=truth.p, q=truth.q, nu=truth.nu)
        start = navigation.reset(believes, estimate, jax.random.fold_in(key, FILTER_STEP))
        sampled = suite.sample_noise(sensors, key, jnp.int32(0))
        noisy = suite.disturb_truth(sensors, key, jnp.int32(0), truth)
        flow = suite.disturb_current(sensors, key, jnp.int32(0), jnp.zeros(3))
        groups = {
            "turn-on gyro": carry.gyro_turn_on,
            "turn-on accelerometer": carry.accel_turn_on,
            "surface": carry.surface_m[None],
            "heading bias": carry.heading_bias_rad[None],
            "filter's position": start.p,
            "filter's velocity": start.v,
            "filter's attitude": turned(truth, start.q),
            "noise of step 0": sampled,
            "told position": noisy.p,
            "told attitude": turned(truth, noisy.q),
            "told velocity": noisy.nu,
            "told current": flow,
        }
        return groups

    found = one(jax.vmap(jax.random.fold_in, (None, 0))(jax.random.key(12), jnp.arange(N)))
    names = [f"{name} {i}" for name, rows in found.items() for i in range(rows.shape[1])]
    assert len(names) == 3 + 3 + 1 + 1 + 9 + suite.N_NORMAL + 12 + 3
    assert_uncorrelated(np.concatenate(list(found.values()), axis=1), names)


def test_each_number_of_a_step_serves_one_purpose(sensors):
    """A number that is changed changes what one axis of one instrument says, and nothing else."""
    # Level: rounding would mix the axes of one that leans by 1e-8.
    truth = replace(at_rest(), q=jnp.array([1.0, 0.0, 0.0, 0.0]))
    carry = suite.reset(sensors, jax.random.key(0), truth)
    carry = suite.step(sensors, carry, jax.random.key(0), jnp.int32(0), truth)[0]

    def noise_of(normal):
        after, reading = suite.read_instruments(sensors, carry, normal, jnp.int32(1), truth)
        return jnp.concatenate([numbers(reading, truth), after.gyro_walk, after.accel_walk])

    zero = jnp.zeros(suite.N_NORMAL)
    changed = np.asarray(jax.jit(jax.jacfwd(noise_of))(zero)).T != 0
    gyro, accelerometer, walks = np.arange(3), np.arange(3, 6), 18 + np.arange(6)
    expected = np.zeros((suite.N_NORMAL, 24), bool)
    expected[range(3), gyro] = expected[range(3, 6), accelerometer] = True
    # Biases move, and with them what is measured.
    expected[range(6, 12), range(6)] = expected[range(6, 12), walks] = True
    expected[12, 6] = True
    expected[range(13, 16), range(7, 10)] = True
    expected[range(16, 19), range(10, 13)] = True
    expected[range(20, 23), range(13, 16)] = True
    expected[range(27, 29), range(16, 18)] = True
    np.testing.assert_array_equal(changed, expected)
