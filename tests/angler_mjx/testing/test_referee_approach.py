"""How far along a plan the referee takes a robot to be, against clocks that are known."""

import numpy as np
import pytest

from angler_mjx.testing.referee import approach

from ..robot.control.test_last_approach import CASES, GOAL, TOLERANCE_M

DT_S = 0.05


def plan(rows):
    """Times [P] and points [P, 3] of (time, x, y), at the depth of the goal."""
    time, x, y = np.array(rows, float).T
    return time, np.stack([x, y, np.full_like(x, GOAL[2])], axis=-1)


def aims(time_s, point_m, clock_s):
    return np.stack([np.interp(clock_s, time_s, point_m[:, k]) for k in range(3)], axis=-1)


@pytest.mark.parametrize("case", CASES)
def test_the_last_approach_begins_where_the_plan_is_far_for_the_last_time(case):
    rows, begin_s = CASES[case]
    assert approach.last_approach_s(*plan(rows), GOAL, TOLERANCE_M) == begin_s


@pytest.mark.parametrize("case", [case for case in CASES if "waits" not in case])
def test_a_clock_that_runs_and_stands_lies_within_its_bounds(case):
    time_s, point_m = plan(CASES[case][0])
    random = np.random.default_rng(3)
    steps = np.where(random.random(1200) < 0.2, 0.0, DT_S)  # it stands every fifth step
    clock_s = np.minimum(np.cumsum(steps) - steps[0], time_s[-1])
    spans_s = np.full(len(clock_s), DT_S)
    low_s, high_s = approach.progress_s(
        time_s, point_m, np.float32(aims(time_s, point_m, clock_s)), spans_s
    )
    assert np.all(low_s <= clock_s + 1e-9)
    assert np.all(clock_s <= high_s + 1e-9)


def test_a_long_clock_in_float32_lies_within_its_bounds():
    """Over 170 s at 20 Hz the sum runs ahead of the steps by more than the rounding of an aim."""
    time_s, point_m = plan([(0, -12, 0), (68, 15, 0), (142, -14.5, 0), (173, -2, 0)])
    clock_s = np.cumsum(np.full(3450, DT_S, np.float32), dtype=np.float32) - np.float32(DT_S)
    ahead_s = clock_s - DT_S * np.arange(len(clock_s))
    assert 0.4 * ahead_s.max() > approach.AIM_M  # at 0.4 m/s
    bounds = approach.progress_s(
        time_s, point_m, aims(time_s, point_m, clock_s), np.full(len(clock_s), DT_S)
    )
    assert bounds is not None
    assert np.all(bounds[0] <= clock_s + 1e-9)
    assert np.all(clock_s <= bounds[1] + 1e-9)


def test_way_points_on_one_line_do_not_blur_the_bounds():
    """The bounds are as near as the rounding of an aim allows: 1 mm is 2 ms at 0.5 m/s."""
    time_s = np.linspace(0.0, 16.0, 9)
    point_m = np.stack([0.5 * time_s, 0.1 * time_s, 0.0 * time_s], axis=-1)
    clock_s = np.arange(0.0, 15.9, DT_S)
    low_s, high_s = approach.progress_s(
        time_s, point_m, aims(time_s, point_m, clock_s), np.full(len(clock_s), DT_S)
    )
    np.testing.assert_allclose(low_s, clock_s, rtol=0.0, atol=0.003)
    np.testing.assert_allclose(high_s, clock_s, rtol=0.0, atol=0.003)


def test_an_aim_beside_the_plan_bounds_nothing():
    time_s, point_m = plan(CASES["closed"][0])
    aim_m = aims(time_s, point_m, np.arange(0.0, 5.0, DT_S))
    aim_m[50] += [0.0, 0.0, 0.1]
    assert approach.progress_s(time_s, point_m, aim_m, np.full(len(aim_m), DT_S)) is None


@pytest.mark.parametrize(
    ("case", "until_s", "passes"),
    [
        ("closed", 24, True),
        ("from afar to the goal", 10, False),
        ("over the goal and back", 26, True),
    ],
)
def test_passes_are_those_of_the_lines_that_begin_before(case, until_s, passes):
    time_s, point_m = plan(CASES[case][0])
    found = approach.passes_before(time_s, point_m, GOAL, TOLERANCE_M, until_s)
    assert found is passes
