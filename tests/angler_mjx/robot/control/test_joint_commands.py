"""Commands to joints through a stack: alone, in trajectories, mixed, beyond limits."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import quaternion
from angler_mjx.errors import ConfigError
from angler_mjx.robot.control import allocation, mixed, plans, stack, stages
from angler_mjx.robot.control.commands import BodyTwist, Estimate, PoseTarget
from angler_mjx.robot.control.commands.joint_trajectory import (
    LINEAR,
    VEHICLE_JOINTS,
    JointTrajectory,
)
from angler_mjx.robot.control.commands.whole_body import JointTarget, WholeBodyCommand
from angler_mjx.robot.control.mixed import MixedCommand
from angler_mjx.robot.control.stack import ControlParams
from angler_mjx.robot.vehicles import library, params
from angler_mjx.robot.vehicles.link_motion import JointMotion

WATER = (0.05, 1000.0, 9.81)
TWIST = BodyTwist(nu=jnp.array([0.2, 0.0, 0.1, 0.0, 0.0, 0.1]))
TARGET = JointTarget(
    position=jnp.array([3.0, 0.5, 1.5, 0.2, 0.01]),
    velocity=jnp.array([0.1, -0.1, 0.2, 0.0, 0.0]),
    acceleration=jnp.zeros(5),
)


@pytest.fixture(scope="module")
def armed():
    vehicle = params.build_vehicle(library.load_vehicle("bluerov2_heavy_alpha5"), "wu2018", 14.8)
    stacked = allocation.build_allocation(jax.tree.map(lambda leaf: leaf[None], vehicle))
    known = ControlParams(
        vehicle=vehicle,
        allocation=jax.tree.map(lambda leaf: leaf[0], stacked),
        cruise_speed_mps=jnp.array(0.5),
    )
    joints = JointMotion(position=vehicle.links.home, velocity=jnp.zeros(5))
    at = Estimate(
        p=jnp.array([0.0, 0.0, -5.0]),
        q=jnp.array([1.0, 0.0, 0.0, 0.0]),
        nu=jnp.zeros(6),
        joints=joints,
    )
    return known, at


def run(armed, command, name="cascade", memory=None, step=stack.step):
    known, at = armed
    made, gains = stages.build_stack(stages.CONTROLLERS[name], {})
    memory = memory or stack.reset(made, at, quaternion.yaw(at.q))
    return step(made, gains, known, memory, at, command, *WATER)


def trajectory(joints=("axis_e", "axis_d", "axis_c", "axis_b", "axis_a")):
    position = np.zeros((3, 4 + len(joints)), np.float32)
    position[:, 2] = -5.0
    position[:, 4:] = np.array([[3.0, 0.1, 1.5, 0.0, 0.0]] * 3)[:, : len(joints)]
    position[1:, 5:6] = 0.3
    return JointTrajectory(
        joints=VEHICLE_JOINTS + joints,
        time_s=jnp.array([0.0, 1.0, 2.0]),
        position=jnp.asarray(position),
        velocity=jnp.zeros(position.shape),
        acceleration=jnp.zeros(position.shape),
        degree=jnp.full(3, LINEAR, jnp.int32),
        commanded=jnp.ones(position.shape[1], bool),
    )


def same(a, b):
    leaves = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return all(np.array_equal(x, y) for x, y in leaves)


def test_joints_hold_where_they_are_until_commanded(armed):
    action = run(armed, TWIST)
    np.testing.assert_array_equal(action.memory.joints.position, armed[1].joints.position)
    np.testing.assert_array_equal(action.memory.joints.velocity, 0.0)
    assert int(action.memory.joints_clipped) == 0


def test_joints_are_commanded_beside_the_base_and_keep_to_it(armed):
    both = run(armed, WholeBodyCommand(base=TWIST, joints=TARGET))
    assert same(both.memory.joints, TARGET)
    np.testing.assert_array_equal(both.pwm.pwm_us, run(armed, TWIST).pwm.pwm_us)
    after = run(armed, TWIST, memory=both.memory).memory.joints
    np.testing.assert_array_equal(after.position, TARGET.position)
    np.testing.assert_array_equal(after.velocity, 0.0)


def test_a_command_beyond_the_limits_is_clipped_and_counted(armed):
    links = armed[0].vehicle.links
    wild = JointTarget(
        position=TARGET.position.at[1].set(99.0),
        velocity=TARGET.velocity.at[2].set(-9.0),
        acceleration=jnp.ones(5),
    )
    action = run(armed, WholeBodyCommand(base=TWIST, joints=wild))
    commanded = action.memory.joints
    assert commanded.position[1] == links.upper[1]
    assert commanded.velocity[1] == 0.0
    assert commanded.velocity[2] == -links.max_speed[2]
    np.testing.assert_array_equal(commanded.acceleration, [1.0, 0.0, 0.0, 1.0, 1.0])
    assert int(action.memory.joints_clipped) == 1
    again = run(armed, WholeBodyCommand(base=TWIST, joints=wild), memory=action.memory)
    assert int(again.memory.joints_clipped) == 2
    assert int(run(armed, TWIST, memory=again.memory).memory.joints_clipped) == 2


def test_a_trajectory_moves_base_and_joints_by_one_clock(armed):
    action = run(armed, trajectory())
    made, _ = stages.build_stack(stages.CONTROLLERS["cascade"], {})
    for _ in range(9):
        action = run(armed, trajectory(), memory=action.memory)
    clock = float(stack.progress_s(made, action.memory, trajectory())) - 0.05
    np.testing.assert_allclose(clock, 0.45, atol=1e-6)
    commanded = action.memory.joints
    np.testing.assert_allclose(
        commanded.position, [3.0, 0.1 + 0.2 * clock, 1.5, 0.0, 0.0], atol=1e-6
    )
    np.testing.assert_allclose(commanded.velocity, [0.0, 0.2, 0.0, 0.0, 0.0], atol=1e-6)


def test_the_joints_wait_with_the_clock_for_a_base_that_is_behind(armed):
    known, at = armed
    behind = (known, replace(at, p=at.p + jnp.array([0.7, 0.0, 0.0])))
    action = run(behind, trajectory())
    np.testing.assert_allclose(action.memory.joints.velocity[1], 0.5 * 0.2, atol=1e-5)


def test_a_trajectory_of_the_vehicle_alone_leaves_the_joints(armed):
    commanded = run(armed, WholeBodyCommand(base=TWIST, joints=TARGET)).memory
    after = run(armed, trajectory(joints=()), memory=commanded).memory.joints
    np.testing.assert_array_equal(after.position, TARGET.position)


def test_plans_have_all_joints_or_none(armed):
    cascade = stages.find_controller("cascade")
    names = params.joint_names(armed[0].vehicle)
    assert plans.check_plan(cascade, trajectory(), names).joints[4:] == names
    plans.check_plan(cascade, trajectory(joints=()), names)
    with pytest.raises(ConfigError, match=r"joints = .*'axis_e', 'axis_d'\): must be .* or "):
        plans.check_plan(cascade, trajectory(joints=("axis_e", "axis_d")), names)
    with pytest.raises(ConfigError, match=r"must be \('x', 'y', 'z', 'yaw'\)$"):
        plans.check_plan(cascade, trajectory())


@pytest.mark.parametrize("which", [0, 1, 2])
def test_a_mixed_command_does_what_the_chosen_one_does_alone(armed, which):
    pose = PoseTarget(
        position_m=jnp.array([1.0, 0.0, -5.0]), velocity_mps=jnp.zeros(3), yaw_rad=jnp.array(0.3)
    )
    commands = (trajectory(), WholeBodyCommand(base=TWIST, joints=TARGET), pose)
    of_all = MixedCommand(which=jnp.array(which), fresh=jnp.array(0), commands=commands)
    alone = run(armed, commands[which], "arm")
    together = run(armed, of_all, "arm", step=mixed.step)
    np.testing.assert_allclose(together.pwm.pwm_us, alone.pwm.pwm_us, atol=1e-3)
    for a, b in zip(
        jax.tree.leaves(together.memory.joints), jax.tree.leaves(alone.memory.joints), strict=True
    ):
        np.testing.assert_allclose(a, b, atol=1e-6)


def test_a_rigid_vehicle_takes_the_base_of_a_command(robot):
    made, gains = stages.build_stack(stages.CONTROLLERS["arm"], {})
    known, at = robot
    memory = stack.reset(made, at, quaternion.yaw(at.q))
    actions = [
        stack.step(made, gains, known, memory, at, command, *WATER)
        for command in (TWIST, WholeBodyCommand(base=TWIST, joints=TARGET))
    ]
    np.testing.assert_array_equal(actions[0].pwm.pwm_us, actions[1].pwm.pwm_us)
    assert actions[1].memory.joints is None
    assert actions[1].memory.joints_clipped is None


def test_arrays_of_a_whole_body_command_are_checked(armed):
    made = stages.find_controller("arm")
    command = jax.tree.map(
        lambda leaf: jnp.broadcast_to(leaf, (2, 1, *leaf.shape)),
        WholeBodyCommand(base=TWIST, joints=TARGET),
    )
    stack.check_command(made, command, (2, 1), 8, joints=5)
    with pytest.raises(ConfigError, match=r"JointTarget: position has the shape \[2, 1, 5\]"):
        stack.check_command(made, command, (2, 1), 8, joints=4)
    wrong = replace(command, base=BodyTwist(nu=jnp.zeros((2, 1, 5))))
    with pytest.raises(ConfigError, match=r"command BodyTwist: nu has the shape \[2, 1, 5\]"):
        stack.check_command(made, wrong, (2, 1), 8)
