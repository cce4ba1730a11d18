"""The T200 tables against the data points and the known facts about them."""

import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.robot.vehicles.library import load_thruster
from angler_mjx.robot.vehicles.thrusters import PWM_GRID_US, tables_at

KGF_N = 9.80665


@pytest.fixture(scope="module")
def t200():
    return load_thruster("t200")


def test_grid_has_201_points():
    assert PWM_GRID_US.shape == (201,)
    assert (PWM_GRID_US[0], PWM_GRID_US[-1]) == (1100, 1900)


def test_every_data_point_is_met_exactly(t200):
    at = np.searchsorted(PWM_GRID_US, t200.pwm_us)
    np.testing.assert_array_equal(PWM_GRID_US[at], t200.pwm_us)
    for column, volt in enumerate(t200.voltage_v):
        thrust, power = tables_at(t200, volt)
        np.testing.assert_array_equal(thrust[at], np.asarray(t200.thrust_n)[:, column])
        np.testing.assert_array_equal(power[at], np.asarray(t200.power_w)[:, column])


def test_full_thrust_is_the_published_kgf(t200):
    published = {10: (2.93, -2.31), 14: (4.53, -3.52), 16: (5.25, -4.07), 20: (6.72, -5.04)}
    for volt, (forward, reverse) in published.items():
        thrust, _ = tables_at(t200, volt)
        # One unit of the published last place, 0.01 kgf = 0.1 N.
        np.testing.assert_allclose(thrust[[-1, 0]], [forward * KGF_N, reverse * KGF_N], atol=0.1)


@pytest.mark.parametrize(("volt", "low", "high"), [(10, 1460, 1540), (16, 1472, 1528)])
def test_dead_band_edges(t200, volt, low, high):
    thrust, power = tables_at(t200, volt)
    inside = (low <= PWM_GRID_US) & (high >= PWM_GRID_US)
    assert np.all(thrust[inside] == 0)
    assert np.all(power[inside] == 0)
    assert thrust[low - 4 == PWM_GRID_US] < 0
    assert thrust[high + 4 == PWM_GRID_US] > 0


@pytest.mark.parametrize("volt", [10, 11.3, 14.8, 16, 19.99])
def test_thrust_rises_with_pwm_outside_the_dead_band(t200, volt):
    thrust, _ = tables_at(t200, volt)
    assert np.all(np.diff(thrust[thrust < 0]) > 0)
    assert np.all(np.diff(thrust[thrust > 0]) > 0)


def test_between_two_voltages_it_is_linear(t200):
    low, high = tables_at(t200, 14)[0], tables_at(t200, 16)[0]
    # float64 rounding of numbers near 50.
    np.testing.assert_allclose(tables_at(t200, 14.5)[0], 0.75 * low + 0.25 * high, atol=1e-13)


def test_a_voltage_outside_the_data_is_refused(t200):
    with pytest.raises(ConfigError, match=r"voltage 9.9 V.*from 10 V to 20 V"):
        tables_at(t200, 9.9)
    with pytest.raises(ConfigError, match="voltage nan"):
        tables_at(t200, float("nan"))
