"""Errors of the force-torque sensors of grips, and the law that reads them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.runs.session.batch_session import BatchSession
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.sim.cargo import GripNoise, read_grips, sample_sensors
from angler_mjx.sim.physics.contact.grips import Grips

NOISE = GripNoise(force_std_n=0.5, torque_std_nm=0.02, force_bias_n=2.0, torque_bias_nm=0.3)
SENSOR = {"force_std_n": 0.5, "torque_std_nm": 0.02, "force_bias_n": 2.0, "torque_bias_nm": 0.3}
STD = np.array([0.5] * 3 + [0.02] * 3)
BIAS = np.array([2.0] * 3 + [0.3] * 3)


def hold(wrench):
    """Return grips [R] that measure these wrenches [R, 6]."""
    robots = len(wrench)
    zero = jnp.zeros((robots, 3))
    return Grips(
        held=jnp.ones(robots, bool),
        position_m=zero,
        q=jnp.zeros((robots, 4)),
        center_m=zero,
        lever_m=zero,
        wrench=jnp.asarray(wrench, jnp.float32),
        at_goal_s=jnp.zeros(robots),
    )


def read(sensors, wrench, steps):
    """Return readings [n, R, 6] of steps."""
    grips = hold(wrench)
    return np.asarray(jax.vmap(lambda n: read_grips(grips, sensors, n).wrench)(jnp.asarray(steps)))


def test_readings_spread_about_the_wrench_and_the_bias_of_the_sensor():
    sensors = sample_sensors(NOISE, jax.random.key(3), 2)
    wrench = np.array([[1.0, -2.0, 3.0, 0.1, -0.2, 0.3], [0.0, 0.0, 5.0, 0.0, 0.0, 0.0]])
    errors = read(sensors, wrench, np.arange(4000)) - wrench
    # Standard errors of 4,000 readings: 1.6 % of the mean, 1.1 % of the deviation.
    np.testing.assert_allclose(errors.mean(0) / STD, np.asarray(sensors.bias) / STD, atol=0.08)
    np.testing.assert_allclose(errors.std(0), np.broadcast_to(STD, (2, 6)), rtol=0.06)
    flat = ((errors - errors.mean(0)) / STD).reshape(4000, 12)
    apart = np.corrcoef(flat.T) - np.eye(12)
    assert np.abs(apart).max() < 0.08
    after = np.corrcoef(flat[1:, 0], flat[:-1, 0])[0, 1]
    assert abs(after) < 0.08


def test_each_sensor_has_a_bias_of_its_own():
    bias = np.asarray(
        jax.vmap(lambda key: sample_sensors(NOISE, key, 3).bias)(
            jax.random.split(jax.random.key(5), 500)
        )
    )
    np.testing.assert_allclose(bias.std((0, 1)), BIAS, rtol=0.09)
    np.testing.assert_allclose(bias.mean((0, 1)) / BIAS, 0.0, atol=0.12)
    assert abs(np.corrcoef(bias[:, 0, 0], bias[:, 1, 0])[0, 1]) < 0.2


def test_a_reading_is_that_of_its_step_and_an_open_grip_reads_nothing():
    sensors = sample_sensors(NOISE, jax.random.key(3), 2)
    wrench = np.array([[1.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0] * 6])
    first, again, other = read(sensors, wrench, [4, 4, 5])
    np.testing.assert_array_equal(first, again)
    assert np.all(first[0] != other[0])
    np.testing.assert_array_equal(first[1], 0.0)
    np.testing.assert_array_equal(read(None, wrench, [4])[0], wrench)


def scenario(**task):
    """Return a short flight of carry_pipe."""
    time = {"horizon_s": 20.0, "record_hz": 0.0, "physics_dt_s": 0.01}
    return load_scenario("carry_pipe", worlds=2, tile=2, time=time, task=task)


def test_sensors_are_those_of_a_world_and_no_part_of_the_problem():
    plain, noisy = scenario(), scenario(sensor=SENSOR)
    assert plain.digest() == noisy.digest()
    assert Simulator(plain).worlds().grip_sensors is None
    bias = np.asarray(Simulator(noisy).worlds().grip_sensors.bias)
    assert bias.shape == (2, 2, 6)
    assert len(np.unique(bias)) == bias.size
    np.testing.assert_array_equal(Simulator(noisy).worlds().grip_sensors.bias, bias)


def test_negative_errors_are_refused():
    with pytest.raises(ConfigError, match="force_std_n"):
        scenario(sensor={"force_std_n": -1.0})


def test_the_law_reads_what_the_sensor_shows():
    """Its filter is rebuilt from the readings that a session observes."""
    session = BatchSession(scenario(sensor=SENSOR))
    names = [stage.name for stage in session.inside().simulator.spec.stages]
    law, filter_s, dt = names.index("grip_moment"), 0.5, session.dt_s
    seen = session.reset()
    force = np.zeros((2, 3))
    errors = []
    for _ in range(40):
        force += dt / (filter_s + dt) * (np.asarray(seen.cargo.reading.wrench)[:, :3] - force)
        seen = session.step()
        state = session.inside().state
        np.testing.assert_allclose(state.carry.stages[law][0], force, rtol=1e-4, atol=1e-5)
        errors.append(np.asarray(seen.cargo.reading.wrench) - np.asarray(state.grips.wrench[0]))
    spread = np.std(errors, axis=0)[:, :3]
    assert np.all((spread > 0.3) & (spread < 0.75))
