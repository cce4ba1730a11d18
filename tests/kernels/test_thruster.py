"""Thruster tables and the rotor's lag."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from angler_kernels import thruster
from angler_mjx.robot.vehicles.library import load_thruster
from angler_mjx.robot.vehicles.thrusters import PWM_GRID_US, PWM_LOW_US, PWM_STEP_US, tables_at

GRID = (PWM_LOW_US, PWM_STEP_US)
RECORDS = [HealthCheck.function_scoped_fixture]
"""All draws of a test are recorded by one fixture, which keeps the greatest."""


@pytest.fixture(scope="module", autouse=True)
def x64():
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="module")
def t200():
    return load_thruster("t200")


@jax.jit
def there_and_back(table, force):
    pwm = jax.vmap(thruster.inverse_lookup, (None, 0, None, None))(table, force, *GRID)
    return pwm, jax.vmap(thruster.lookup, (None, 0, None, None))(table, pwm, *GRID)


def test_lookup_is_numpys(t200, deviation):
    table, power = tables_at(t200, 15.3)
    pwm = np.random.default_rng(0).uniform(1000, 2000, 300)  # Beyond both ends, too.
    for values in (table, power):
        ours = jax.vmap(thruster.lookup, (None, 0, None, None))(jnp.asarray(values), pwm, *GRID)
        # float64 rounding on numbers up to 600.
        deviation.close("thruster.table", ours, np.interp(pwm, PWM_GRID_US, values), atol=1e-11)


# One draw is a whole range of forces; 60 voltages over the data's range suffice.
@settings(max_examples=60, deadline=None, suppress_health_check=RECORDS)
@given(voltage=st.floats(10.0, 20.0))
def test_the_inverse_gives_the_force_back(t200, voltage, deviation):
    table, _ = tables_at(t200, voltage)
    force = np.linspace(table[0], table[-1], 501)
    pwm, again = there_and_back(jnp.asarray(table), jnp.asarray(force))
    # float64 rounding of up to 66 N through a PWM of up to 1900.
    deviation.close("thruster.inverse", again, force, atol=1e-11)
    assert np.all(np.diff(pwm) >= 0)


@pytest.mark.parametrize("voltage", [10.0, 13.3, 16.0, 18.0, 19.1, 20.0])
def test_no_force_is_inside_the_dead_band(t200, voltage):
    table, _ = tables_at(t200, voltage)
    still = PWM_GRID_US[table == 0]
    pwm, force = there_and_back(jnp.asarray(table), jnp.zeros(501))
    assert pwm[0] == still[0]
    assert force[0] == 0


def test_forces_out_of_reach_give_the_ends(t200):
    table = jnp.asarray(tables_at(t200, 16.0)[0])
    pwm, force = there_and_back(table, jnp.linspace(-1000, 1000, 501))
    np.testing.assert_array_equal([pwm[0], pwm[-1]], [1100, 1900])
    np.testing.assert_array_equal([force[0], force[-1]], [table[0], table[-1]])


@settings(max_examples=30, deadline=None, suppress_health_check=RECORDS)
@given(
    start=st.floats(-50, 50),
    command=st.floats(-50, 50),
    tau=st.floats(0.005, 0.5),
    dt=st.floats(0.001, 0.1),
)
def test_rotor_lag_is_exact(start, command, tau, dt, deviation):
    def closed_form(t):
        return command + (start - command) * np.exp(-t / tau)

    end, mean = thruster.rotor_lag(jnp.float64(start), jnp.float64(command), jnp.float64(tau), dt)
    # float64 rounding on up to 50 N; 1 - exp(-dt / tau) loses three digits at dt / tau = 0.002.
    deviation.close("rotor.lag", end, closed_form(dt), atol=1e-12)
    deviation.close("rotor.lag_mean", mean, quad(closed_form, 0, dt)[0] / dt, atol=1e-10)


def test_two_half_steps_are_one():
    tau = jnp.float64(0.02)
    whole, mean = thruster.rotor_lag(jnp.float64(5.0), jnp.float64(-20.0), tau, 0.01)
    half, first = thruster.rotor_lag(jnp.float64(5.0), jnp.float64(-20.0), tau, 0.005)
    end, second = thruster.rotor_lag(half, jnp.float64(-20.0), tau, 0.005)
    # Exact in time, so only rounding is left.
    np.testing.assert_allclose([end, 0.5 * (first + second)], [whole, mean], rtol=1e-14)
