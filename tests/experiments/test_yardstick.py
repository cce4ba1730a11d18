"""Yardsticks agree with closed forms and with each other."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from angler_experiments.currents.grid import steady_min_time_s
from angler_experiments.currents.zermelo import (
    shoot_min_time_s,
    uniform_min_energy_j,
    uniform_min_time_s,
)

START, GOAL = np.array([2.0, 2.0]), np.array([9.0, 5.0])
BOUNDS = ((0.0, 0.0), (12.0, 8.0))


def uniform(xy, t):
    return np.broadcast_to([0.2, -0.1], xy.shape)


def rankine(xy, t):
    x, y = xy[..., 0] - 6.0, xy[..., 1] - 4.0
    turn = 0.3 / 1.5 / np.maximum((x * x + y * y) / 1.5**2, 1.0)
    return np.stack([-turn * y, turn * x], axis=-1)


def test_uniform_flow_with_and_against_and_across():
    points = [np.zeros(2), np.array([6.0, 0.0])]
    assert uniform_min_time_s([0.2, 0.0], *points, 0.5) == pytest.approx(6 / 0.7)
    assert uniform_min_time_s([-0.2, 0.0], *points, 0.5) == pytest.approx(6 / 0.3)
    assert uniform_min_time_s([0.0, 0.3], *points, 0.5) == pytest.approx(6 / 0.4)
    assert uniform_min_time_s([-0.6, 0.0], *points, 0.5) == math.inf


def test_best_speed_in_still_water_is_where_hotel_is_twice_the_drag():
    energy, speed = uniform_min_energy_j(
        np.zeros(2), START, GOAL, hotel_w=16.0, cubic_ws3pm3=64.0, speeds=(0.1, 2.0)
    )
    # d/dV (H / V + c V^2) = 0: V^3 = H / (2 c).
    assert speed == pytest.approx(0.5, rel=1e-6)
    assert energy == pytest.approx(24.0 / 0.5 * math.hypot(7, 3), rel=1e-9)


def test_both_ways_meet_the_closed_form_on_uniform_flow():
    want = uniform_min_time_s([0.2, -0.1], START, GOAL, 0.5)
    shot = shoot_min_time_s(
        uniform, START, GOAL, 0.5, BOUNDS, horizon_s=30.0, headings=90, step_s=0.2
    )
    assert shot == pytest.approx(want, rel=1e-4)
    assert steady_min_time_s(uniform, START, GOAL, 0.5, BOUNDS, cells=36) == pytest.approx(
        want, rel=0.005
    )


def test_extremals_and_grid_agree_around_a_vortex():
    shot = shoot_min_time_s(
        rankine, START, GOAL, 0.5, BOUNDS, horizon_s=40.0, headings=90, step_s=0.2
    )
    coarse, fine = (steady_min_time_s(rankine, START, GOAL, 0.5, BOUNDS, cells=n) for n in (48, 96))
    assert fine == pytest.approx(shot, rel=0.005)
    # First order halves the error; 0.47 % and 0.25 % here.
    assert abs(fine - shot) < 0.7 * abs(coarse - shot)


def test_a_tide_that_turns_meets_its_closed_form():
    """Water that is the same everywhere carries along: |goal - start - its way| = V T."""

    def tide(xy, t):
        return np.broadcast_to([0.3 * np.cos(0.5 * t), 0.1], xy.shape)

    def short(t):
        carried = np.array([0.6 * np.sin(0.5 * t), 0.1 * t])
        return np.hypot(*(GOAL - START - carried)) - 0.5 * t

    want = brentq(short, 5.0, 20.0)
    shot = shoot_min_time_s(tide, START, GOAL, 0.5, BOUNDS, horizon_s=25.0, headings=90, step_s=0.2)
    assert shot == pytest.approx(want, rel=1e-4)


def test_a_goal_beyond_the_horizon_is_not_reached():
    assert (
        shoot_min_time_s(uniform, START, GOAL, 0.5, BOUNDS, horizon_s=5.0, headings=36) == math.inf
    )
