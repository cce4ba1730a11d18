"""Stepped by a client, a door gives an ordinary session its commands, and its messages are true."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from angler_mjx.robot.control.commands import BodyTwist
from angler_mjx.runs.session.batch_session import BatchSession

from .memory_backend import read_answer, served, set_parameter, trajectory_bytes, twist

COMMANDS = {3: (0, (0.3, 0.1)), 5: (1, (0.2, 0.0, -0.1, 0.0, 0.0, 0.2)), 8: (0, (0.0, 0.0, 0.1))}
"""Robot and velocity by step."""
STEPS = 14


def fly_door(session, scene):
    with served(session, scene) as door:
        for step in range(STEPS):
            if step in COMMANDS:
                robot, nu = COMMANDS[step]
                door.backend.receivers[f"/robot_{robot}/cmd_vel"](twist(*nu))
            door.backend.step()
    return door.backend


@pytest.fixture(scope="module")
def flown(session, scene):
    return fly_door(session, scene)


@pytest.fixture(scope="module")
def expected(scene):
    """The same commands to a session of its own, without a door."""
    session = BatchSession(scene)
    seen = [session.reset()]
    for step in range(STEPS):
        command = {}
        if step in COMMANDS:
            robot, nu = COMMANDS[step]
            command = {robot: BodyTwist(nu=np.array([*nu, *[0.0] * (6 - len(nu))]))}
        seen.append(session.step(command))
    return session, seen


@pytest.mark.parametrize("robot", [0, 1])
@pytest.mark.parametrize("topic", ["odometry", "local_position/odom"])
def test_odometry_is_the_session_to_the_last_bit(flown, expected, robot, topic):
    messages = flown.read(f"/robot_{robot}/{topic}")
    assert len(messages) == STEPS + 1
    for message, seen in zip(messages, expected[1], strict=True):
        p, q = message.pose.pose.position, message.pose.pose.orientation
        v, r = message.twist.twist.linear, message.twist.twist.angular
        assert [p.x, p.y, p.z] == seen.truth.p[robot].tolist()
        assert [q.w, q.x, q.y, q.z] == seen.truth.q[robot].tolist()
        assert [v.x, v.y, v.z, r.x, r.y, r.z] == seen.truth.nu[robot].tolist()
        assert message.header.frame_id == "map"
        assert message.child_frame_id == f"robot_{robot}/base_link"
    assert np.ptp([message.pose.pose.position.x for message in messages]) > 0.01


def test_a_second_time_every_byte_is_the_same(flown, session, scene):
    assert dict(fly_door(session, scene).sent) == dict(flown.sent)


def test_clock_and_frames_go_with_the_steps(flown, expected):
    times = [message.clock.sec + 1e-9 * message.clock.nanosec for message in flown.read("/clock")]
    np.testing.assert_allclose(times, [seen.time_s for seen in expected[1]], atol=1e-9)
    for message, seen in zip(flown.read("/tf"), expected[1], strict=True):
        for i, frame in enumerate(message.transforms):
            shift = frame.transform.translation
            assert [shift.x, shift.y, shift.z] == seen.truth.p[i].tolist()
            assert (frame.header.frame_id, frame.child_frame_id) == ("map", f"robot_{i}/base_link")


def test_instruments_show_the_motion(flown, expected):
    seen = expected[1]
    imu = flown.read("/robot_0/imu/data")
    assert len(imu) == STEPS  # none at the reset, which has no past
    force = imu[1].linear_acceleration
    for k, message in enumerate(imu):
        before, after = expected[1][k].truth, expected[1][k + 1].truth
        turns = [Rotation.from_quat(x.q[0], scalar_first=True) for x in (before, after)]
        v = [turn.apply(x.nu[0, :3]) for turn, x in zip(turns, (before, after), strict=True)]
        force = turns[1].inv().apply((v[1] - v[0]) / 0.05 + [0.0, 0.0, 9.81])
        found = message.linear_acceleration
        np.testing.assert_allclose([found.x, found.y, found.z], force, atol=0.1)
    pressure = flown.read("/robot_1/imu/static_pressure")[0].fluid_pressure
    assert pressure == pytest.approx(101_325 + 1000.0 * 9.81 * 5.0, rel=2e-3)
    twists = flown.read("/robot_0/dvl/twist")
    assert len(twists) == 1 + STEPS // 4  # 5 Hz of 20
    last = twists[-1].twist.twist.linear
    at = seen[4 * (STEPS // 4)].truth.nu[0]
    np.testing.assert_allclose([last.x, last.y, last.z], at[:3], atol=0.05)


def test_the_water_the_joints_and_the_signals(flown, expected):
    water = flown.read("/robot_0/current")[-1].vector
    np.testing.assert_allclose([water.x, water.y, water.z], [0.05, -0.1, 0.0], atol=1e-6)
    seen = expected[1][-1]
    joints = flown.read("/robot_1/joint_states")[-1]
    assert joints.name == ["x", "y", "z", "yaw"]
    np.testing.assert_array_equal(joints.position[:3], seen.truth.p[1])
    signals = flown.read("/robot_1/thruster_pwm_us")[-1].data
    np.testing.assert_array_equal(signals, np.rint(seen.pwm.pwm_us[1]))
    battery = flown.read("/robot_1/battery")[-1]
    assert battery.voltage == 16.0
    assert battery.current < 0.0
    clearance = flown.read("/robot_1/clearance")[-1].range
    assert clearance == pytest.approx(float(seen.clearance_m[1]), rel=1e-6)


def test_what_is_sent_once_is_there(flown):
    goal = flown.read("/robot_1/goal")[0].pose.position
    assert (goal.x, goal.y, goal.z) == (9.0, 2.0, -5.0)
    plan = flown.read("/robot_0/plan")[0].poses
    assert plan[0].pose.position.x == pytest.approx(-3.0)
    assert plan[-1].pose.position.x == pytest.approx(9.0)
    assert flown.read("/scenery")[0].markers


def test_a_reset_brings_the_start_and_a_new_seed_brings_another_world(session, scene):
    with served(session, scene) as door:
        backend = door.backend
        backend.step(3)
        assert read_answer(backend.call("/reset")) == (True, "seed 3")
        first, again = (backend.read("/clock")[i].clock for i in (0, -1))
        assert first == again
        assert backend.sent["/robot_0/odometry"][-1] == backend.sent["/robot_0/odometry"][0]
        data = backend.call("/angler/set_parameters", set_parameter("seed", 2, 8))
        assert data[8] == 1  # of the sequence, the first is successful
        assert read_answer(backend.call("/reset")) == (True, "seed 8")
        for name, kind, value in (("sed", 2, 8), ("seed", 1, 8), ("seed", 2, -1)):
            data = backend.call("/angler/set_parameters", set_parameter(name, kind, value))
            assert data[8] == 0
        assert read_answer(backend.call("/reset")) == (True, "seed 8")


def test_names_of_blue_in_any_order_move_the_robot_alike(session, scene):
    """A trajectory by the names of sessions, and by those of Blue in another order."""
    target, sent = (-2.5, -2.0, -4.0, 0.3), []
    for names, row in (
        (("x", "y", "z", "yaw"), target),
        (
            ("joint_rz", "joint_ry", "joint_z", "joint_rx", "joint_x", "joint_y"),
            (target[3], 0.0, target[2], 0.0, target[0], target[1]),
        ),
    ):
        with served(session, scene) as door:
            topic = "/robot_0/joint_trajectory_controller/joint_trajectory"
            door.backend.receivers[topic](trajectory_bytes(names, [row], times=[2.0]))
            door.backend.step(10)
            assert door.backend.diagnostics()["command"] == "JointTrajectory"
            sent.append(door.backend.sent["/robot_0/odometry"])
    assert sent[0] == sent[1]
