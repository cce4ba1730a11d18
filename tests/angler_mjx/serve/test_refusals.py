"""Wrong, late, duplicate and missing messages: counted, and the scene goes on."""

import struct

import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.serve import serving
from angler_mjx.serve.serving import ServeSettings, parse_pace

from .memory_backend import HEADER, read_answer, served, trajectory_bytes, twist

TRAJECTORY = "/robot_0/joint_trajectory_controller/joint_trajectory"
THRUSTERS = "/robot_0/thruster_controller/commands"
NAMES = ("x", "y", "z", "yaw")
HERE = (-3.0, -2.0, -4.0, 0.0)


def signals(values):
    return HEADER + struct.pack(f"<4I{len(values)}d", 0, 0, len(values), 0, *values)


WRONG = {
    "a number that is none": ("/robot_0/cmd_vel", twist(np.nan)),
    "too fast": ("/robot_0/cmd_vel", twist(50.0)),
    "nothing": ("/robot_0/cmd_vel", b""),
    "half a message": ("/robot_0/cmd_vel", twist(0.1)[:20]),
    "other bytes": (TRAJECTORY, b"\xff" * 40),
    "a length beyond the message": (TRAJECTORY, HEADER + b"\xff" * 40),
    "an unknown joint": (TRAJECTORY, trajectory_bytes(("x", "knee"), [HERE[:2]], times=[1.0])),
    "a joint twice": (TRAJECTORY, trajectory_bytes(("x", "x"), [HERE[:2]], times=[1.0])),
    "a joint too many": (TRAJECTORY, trajectory_bytes(NAMES, [HERE[:3]], times=[1.0])),
    "roll": (TRAJECTORY, trajectory_bytes(("joint_x", "joint_rx"), [(0.0, 0.3)], times=[1.0])),
    "no points": (TRAJECTORY, trajectory_bytes(NAMES, [], times=[])),
    "times that fall": (TRAJECTORY, trajectory_bytes(NAMES, [HERE, HERE], times=[2.0, 1.0])),
    "no number": (TRAJECTORY, trajectory_bytes(NAMES, [(np.nan, *HERE[1:])], times=[1.0])),
    "three signals": (THRUSTERS, signals([1500.0] * 3)),
    "a signal beyond": (THRUSTERS, signals([2500.0] * 8)),
}


@pytest.fixture(scope="module")
def refused(session, scene):
    """Notes on robot 0 after each wrong message, which follows a good one."""
    notes = {}
    with served(session, scene) as door:
        backend = door.backend
        backend.receivers["/robot_0/cmd_vel"](twist(0.2))
        backend.step()
        for name, (topic, data) in WRONG.items():
            backend.receivers[topic](data)
            backend.receivers["/robot_1/cmd_vel"](twist(0.1))
            backend.step()
            notes[name] = backend.diagnostics()
    return notes, door


@pytest.mark.parametrize(("count", "name"), list(enumerate(WRONG, 1)))
def test_it_is_counted_and_the_last_command_goes_on(refused, count, name):
    note = refused[0][name]
    assert note["refused_messages"] == str(count)
    assert note["refusal"]
    assert (note["outcome"], note["command"], note["refused"]) == ("running", "BodyTwist", "")


def test_each_topic_is_reported_once_and_the_result_counts_all(refused):
    _, door = refused
    assert len(door.reports) == 3
    assert all(report.endswith("further refusals are counted") for report in door.reports)
    (result,) = door.results
    assert result.refused == len(WRONG)
    assert result.received == 2 * len(WRONG) + 1
    assert result.broken == ""


def test_a_silent_driver_stops_its_robot(session, scene):
    with served(session, scene, silence_s=0.2) as door:
        backend = door.backend
        for _ in range(20):
            backend.receivers["/robot_0/cmd_vel"](twist(0.3))
            backend.step()
        assert backend.read("/robot_0/odometry")[-1].twist.twist.linear.x > 0.2
        backend.step(5)
        assert backend.diagnostics()["stopped"] == "1"
        backend.step(40)
        assert abs(backend.read("/robot_0/odometry")[-1].twist.twist.linear.x) < 0.05
        assert backend.diagnostics()["stopped"] == "1"
        assert backend.diagnostics(1)["command"] == "plan"


def test_of_several_in_a_step_the_last_counts(session, scene):
    with served(session, scene) as door:
        for _ in range(20):
            for speed in (0.3, 0.3, -0.3):
                door.backend.receivers["/robot_0/cmd_vel"](twist(speed))
            door.backend.step()
        assert door.backend.read("/robot_0/odometry")[-1].twist.twist.linear.x < -0.2
        assert door.backend.diagnostics()["replaced"] == "40"


def test_a_trajectory_that_is_over_is_refused_and_one_of_the_future_waits(session, scene):
    with served(session, scene) as door:
        backend = door.backend
        backend.step(60)  # 3 s
        p = backend.read("/robot_0/odometry")[-1].pose.pose.position
        there = (p.x, p.y, p.z, 0.0)
        backend.receivers[TRAJECTORY](trajectory_bytes(NAMES, [there], times=[0.5], stamp_s=1.0))
        backend.step()
        assert "OLD_HEADER_TIMESTAMP" in backend.diagnostics()["refusal"]
        backend.receivers[TRAJECTORY](trajectory_bytes(NAMES, [there], times=[2.0], stamp_s=4.0))
        backend.step()
        assert "begins at 4 s" in backend.diagnostics()["note"]
        backend.step(25)
        assert backend.diagnostics()["command"] == "JointTrajectory"


def test_a_running_scene_pauses_and_steps_only_then(session, scene):
    with served(session, scene, pace="max") as door:
        backend = door.backend
        success, text = read_answer(backend.call("/step"))
        assert not success
        assert "pause" in text
        assert read_answer(backend.call("/pause", HEADER + b"\x01")) == (True, "paused")
        count = len(backend.sent["/clock"])
        success, _ = read_answer(backend.call("/step"))
        assert success
        assert len(backend.sent["/clock"]) == count + 1
        assert not read_answer(backend.call("/pause", b"\x00"))[0]
        assert read_answer(backend.call("/pause", HEADER + b"\x00")) == (True, "running")


def test_topics_without_listeners_are_not_made(session, scene):
    with served(session, scene) as door:
        door.backend.wanted = {"/clock"}
        before = {name: len(sent) for name, sent in door.backend.sent.items()}
        door.backend.step(2)
        more = {name for name, sent in door.backend.sent.items() if len(sent) > before[name]}
    assert more == {"/clock"}


def test_a_duration_ends_it(session, scene):
    with served(session, scene, pace="max", duration_s=1.0) as door:
        door.thread.join(60)
        (result,) = door.results
    assert (result.steps, result.scene_s) == (20, pytest.approx(1.0))


def test_pace_is_a_word_or_a_number():
    assert [parse_pace(word) for word in ("real", "max", "step", "2.5")] == [
        1.0,
        "max",
        "step",
        2.5,
    ]
    for word in ("fast", "0", "-1", "nan", "inf"):
        with pytest.raises(ConfigError, match="--pace"):
            parse_pace(word)
    with pytest.raises(ConfigError, match="--silence"):
        ServeSettings(silence_s=0.0)


@pytest.mark.parametrize("world", [0, 40, 2**31 - 1])
def test_a_world_is_an_index_of_31_bits(world):
    assert ServeSettings(world=world).world == world


@pytest.mark.parametrize("world", [-1, 2**31])
def test_another_world_is_refused(world):
    with pytest.raises(ConfigError, match=f"--world {world}"):
        ServeSettings(world=world)


def test_a_transport_that_does_not_open_costs_no_compilation(scene, tmp_path):
    def broken():
        raise ConfigError("the port is in use")

    def opener(*_):
        raise AssertionError("the session was opened")

    with pytest.raises(ConfigError, match="in use"):
        serving.serve_session(scene, ServeSettings(), [broken], print, opener)


def test_logs_of_vehicles_are_in_the_run_folder_where_there_is_one(scene, tmp_path):
    logs = []

    def opener(_, world, folder, report):
        logs.append(folder)
        raise ConfigError(f"world {world} is not opened")

    for out in (None, tmp_path / "run"):
        with pytest.raises(ConfigError, match="world 2 is not opened"):
            serving.serve_session(scene, ServeSettings(out=out, world=2), [], print, opener)
    assert logs[0] is None
    assert logs[1].name == "robots"
    assert logs[1].parent.parent == tmp_path
