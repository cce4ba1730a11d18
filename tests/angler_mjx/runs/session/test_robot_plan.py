"""A plan with headings and velocities that is taken up again: the same motion from there on."""

from dataclasses import replace

import numpy as np
import pytest

from angler_mjx.robot.control.commands.joint_trajectory import VEHICLE_JOINTS, JointTrajectory
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.plans import joints_at
from angler_mjx.runs.session.robot_plan import TURN_RADPS, RobotPlan

TIME_S = np.array([0.0, 5.0, 9.0, 14.0, 20.0])


def motion(degree=(3, 5, 1, 3, 3)):
    """Of half a metre a second, to rest."""
    random = np.random.default_rng(2)
    table = random.normal(size=(3, 5, 4)) * np.array([2.0, 0.3, 0.05])[:, None, None]
    table[1:, -1] = 0.0
    return JointTrajectory(
        joints=VEHICLE_JOINTS,
        time_s=TIME_S,
        position=table[0],
        velocity=table[1],
        acceleration=table[2],
        degree=np.array(degree, np.int32),
        commanded=np.ones(4, bool),
    )


def padded(plan, more):
    def edge(leaf):
        return np.pad(leaf, [(0, more)] + [(0, 0)] * (leaf.ndim - 1), mode="edge")

    names = ("time_s", "position", "velocity", "acceleration", "degree")
    return replace(plan, **{name: edge(getattr(plan, name)) for name in names})


def test_it_is_told_as_it_was_planned():
    padded_plan = RobotPlan.of(padded(motion(), 3)).padded(12, np.float64)
    want = padded(motion(), 7)
    for name in ("time_s", "position", "velocity", "acceleration", "degree", "commanded"):
        np.testing.assert_array_equal(getattr(padded_plan, name), getattr(want, name))
    assert padded_plan.joints == VEHICLE_JOINTS
    assert padded_plan.found is None


def test_a_robot_that_is_to_hold_has_a_plan_too():
    hold = padded(replace(motion(), time_s=np.zeros(5), position=np.ones((5, 4))), 2)
    plan = RobotPlan.of(hold)
    np.testing.assert_array_equal(plan.at([0.0, 7.0]), np.ones((2, 3)))
    assert plan.padded(9, np.float32).time_s.shape == (9,)


@pytest.mark.parametrize("join_s", [0.0, 2.0, 7.0, 10.0, 17.5])
def test_from_where_it_is_joined_it_is_the_same_motion(join_s):
    """Whatever polynomial the point lies on."""
    plan = RobotPlan.of(motion())
    detour = np.array([[3.0, 3.0, -3.0], [2.0, 1.0, -2.0], plan.at(join_s)])
    whole = plan.after(detour, np.array([0.0, 4.0, 9.0]), join_s, yaw_rad=0.5)
    np.testing.assert_array_equal(whole.position_m[:2], detour[:2])
    at = np.linspace(join_s, 20.5, 300)
    begins = whole.time_s[2]
    want, found = joints_at(motion(), at), joints_at(whole.motion, at - join_s + begins)
    for name in ("position", "velocity"):
        np.testing.assert_allclose(getattr(found, name), getattr(want, name), atol=1e-9)
    # Straight on the way, and turning no faster than a robot does.
    middle = joints_at(whole.motion, [0.5 * (whole.time_s[0] + whole.time_s[1])])
    np.testing.assert_allclose(middle.position[0, :3], 0.5 * (detour[0] + detour[1]), atol=1e-12)
    rate = np.abs(np.diff(whole.motion.position[:3, 3])) / np.diff(whole.time_s[:3])
    assert rate.max() <= TURN_RADPS + 1e-9
    first = whole.motion.position[0, 3] - 0.5
    np.testing.assert_allclose(first % (2 * np.pi), 0.0, atol=1e-9)


def test_a_short_way_takes_as_long_as_its_turn():
    plan = RobotPlan.of(motion())
    here = plan.at(3.0)
    yaw = joints_at(motion(), [3.0]).position[0, 3]
    for detour_s in (0.0, 0.2):
        whole = plan.after(np.array([here, here]), np.array([0.0, detour_s]), 3.0, yaw + 1.2)
        assert whole.time_s[1] == pytest.approx(1.2 / TURN_RADPS)


@pytest.mark.parametrize("degree", [(3, 5, 1, 3, 3), (1, 1, 1, 1, 1), (5, 5, 5, 5, 5)])
def test_it_sets_out_evenly_along_the_same_curve(degree):
    plan = RobotPlan.of(motion(degree))
    share, speed = 0.2, 0.9
    eased = plan.eased(share, speed)
    ramp = (1 - share) * speed / 0.25
    late = ramp - (share * ramp + (1 - share) * ramp / 2)
    assert eased.time_s[-1] == pytest.approx(20.0 + late)
    s = np.linspace(0.0, eased.time_s[-1] - 1e-3, 400)
    t = np.where(s < ramp, share * s + (1 - share) * s**2 / (2 * ramp), s - late)
    want, found = joints_at(plan.motion, t), joints_at(eased.motion, s)
    # What goes by evenly faster is a polynomial of twice the degree: these come near.
    bound = 0.02 if degree[0] == 1 else 3e-3
    np.testing.assert_allclose(found.position, want.position, atol=bound)
    after = s > eased.time_s[9]
    np.testing.assert_allclose(found.position[after], want.position[after], atol=1e-9)
    np.testing.assert_allclose(found.velocity[after], want.velocity[after], atol=1e-9)


def test_way_points_stay_way_points():
    time, point = np.array([0.0, 4.0, 4.0]), np.arange(9.0).reshape(3, 3)
    path = Trajectory(time_s=time, position_m=point, found=np.array(True))
    padded_plan = RobotPlan.of(path).padded(3, np.float64)
    assert isinstance(padded_plan, Trajectory)
    np.testing.assert_array_equal(padded_plan.position_m, point[[0, 1, 1]])
