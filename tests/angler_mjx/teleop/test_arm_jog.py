"""Keys of joints: targets, limits, what they do beside the base, and how the screen shows them."""

from dataclasses import replace

import numpy as np
import pytest

from angler_mjx.robot.control.commands import BodyTwist
from angler_mjx.robot.control.commands.whole_body import JointTarget, WholeBodyCommand
from angler_mjx.robot.vehicles import library
from angler_mjx.robot.vehicles.link_motion import JointMotion
from angler_mjx.teleop.arm_jog import ARM_KEYS, STEPS, ArmJog
from angler_mjx.teleop.keys import ACTIONS, FACTORS, HELP, MOVES
from angler_mjx.teleop.pilot import DriveMode, TeleopPilot
from angler_mjx.teleop.status import WIDTH, format_screen

from .by_hand import observed, robot_info

JOINTS = library.load_vehicle("bluerov2_heavy_alpha5").find_joints()
HOME = np.array([joint.home for joint in JOINTS])
STEP = np.array([joint.upper - joint.lower for joint in JOINTS]) / STEPS
GRIPPER = next(i for i, joint in enumerate(JOINTS) if joint.is_gripper)


@pytest.fixture
def robots():
    arm = robot_info(0)
    accepts = (*arm.accepts, JointTarget, WholeBodyCommand)
    names = tuple(joint.name for joint in JOINTS)
    vehicle = "bluerov2_heavy_alpha5"
    return [replace(arm, vehicle=vehicle, accepts=accepts, joints=names), robot_info(1)]


@pytest.fixture
def pilot(robots):
    return TeleopPilot(robots, (0, 1), speed_mps=0.5, turn_radps=0.4)


def seen(position=HOME, time_s=0.0):
    rows = np.array([position, np.full(len(JOINTS), np.nan)])
    scene = observed(time_s=time_s, robots=2)
    joints = JointMotion(position=rows, velocity=0.0 * rows)
    return replace(scene, estimate=replace(scene.estimate, joints=joints))


def test_keys_of_arms_are_no_other_keys():
    assert not set(ARM_KEYS) & {*MOVES, *FACTORS, *ACTIONS}
    assert any("joint of an arm" in line for line in HELP)


def test_a_key_moves_the_chosen_joint_and_leaves_the_plan(pilot):
    for key in "2]":
        pilot.press(key, 0.0)
    commands = pilot.build_commands(seen()).commands
    assert set(commands) == {0}
    assert isinstance(commands[0], JointTarget)
    wanted = HOME + STEP * np.eye(len(JOINTS))[1]
    np.testing.assert_allclose(commands[0].position, wanted, atol=1e-6)
    assert pilot.mode(0) is DriveMode.PLAN
    assert pilot.build_commands(seen()).commands == {}


def test_joints_move_beside_a_twist(pilot):
    for key in "ig":
        pilot.press(key, 0.0)
    command = pilot.build_commands(seen()).commands[0]
    assert isinstance(command, WholeBodyCommand)
    assert isinstance(command.base, BodyTwist)
    moved = np.flatnonzero(np.abs(np.asarray(command.joints.position) - HOME) > 1e-6)
    assert moved.tolist() == [GRIPPER]


def test_a_target_leads_little_and_keeps_to_limits():
    arm = ArmJog(JOINTS)
    for _ in range(10 * STEPS):
        arm.press("[")
    first = np.asarray(arm.take_target(HOME).position)
    assert HOME[0] - first[0] <= max(0.5 * JOINTS[0].actuator.max_speed, STEP[0]) + 1e-6
    low = np.array([joint.lower for joint in JOINTS])
    arm.press("[")
    np.testing.assert_allclose(np.asarray(arm.take_target(low).position)[0], low[0], atol=1e-6)


def test_a_joint_that_the_arm_lacks_is_not_chosen():
    arm = ArmJog(JOINTS)
    arm.press("9")
    assert arm.joint == 0
    assert arm.take_target(HOME) is None


def test_on_a_robot_without_an_arm_they_stop(pilot):
    for key in "\ti]":
        pilot.press(key, 0.0)
    assert pilot.mode(1) is DriveMode.STOPPING


def test_the_screen_shows_the_joints_and_the_chosen_one(robots, pilot):
    pilot.press("3", 0.0)
    lines = format_screen("arms", robots, seen(), pilot, None)
    (line,) = [line for line in lines if "axis_e" in line]
    assert line.startswith("robot_0: axis_e 3.14")
    assert f"[axis_c {HOME[2]:.2f}]" in line
    assert "mm" in " ".join(lines)
    assert max(map(len, lines)) <= WIDTH
