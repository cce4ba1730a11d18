"""Limits of targets: whatever the guidance wants, what leaves is finite, slow, and in the fence."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from angler_mjx.errors import ConfigError
from angler_sitl.endpoints.limits import LEAD_S, Fence, Setpoint, SetpointGuard, parse_fence

FENCE = Fence(lower_m=(-5.0, -4.0, -10.0), upper_m=(5.0, 4.0, -1.0))
SPEED, DT = 0.3, 0.05
HOME = np.array([0.0, 0.0, -5.0])
NUMBERS = st.floats(-30.0, 30.0)
VECTORS = st.tuples(NUMBERS, NUMBERS, NUMBERS).map(np.array)


def beside(x, y, z):
    return HOME + np.array([x, y, z])


def target(position, velocity=(0.0, 0.0, 0.0), yaw=0.0):
    return Setpoint(
        position_m=np.array(position, float), velocity_mps=np.array(velocity, float), yaw_rad=yaw
    )


@given(st.lists(st.tuples(VECTORS, VECTORS), min_size=1, max_size=30), VECTORS)
@settings(max_examples=200, deadline=None)
def test_no_sequence_of_targets_breaks_a_limit(wanted, start):
    """A robot that follows as fast as it may: also one that begins outside the fence."""
    guard, robot, last = SetpointGuard(FENCE, SPEED), start, start
    for position, velocity in wanted:
        sent = guard.limit(target(position, velocity), robot, DT)
        assert np.linalg.norm(sent.velocity_mps) <= SPEED + 1e-3
        assert np.linalg.norm(sent.position_m - robot) <= SPEED * LEAD_S + 1e-3
        outside = FENCE.measure_distance(sent.position_m)
        assert outside <= max(0.0, FENCE.measure_distance(robot) - 1e-9) + 1e-9
        if FENCE.measure_distance(robot) == 0.0:
            assert outside <= 1e-9
            assert np.linalg.norm(sent.position_m - last) <= SPEED * DT + 1e-3
        robot = last = sent.position_m


def test_targets_within_the_limits_are_not_touched():
    guard = SetpointGuard(FENCE, SPEED)
    wanted = target(beside(0.01, 0.0, 0.0), [0.2, 0.0, 0.0], 1.0)
    sent = guard.limit(wanted, HOME, DT)
    np.testing.assert_allclose(sent.position_m, wanted.position_m)
    np.testing.assert_allclose(sent.velocity_mps, wanted.velocity_mps)
    assert sent.yaw_rad == 1.0
    assert not guard.counts


@pytest.mark.parametrize(
    ("wanted", "robot"),
    [
        (target([math.nan, 0, -5]), HOME),
        (target([0, 0, -5], [0, math.inf, 0]), HOME),
        (target([0, 0, -5], yaw=math.nan), HOME),
        (target([0, 0, -5]), np.array([0, 0, math.nan])),
    ],
)
def test_numbers_that_are_none_are_not_sent(wanted, robot):
    guard = SetpointGuard(FENCE, SPEED)
    assert guard.limit(wanted, robot, DT) is None
    assert guard.counts == {"not_finite": 1}


def test_each_limit_is_counted():
    guard = SetpointGuard(FENCE, SPEED)
    guard.limit(target(beside(3.0, 0.0, 0.0)), HOME, DT)
    assert guard.counts == {"step": 1}
    guard.limit(target(beside(SPEED * DT, 0.0, 0.0), [0.5, 0, 0]), HOME, DT)
    assert guard.counts == {"step": 1, "speed": 1}
    edge = np.array([4.999, 0.0, -5.0])
    guard.restart()
    sent = guard.limit(target([5.01, 0.0, -5.0], [0.2, 0.1, 0.0]), edge, DT)
    assert guard.counts == {"step": 1, "speed": 1, "fence": 1}
    np.testing.assert_allclose(sent.position_m, [5.0, 0.0, -5.0])
    np.testing.assert_allclose(sent.velocity_mps, [0.0, 0.1, 0.0])  # not on towards the fence
    guard.restart()
    for _ in range(40):  # 2 s with a robot that does not move
        sent = guard.limit(target(beside(0.0, 3.0, 0.0)), HOME, DT)
    np.testing.assert_allclose(sent.position_m, beside(0.0, SPEED * LEAD_S, 0.0), atol=1e-3)
    assert guard.counts["lead"] > 0


def test_a_guard_that_restarts_begins_at_the_robot():
    guard = SetpointGuard(FENCE, SPEED)
    for _ in range(10):
        guard.limit(target(beside(1.0, 0.0, 0.0)), HOME, DT)
    guard.restart()
    sent = guard.limit(target(beside(1.0, 0.0, 0.0)), HOME, DT)
    np.testing.assert_allclose(sent.position_m, beside(SPEED * DT, 0.0, 0.0))


@pytest.mark.parametrize("speed", [0.0, -1.0, math.nan, math.inf])
def test_a_speed_must_be_above_0(speed):
    with pytest.raises(ConfigError, match="--max-speed"):
        SetpointGuard(FENCE, speed)


def test_a_fence_is_six_numbers():
    fence = parse_fence("-5,-4,-10,5,4,-1")
    assert fence == FENCE
    assert str(fence) == "x -5 to 5, y -4 to 4, z -10 to -1 m"
    assert fence.measure_distance(np.array([5.0, 8.0, 2.0])) == pytest.approx(5.0)
    for text in ("", "1,2,3", "5,-4,-10,-5,4,-1", "-5,-4,-1,5,4,-1", "-5,-4,nan,5,4,-1", "a,b"):
        with pytest.raises(ConfigError, match="--fence"):
            parse_fence(text)
