"""Curves of single thrusters: tables, power, limits of motion, and refused files."""

import numpy as np
import pytest
from pydantic import ValidationError

from angler_mjx.robot.control.allocation import (
    allocate_to_limits,
    build_allocation,
    realised_wrench,
)
from angler_mjx.robot.control.commands import BodyWrench
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.library import load_thruster, load_vehicle
from angler_mjx.robot.vehicles.params import build_vehicle, stack_vehicles
from angler_mjx.robot.vehicles.properties import describe_vehicle
from angler_mjx.robot.vehicles.thrust_curves import build_thrust_tables
from angler_mjx.robot.vehicles.thrusters import PWM_GRID_US, tables_at

CURVE = {"pwm_us": [1100, 1500, 1900], "thrust_n": [-10.0, 0.0, 16.0]}


def with_curves(name, curves):
    data = load_vehicle(name).model_dump()
    for i, curve in curves.items():
        data["thrusters"]["layout"][i]["curve"] = curve
    return VehicleConfig.model_validate(data)


def test_one_thruster_has_its_curve_and_the_others_the_file_s():
    thrust_n, power_w = build_thrust_tables(with_curves("bluerov2", {2: CURVE}), 16.0)
    file_n, file_w = tables_at(load_thruster("t200"), 16.0)
    assert thrust_n.shape == power_w.shape == (6, 201)
    np.testing.assert_array_equal(thrust_n[[0, 1, 3, 4, 5]], np.tile(file_n, (5, 1)))
    np.testing.assert_array_equal(power_w[[0, 1, 3, 4, 5]], np.tile(file_w, (5, 1)))
    slope = np.where(PWM_GRID_US < 1500, 10.0, 16.0) / 400.0
    np.testing.assert_allclose(thrust_n[2], slope * (PWM_GRID_US - 1500), atol=1e-12)


def test_without_curves_there_is_one_table():
    for table in build_thrust_tables(load_vehicle("bluerov2"), 16.0):
        assert table.shape == (201,)


def test_power_is_the_file_s_at_the_same_thrust():
    _, power_w = build_thrust_tables(with_curves("bluerov2", {0: CURVE}), 16.0)
    file_n, file_w = tables_at(load_thruster("t200"), 16.0)
    rising = file_n > 0  # one to one there
    for pwm, newton in ((1900, 16.0), (1700, 8.0), (1600, 4.0)):
        expected = np.interp(newton, file_n[rising], file_w[rising])
        assert power_w[0][pwm == PWM_GRID_US] == pytest.approx(expected)
    assert power_w[0][PWM_GRID_US == 1500] == pytest.approx(0.0, abs=1e-9)


def test_power_beyond_the_file_grows_as_the_three_halves_of_thrust():
    strong = {"pwm_us": [1100, 1500, 1900], "thrust_n": [-160.0, 0.0, 200.0]}
    _, power_w = build_thrust_tables(with_curves("bluerov2", {0: strong}), 16.0)
    file_n, file_w = tables_at(load_thruster("t200"), 16.0)
    assert power_w[0, -1] == pytest.approx(file_w[-1] * (200.0 / file_n[-1]) ** 1.5)
    assert power_w[0, 0] == pytest.approx(file_w[0] * (-160.0 / file_n[0]) ** 1.5)


def test_terminal_speeds_are_those_of_each_thruster_at_its_end():
    """Four thrusters across the corners: one of them ten times weaker costs its part of surge."""
    config = with_curves("bluerov2", {0: CURVE})
    found = describe_vehicle(config, None, 16.0)
    thrust_n, _ = tables_at(load_thruster("t200"), 16.0)
    row = found.wrench_matrix[0]
    ends = [(thrust_n[0], thrust_n[-1])] * 6
    ends[0] = (-10.0, 16.0)
    push = {
        sign: sum(
            max(sign * b * low, sign * b * high) for b, (low, high) in zip(row, ends, strict=True)
        )
        for sign in (1, -1)
    }
    force = min(push.values())
    damping = config.find_set(None).damping
    linear, quadratic = damping.linear_diagonal[0], damping.quadratic_diagonal[0]
    speed = found.terminal_speed_mps[0]
    assert linear * speed + quadratic * speed**2 == pytest.approx(force)
    assert speed < describe_vehicle(load_vehicle("bluerov2"), None, 16.0).terminal_speed_mps[0]


def test_a_fleet_has_a_table_for_each_thruster_of_every_vehicle():
    mixed = stack_vehicles(
        [
            build_vehicle(with_curves("bluerov2", {0: CURVE}), None, 16.0),
            build_vehicle(load_vehicle("bluerov2_heavy"), None, 16.0),
            build_vehicle(load_vehicle("remus100"), None, 16.0),
        ]
    )
    assert mixed.thrust_n.shape == mixed.power_w.shape == (3, 8, 201)
    assert mixed.thrust_n[0, 0, -1] == pytest.approx(16.0)
    heavy = build_vehicle(load_vehicle("bluerov2_heavy"), None, 16.0)
    np.testing.assert_array_equal(mixed.thrust_n[1], np.tile(heavy.thrust_n, (8, 1)))


def test_a_wrench_is_met_by_signals_of_each_curve():
    """A demand within the limits comes out whole, though equal thrusts take different signals."""
    vehicles = stack_vehicles(
        [build_vehicle(with_curves("bluerov2_heavy", {0: CURVE}), None, 16.0)]
    )
    params = build_allocation(vehicles)
    one = type(params)(
        **{name: None if value is None else value[0] for name, value in vars(params).items()}
    )
    tau = np.array([12.0, 3.0, -5.0, 0.3, -0.2, 0.8], np.float32)
    pwm = allocate_to_limits(one, BodyWrench(tau=tau))
    np.testing.assert_allclose(realised_wrench(one, pwm).tau, tau, atol=2e-3)
    # Thrusters 0 and 1 push alike in surge, by other signals.
    assert abs(float(pwm.pwm_us[0]) - float(pwm.pwm_us[1])) > 20
    full = allocate_to_limits(one, BodyWrench(tau=np.array([500.0, 0, 0, 0, 0, 0], np.float32)))
    thrust = np.interp(full.pwm_us[0], CURVE["pwm_us"], CURVE["thrust_n"])
    assert -10.001 <= thrust <= 16.001


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"thrust_n": [-10.0, 0.0]}, "needs 3 values"),
        ({"thrust_n": [-10.0, 2.0, 1.0]}, "must not fall"),
        ({"pwm_us": [1100, 1500, 1800]}, "must cover"),
        ({"pwm_us": [1500, 1100, 1900]}, "must increase"),
        ({"thrust_n": [0.0, 1.0, 2.0]}, "negative at the first"),
    ],
)
def test_curves_that_cannot_be_are_refused(change, match):
    with pytest.raises(ValidationError, match=match):
        with_curves("bluerov2", {0: CURVE | change})
