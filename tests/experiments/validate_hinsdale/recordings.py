"""Small recordings in the campaign's format, and the folder of the real ones."""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

SETTING = "ANGLER_HINSDALE"
POSE = ("time_secs", "x_pose", "y_pose", "z_pose", "x_ori", "y_ori", "z_ori", "w_ori")
RATES = ("x_angvel", "y_angvel", "z_angvel")
LETTERS = "abcde"
JOINTS = (
    "time_secs",
    *(f"axis_{letter}_pos" for letter in LETTERS),
    *(f"axis_{letter}_vel" for letter in LETTERS),
)
FOLDED = np.array([0.0013, 1.61, 0.03, 0.08, 3.07])


def real_folder() -> Path:
    """Return the campaign's folder, or skip the test."""
    folder = os.environ.get(SETTING)
    if not folder:
        pytest.skip(f"{SETTING} does not name the folder of the campaign's recordings")
    return Path(folder)


def poses(seconds=8.0, roll=0.05, pitch=0.03, yaw=1.8, rise_mps=0.02):
    """Return rows of motion capture at 100 Hz: attitude held, height rising from 0.4 m."""
    t = np.arange(0.0, seconds, 0.01)
    q = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat()
    p = np.stack([0.0 * t, 0.0 * t, 0.4 + rise_mps * t], axis=1)
    return np.hstack([t[:, None], p, np.tile(q, (len(t), 1))])


def write_run(folder, stem, mocap=None, joints=None, start_s=2.0):
    """Write the files of a run; ``joints`` [m, 11] as in `JOINTS`."""
    mocap = poses() if mocap is None else mocap
    t = mocap[::2, 0]
    if joints is None:
        joints = np.hstack([t[:, None], np.tile(FOLDED, (len(t), 1)), np.zeros((len(t), 5))])
    write_table(folder / f"{stem}_mocap.csv", POSE, mocap)
    imu = np.hstack([mocap[::7, :1], mocap[::7, 4:], np.zeros((len(mocap[::7]), 3))])
    write_table(folder / f"{stem}_imu.csv", (POSE[0], *POSE[4:], *RATES), imu)
    write_table(folder / f"{stem}_joint_states.csv", JOINTS, joints)
    if start_s is not None:
        name = f"metadata_{stem.removeprefix('traj')}.yml"
        (folder / name).write_text(f"start_time: {start_s}\n")


def write_table(path, columns, rows):
    """Write a CSV file with a header; NaN becomes a blank."""
    lines = [",".join("" if np.isnan(x) else repr(float(x)) for x in row) for row in rows]
    path.write_text("\n".join([",".join(columns), *lines]) + "\n")
