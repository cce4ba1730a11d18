"""Plans of either type: what they say, as messages and as lines, and who flies them."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control import plans, stages
from angler_mjx.robot.control.commands.joint_goal import build_trajectory
from angler_mjx.robot.control.commands.joint_trajectory import (
    VEHICLE_JOINTS,
    JointTrajectory,
    sample_state,
)
from angler_mjx.robot.control.commands.trajectory import Trajectory

from ...compiling import quickly

TIME_S = np.array([0.0, 2.0, 3.5, 4.0, 7.0, 8.0, 8.0, 8.0])
"""The last two are padding."""
DEGREES = [3, 1, 5, 3, 5, 1, 1, 1]


def joints(degree=DEGREES, seed=0):
    random = np.random.default_rng(seed)
    table = random.normal(size=(3, TIME_S.size, 4))
    table[:, 6:] = table[:, 5:6]
    table[1:, 5:] = 0.0
    return JointTrajectory(
        joints=VEHICLE_JOINTS,
        time_s=TIME_S,
        position=table[0],
        velocity=table[1],
        acceleration=table[2],
        degree=np.array(degree, np.int32),
        commanded=np.ones(4, bool),
    )


def lines():
    made = joints()
    return Trajectory(time_s=TIME_S, position_m=made.position[:, :3], found=np.array(True))


@pytest.fixture(scope="module")
def sampled():
    """States of a trajectory at times."""
    return quickly(jax.vmap(sample_state, (None, 0)))


@pytest.mark.parametrize("degree", [DEGREES, [1] * 8, [3] * 8, [5] * 8, [1, 5, 1, 3, 1, 5, 5, 5]])
def test_a_message_makes_the_same_motion(degree, sampled):
    """Also where lines lie between points whose other segments use velocities."""
    with jax.enable_x64(True):
        plan = joints(degree)
        goal = plans.to_joint_goal(plan)
        made = build_trajectory(
            goal, joints=VEHICLE_JOINTS, position=plan.position[0].tolist(), size=16
        )
        times = np.linspace(0.0, 8.5, 400)
        want, found = sampled(plan, times), sampled(made, times)
    # The heading is unwrapped by the whole; the others are compared as they are.
    np.testing.assert_allclose(found.position[:, :3], want.position[:, :3], atol=1e-9)
    np.testing.assert_allclose(found.velocity[:, :3], want.velocity[:, :3], atol=1e-8)
    turns = (found.position[:, 3] - want.position[:, 3]) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)


def test_way_points_are_a_message_of_places():
    goal = plans.to_joint_goal(lines())
    assert goal.joint_names == ("x", "y", "z")
    assert [point.time_s for point in goal.points] == TIME_S[:6].tolist()
    assert all(point.velocities == () for point in goal.points)


def test_the_host_samples_as_the_device_does(sampled):
    times = np.linspace(0.0, 9.0, 300)
    with jax.enable_x64(True):
        want = sampled(joints(), times)
    found = plans.joints_at(joints(), times)
    for name in ("position", "velocity", "acceleration"):
        np.testing.assert_allclose(getattr(found, name), getattr(want, name), atol=1e-9)


def test_a_course_is_the_points_of_lines_and_more_of_what_is_bent():
    time, place = plans.trace_path(lines())
    np.testing.assert_array_equal(time, TIME_S[:6])
    np.testing.assert_array_equal(place, lines().position_m[:6])
    straight = plans.trace_path(joints([1] * 8))
    np.testing.assert_array_equal(straight[1], place)
    time, bent = plans.trace_path(joints())
    assert time.size == 1 + 5 * plans.PIECES
    np.testing.assert_allclose(bent[:: plans.PIECES], joints().position[:6, :3], atol=1e-12)
    # The first segment is a cubic: its second half from its ends, by hand.
    plan, half = joints(), bent[plans.PIECES // 2]
    (a, b), (u, v), span = plan.position[:2, :3], plan.velocity[:2, :3], 2.0
    np.testing.assert_allclose(half, 0.5 * (a + b) + span / 8 * (u - v), atol=1e-12)


def test_whether_there_is_a_plan_is_known_of_both_types():
    several = jax.tree.map(lambda leaf: np.stack([leaf] * 3), (lines(), joints()))
    found = np.array([True, False, True])
    assert plans.is_found(several[1]).tolist() == [True] * 3
    for plan in several:
        assert plans.is_found(replace(plan, found=found)).tolist() == found.tolist()
        np.testing.assert_array_equal(plans.points_m(plan)[1], joints().position[:, :3])


@pytest.mark.parametrize("plan", [lines(), joints()], ids=["way-points", "joints"])
def test_its_place_is_that_of_its_course(plan):
    time, place = plans.trace_path(plan)
    with jax.enable_x64(True):
        at = quickly(jax.vmap(plans.position_at, (None, 0)))(plan, jnp.asarray(time))
    np.testing.assert_allclose(at, place, atol=1e-12)


def test_controllers_that_cannot_fly_a_plan_say_so():
    for name in stages.CONTROLLERS:
        assert plans.check_plan(stages.find_controller(name), lines()).position_m.shape == (8, 3)
    plan = joints()
    assert plans.check_plan(stages.find_controller("cascade"), plan) is plan
    said = "World.path is a JointTrajectory: controller 'los' takes Trajectory"
    with pytest.raises(ConfigError, match=said):
        plans.check_plan(stages.find_controller("los"), plan)
    own, _ = stages.build_stack(["los", "velocity", "prioritized"], {})
    said = "the controller of stages 'los', 'velocity', 'prioritized' takes Trajectory"
    with pytest.raises(ConfigError, match=said):
        plans.check_plan(own, plan)
    arm = replace(plan, joints=("x", "y", "z", "elbow"))
    with pytest.raises(ConfigError, match=r"World.path: joints = .*'elbow'"):
        plans.check_plan(stages.find_controller("cascade"), arm)
