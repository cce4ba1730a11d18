"""What is recorded of the joints of arms, by runs and by sessions."""

import json
import shutil

import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.learning import datasets
from angler_mjx.robot.vehicles import library
from angler_mjx.runs.session.batch_session import BatchSession
from angler_mjx.runs.session.recording import RecordedCourse, SessionRecording
from angler_mjx.runs.storage.folder import Run
from angler_mjx.runs.storage.recorder import TrajectoryShape

from ..armed import ARM, LIMP, RIGID

JOINTS = ("axis_e", "axis_d", "axis_c", "axis_b", "axis_a")
UNITS = {"joint_position": ["rad"] * 4 + ["m"], "joint_velocity": ["rad/s"] * 4 + ["m/s"]}


@pytest.mark.parametrize("name", UNITS)
def test_arrays_name_their_joints(armed_run, name):
    for array in (armed_run.trajectories[name], armed_run.trajectories[f"end/{name}"]):
        assert array.metadata.dimension_names[-2:] == ("robot", "vehicle_joint")
        labels = [
            {"name": joint, "unit": unit} for joint, unit in zip(JOINTS, UNITS[name], strict=True)
        ]
        assert array.attrs["joints"] == {"bluerov2_heavy_alpha5": labels, "limp": labels}


def test_joints_are_recorded_of_robots_that_have_any(armed_run):
    stored = armed_run.trajectories
    position, velocity = (np.asarray(stored[name]) for name in UNITS)
    flown = np.isfinite(np.asarray(stored["p_m"])).all(axis=-1)
    for robot in (ARM, LIMP):
        np.testing.assert_array_equal(np.isfinite(position[:, :, robot]).all(-1), flown[..., robot])
    assert np.isnan(position[:, :, RIGID]).all()
    assert np.isnan(velocity[:, :, RIGID]).all()
    home = [joint.home for joint in library.load_vehicle("bluerov2_heavy_alpha5").find_joints()]
    np.testing.assert_allclose(position[0, 0, ARM], home, rtol=1e-6)
    # The servos hold the arm; where they are off it falls.
    assert np.nanmax(np.abs(position[0, :, ARM] - home)) < 0.05
    assert np.nanmin(position[0, :, LIMP, 1]) < 0.6


def test_speeds_are_those_of_the_positions(armed_run):
    stored = armed_run.trajectories
    falling = slice(2, 12)
    time = np.asarray(stored["time_s"])[falling]
    position, velocity = (np.asarray(stored[name])[0, falling, LIMP, 1] for name in UNITS)
    travelled = np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * np.diff(time))
    np.testing.assert_allclose(position[1:] - position[0], travelled, rtol=1e-2)


def test_the_last_state_is_kept(armed_run):
    stored = armed_run.trajectories
    last = np.asarray(stored["end/joint_position"])
    before = np.asarray(stored["joint_position"])
    for world in range(2):
        final = before[world, int(stored["end/step"][world]) - 1]
        np.testing.assert_allclose(last[world], final, atol=0.05)
        assert not np.array_equal(last[world, LIMP], final[LIMP])
    assert np.isnan(last[:, RIGID]).all()


def test_a_run_without_one_of_its_arrays_is_refused(armed_run, tmp_path):
    damaged = shutil.copytree(armed_run.path, tmp_path / "damaged")
    shutil.rmtree(damaged / "trajectories.zarr" / "joint_velocity")
    with pytest.raises(ConfigError, match=r"trajectories.zarr/joint_velocity: is missing"):
        _ = Run(damaged).trajectories


def test_arrays_of_other_joints_than_the_fleet_has_are_refused(armed_run, tmp_path):
    damaged = shutil.copytree(armed_run.path, tmp_path / "damaged")
    described = damaged / "trajectories.zarr" / "joint_position" / "zarr.json"
    about = json.loads(described.read_text())
    about["shape"][-1] = 4
    described.write_text(json.dumps(about))
    with pytest.raises(ConfigError, match=r"trajectories.zarr/joint_position: is described as"):
        _ = Run(damaged).trajectories


def test_a_session_records_its_joints(armed_scenario, tmp_path):
    session = BatchSession(armed_scenario)
    with SessionRecording(tmp_path / "out", armed_scenario, 0) as recording:
        recording.begin(session)
        for _ in range(20):
            recording.after(session.step())
        recording.close(RecordedCourse(steps=20, wall_s=1.0, compile_s=1.0, more={}))
    stored = Run(tmp_path / "out").trajectories
    position = np.asarray(stored["joint_position"])[0]
    assert position.shape == (20, 3, 5)
    assert position[0, LIMP, 1] - position[-1, LIMP, 1] > 0.05
    assert np.isnan(position[:, RIGID]).all()
    assert list(stored["joint_position"].attrs["joints"]) == ["bluerov2_heavy_alpha5", "limp"]


def test_fleets_without_arms_have_no_such_array():
    sizes = dict(worlds=2, samples=5, robots=2, thrusters=8, obstacles=3, plan_points=4)
    assert not [name for name in TrajectoryShape(**sizes).names() if "joint" in name]


def test_datasets_read_joints_by_their_names(armed_run):
    data = datasets.open(armed_run.path, fields=("p_m", "joint_position"))
    episode = data.episode(0)
    recorded = np.asarray(armed_run.trajectories["joint_position"])[0]
    np.testing.assert_array_equal(episode.arrays["joint_position"], recorded[: len(episode.time_s)])
    mean, std = data.statistics()["joint_position"]
    assert np.isfinite(mean).all()
    assert std[1] > 0.1
