"""Trajectory files: what is written is read; every fault is named; nothing half-written stays."""

import copy
import json
import os

import pytest

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.report.interop import joint_trajectory_file as files
from angler_mjx.robot.control.commands.joint_goal import JointGoal, JointPoint

GOALS = {
    0: JointGoal(
        joint_names=("x", "y", "z", "yaw"),
        stamp_s=12.5,
        points=(
            JointPoint(time_s=0.0, positions=(1.0, 2.0, -3.0, 0.1)),
            JointPoint(
                time_s=4.123456789,
                positions=(1.5, 2.0, -3.0, -0.1),
                velocities=(0.1, 0.2, 0.3, 0.4),
                accelerations=(0.0, 0.0, 0.1, 1e-17),
            ),
        ),
    ),
    3: JointGoal(joint_names=("yaw",), points=(JointPoint(time_s=0.1, positions=(0.5,)),)),
}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "plan.json"


def test_what_is_written_is_read(path):
    files.write_trajectories(path, GOALS)
    assert files.read_trajectories(path, robots=4) == GOALS


def test_keys_are_those_of_ros(path):
    files.write_trajectories(path, GOALS)
    data = json.loads(path.read_text())
    one = data["robots"][0]["trajectory"]
    assert list(one) == ["header", "joint_names", "points"]
    assert one["header"] == {"stamp": {"sec": 12, "nanosec": 500000000}, "frame_id": ""}
    assert one["points"][1]["time_from_start"] == {"sec": 4, "nanosec": 123456789}
    keys = {"positions", "velocities", "accelerations", "effort", "time_from_start"}
    assert set(one["points"][1]) == keys


def test_what_ros_may_leave_out_may_be_left_out(path):
    point = {"positions": [1.0], "time_from_start": {"sec": 2}}
    trajectory = {"joint_names": ["x"], "points": [point]}
    path.write_text(
        json.dumps({"schema_version": 1, "robots": [{"robot": 1, "trajectory": trajectory}]})
    )
    goal = JointGoal(joint_names=("x",), points=(JointPoint(time_s=2.0, positions=(1.0,)),))
    assert files.read_trajectories(path) == {1: goal}


def changed(*where, value):
    def change(data):
        data = copy.deepcopy(data)
        *way, last = where
        place = data
        for key in way:
            place = place[key]
        if value is None:
            del place[last]
        else:
            place[last] = value
        return json.dumps(data)

    return change


POINT = ("robots", 0, "trajectory", "points", 1)
FAULTS = {
    "not JSON": (lambda data: "{", ["not valid JSON"]),
    "a list": (lambda data: "[]", ["must hold an object"]),
    "key twice": (lambda data: '{"a": 1, "a": 2}', ["'a'", "twice"]),
    "version": (changed("schema_version", value=2), ["schema_version = 2"]),
    "unknown key": (changed(*POINT, "speed", value=1), [".points[1].speed = 1", "unknown key"]),
    "missing": (changed(*POINT, "time_from_start", value=None), ["time_from_start: missing"]),
    "NaN": (changed(*POINT, "positions", 2, value=float("nan")), ["positions[2] = nan"]),
    "word": (changed(*POINT, "positions", 2, value="up"), ["positions[2] = 'up'"]),
    "nanoseconds": (
        changed(*POINT, "time_from_start", "nanosec", value=10**9),
        ["time_from_start.nanosec = 1000000000"],
    ),
    "effort": (changed(*POINT, "effort", value=[1.0]), ["points[1].effort"]),
    "length": (
        changed(*POINT, "velocities", value=[1.0]),
        ["robots[0].trajectory.points[1].velocities", "1 numbers for 4 joints"],
    ),
    "order": (
        changed(*POINT, "time_from_start", value={"sec": 0}),
        ["robots[0].trajectory.points[1].time_from_start = 0 s", "later than 0 s"],
    ),
    "robot twice": (changed("robots", 1, "robot", value=0), ["robots[1].robot = 0", "twice"]),
    "no such robot": (
        changed("robots", 1, "robot", value=4),
        ["robots[1].robot = 4", "0 to 3"],
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_fault_is_named(path, fault):
    change, words = FAULTS[fault]
    files.write_trajectories(path, GOALS)
    path.write_text(change(json.loads(path.read_text())))
    with pytest.raises(ConfigError) as caught:
        files.read_trajectories(path, robots=4)
    for word in [str(path), *words]:
        assert word in str(caught.value)


def test_all_faults_come_at_once(path):
    files.write_trajectories(path, GOALS)
    data = json.loads(path.read_text())
    data["robots"][0]["trajectory"]["points"][0]["positions"] = [1.0]
    data["robots"][1]["trajectory"]["points"] = []
    path.write_text(json.dumps(data))
    with pytest.raises(ConfigError, match="2 faults"):
        files.read_trajectories(path)


def test_missing_file_is_said(path):
    with pytest.raises(ConfigError, match="cannot be read"):
        files.read_trajectories(path)


def test_older_file_is_kept_unless_told(path):
    path.write_text("old")
    with pytest.raises(ConfigError, match="exists"):
        files.write_trajectories(path, GOALS)
    assert path.read_text() == "old"
    files.write_trajectories(path, GOALS, force=True)
    assert files.read_trajectories(path) == GOALS


def test_what_could_not_be_read_again_is_not_written(path):
    bad = JointGoal(joint_names=("x",), points=(JointPoint(time_s=1.0, positions=(1.0, 2.0)),))
    with pytest.raises(ConfigError, match=r"robot 5: points\[0\]"):
        files.write_trajectories(path, {5: bad})
    assert not path.exists()


def test_failed_writing_leaves_the_older_file_and_nothing_else(path, monkeypatch):
    files.write_trajectories(path, GOALS)
    before = path.read_bytes()

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", fail)
    monkeypatch.setattr(type(path), "replace", fail)
    with pytest.raises(RunError, match="No space left"):
        files.write_trajectories(path, {}, force=True)
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]
