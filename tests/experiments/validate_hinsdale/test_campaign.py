"""Recordings are read by name, and what is wrong with them is one message."""

import numpy as np
import pytest

from angler_experiments.validate_hinsdale.campaign import SOURCE, read_campaign
from angler_experiments.validate_hinsdale.split import training_stems
from angler_mjx.errors import ConfigError

from . import recordings


def test_columns_are_found_by_name_and_quaternions_turned(tmp_path):
    mocap = recordings.poses()
    recordings.write_run(tmp_path, "traj001-0", mocap)
    order = [3, 0, 7, 1, 2, 6, 5, 4]
    columns = [recordings.POSE[i] for i in order]
    recordings.write_table(tmp_path / "traj001-0_mocap.csv", columns, mocap[:, order])
    (run,) = read_campaign(tmp_path)
    np.testing.assert_allclose(run.mocap.p_m, mocap[:, 1:4])
    np.testing.assert_allclose(run.mocap.q, mocap[:, [7, 4, 5, 6]])
    np.testing.assert_allclose(run.joints.position_rad[0], recordings.FOLDED[[4, 3, 2, 1]])
    assert run.start_s == 2.0


def test_blank_rows_and_repeated_times_are_left_out_and_counted(tmp_path):
    mocap = recordings.poses()
    mocap[10, 4] = np.nan
    mocap[20, 0] = mocap[19, 0]
    recordings.write_run(tmp_path, "traj001-0", mocap, start_s=None)
    (run,) = read_campaign(tmp_path)
    assert (run.mocap.blank_rows, run.mocap.repeated_rows) == (1, 1)
    assert len(run.mocap.t_s) == len(mocap) - 2
    assert np.all(np.diff(run.mocap.t_s) > 0)
    assert run.start_s is None


def test_a_recording_under_two_names_is_one_run(tmp_path):
    mocap = recordings.poses()
    recordings.write_run(tmp_path, "traj001-1", mocap)
    recordings.write_run(tmp_path, "traj001-0-test", mocap)
    recordings.write_run(tmp_path, "traj001-0", recordings.poses(rise_mps=0.03))
    t = np.arange(-1.0, 9.0, 0.02)[:, None]
    joints = np.hstack([t, np.tile(recordings.FOLDED, (500, 1)), np.zeros((500, 5))])
    path = tmp_path / "traj001-0-test_joint_states.csv"
    recordings.write_table(path, recordings.JOINTS, joints)
    copies = {run.stem: run.copy_of for run in read_campaign(tmp_path)}
    assert copies == {"traj001-0": None, "traj001-1": None, "traj001-0-test": "traj001-1"}


def _refuse(folder, *texts):
    with pytest.raises(ConfigError) as error:
        read_campaign(folder)
    assert SOURCE in str(error.value)
    for text in texts:
        assert text in str(error.value)


def test_a_missing_folder_names_the_source(tmp_path):
    _refuse(tmp_path / "nowhere", "nowhere")


def test_an_empty_folder_names_the_source(tmp_path):
    _refuse(tmp_path, "*_mocap.csv")


@pytest.mark.parametrize("suffix", ["mocap", "imu", "joint_states"])
def test_half_a_run_names_the_missing_file(tmp_path, suffix):
    recordings.write_run(tmp_path, "traj001-0")
    (tmp_path / f"traj001-0_{suffix}.csv").unlink()
    _refuse(tmp_path, f"traj001-0_{suffix}.csv")


def _change(folder, suffix, change):
    path = folder / f"traj001-0_{suffix}.csv"
    path.write_text(change(path.read_text()))


@pytest.mark.parametrize(
    ("suffix", "old", "new", "column"),
    [
        ("mocap", "z_pose", "height", "z_pose"),
        ("joint_states", "axis_d_pos", "axis_d_degrees", "axis_d_pos"),
        ("imu", "w_ori", "w", "w_ori"),
        ("mocap", "\n0.01,", "\nsoon,", "time_secs"),
        ("mocap", "\n0.01,", "\nnan,", "time_secs"),
        ("joint_states", "1.61", "92.2", "axis_b_pos"),
        ("mocap", "\n7.99,", "\n79900.0,", "time_secs"),
    ],
)
def test_a_wrong_column_or_unit_names_file_and_column(tmp_path, suffix, old, new, column):
    recordings.write_run(tmp_path, "traj001-0")
    _change(tmp_path, suffix, lambda text: text.replace(old, new))
    _refuse(tmp_path, f"traj001-0_{suffix}.csv", column)


def test_quaternions_are_of_length_one(tmp_path):
    mocap = recordings.poses()
    mocap[5, 4:] *= 2.0
    recordings.write_run(tmp_path, "traj001-0", mocap)
    _refuse(tmp_path, "traj001-0_mocap.csv", "length 2")


def test_metadata_without_a_start_is_refused(tmp_path):
    recordings.write_run(tmp_path, "traj001-0")
    (tmp_path / "metadata_001-0.yml").write_text("begin: 3\n")
    _refuse(tmp_path, "metadata_001-0.yml", "start_time")


def test_runs_of_one_trajectory_are_in_one_half():
    stems = ["traj003-0", "traj003-1", "traj004-0", "traj_alt_001-0", "traj_alt_001-2", "baseline1"]
    assert training_stems(stems) == ["traj003-0", "traj003-1", "traj_alt_001-0", "traj_alt_001-2"]


def test_the_campaign_is_read():
    runs = read_campaign(recordings.real_folder())
    assert len(runs) == 41
    copies = {run.stem: run.copy_of for run in runs if run.copy_of}
    assert copies == {"traj003-0-test": "traj003-1"}
    assert sum(run.start_s is None for run in runs) == 2
    assert sum(run.mocap.blank_rows for run in runs) == 1
