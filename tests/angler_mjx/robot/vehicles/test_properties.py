"""Closed forms of ``vehicle show`` against independent calculation."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from angler_mjx.robot.vehicles.library import load_vehicle
from angler_mjx.robot.vehicles.properties import compute_trim_rad, describe_vehicle


def test_wu_is_two_newtons_light():
    facts = describe_vehicle(load_vehicle("bluerov2_heavy"), "wu2018", 16.0)
    # The copies of the set swap the two numbers; weight is m g, so buoyancy is the larger.
    assert facts.weight_n == pytest.approx(112.8, abs=0.05)
    assert facts.buoyancy_n == pytest.approx(114.8, abs=0.05)


def test_blue_gazebo_floats_as_its_source_says():
    heavy = describe_vehicle(load_vehicle("bluerov2_heavy"), "blue_gazebo", 16.0)
    light = describe_vehicle(load_vehicle("bluerov2"), "blue_gazebo", 16.0)
    # Net buoyancy is given with two decimals there.
    assert heavy.buoyancy_n - heavy.weight_n == pytest.approx(1.20, abs=0.01)
    assert light.buoyancy_n - light.weight_n == pytest.approx(0.28, abs=0.01)


@pytest.mark.parametrize(("axis", "key"), [(0, "roll_period_s"), (1, "pitch_period_s")])
def test_period_is_that_of_the_undamped_pendulum(axis, key):
    chosen = load_vehicle("bluerov2_heavy").find_set("von_benzon2022")
    inertia = chosen.rigid_body.inertia_kgm2[axis][axis]
    virtual = inertia + chosen.added_mass.coefficients[3 + axis][3 + axis]
    moment = 1000 * 9.81 * 0.0134 * 0.01
    period = getattr(describe_vehicle(load_vehicle("bluerov2_heavy"), "von_benzon2022", 16.0), key)
    angle = 0.01
    after = solve_ivp(
        lambda _, s: [s[1], -moment * np.sin(s[0]) / virtual],
        (0, period),
        [angle, 0.0],
        rtol=1e-10,
        atol=1e-14,
    ).y[:, -1]
    # After one period the swing is back at its top: the angle deviates only in second order, so
    # the rate is what tells. A pendulum of amplitude a is slower by a^2 / 16 = 6e-6 of a turn.
    assert after[0] == pytest.approx(angle, rel=1e-6)
    assert abs(after[1]) < 2 * np.pi * 1e-5 * angle * 2 * np.pi / period


def test_nothing_rights_a_vehicle_whose_centers_coincide():
    facts = describe_vehicle(load_vehicle("bluerov2"), "blue_ismc", 16.0)
    assert facts.roll_period_s is None
    assert facts.pitch_period_s is None


def test_speed_time_constant_is_the_decay_rate_at_terminal_speed():
    facts = describe_vehicle(load_vehicle("bluerov2_heavy"), "wu2018", 16.0)
    mass, d_l, d_q = 11.5 + 5.5, 4.03, 18.18
    v = facts.terminal_speed_mps[0]
    force = d_l * v + d_q * v * v

    def acceleration(speed):
        return (force - d_l * speed - d_q * speed * speed) / mass

    slope = (acceleration(v + 1e-6) - acceleration(v - 1e-6)) / 2e-6
    # Central difference with step 1e-6: rounding of about 1e-9 relative.
    assert facts.speed_time_constant_s[0] == pytest.approx(-1 / slope, rel=1e-6)


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.3, 0.0), (0.0, -0.4), (-2.5, 0.7)])
def test_the_trim_puts_buoyancy_above_weight(roll, pitch):
    """F to W by roll, then pitch: the arm of buoyancy is upright at rest."""
    about_x = [[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]]
    about_y = [[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]]
    arm = (np.array(about_y) @ np.array(about_x)).T @ [0.0, 0.0, 0.02]
    assert compute_trim_rad(arm) == pytest.approx((roll, pitch))


def test_a_vehicle_without_an_arm_has_no_trim():
    assert compute_trim_rad(np.zeros(3)) is None
    assert describe_vehicle(load_vehicle("otter"), None, 16.0).trim_rad is None
