"""Datasets of fleets with arms: made by the command, and their joints checked."""

import json

import numpy as np
import pytest
import zarr

from angler_mjx.cli import main
from angler_mjx.learning import datasets
from angler_mjx.learning.datasets import checksums, manifest
from angler_mjx.learning.datasets.verifying import verification
from angler_mjx.learning.datasets.verifying.joints import find_bounds, find_joint_faults
from angler_mjx.progress import Progress

from ...armed import ARM, LIMP, RIGID, SCENARIO, write_scenario

FILE = """
schema_version = 1
name = "arms"
description = "For tests."
scenario = "armed.toml"
seed = 4

[[scene]]
name = "open"

[[expert]]
name = "grid"
"""


@pytest.fixture(scope="module")
def recorded(armed_run):
    """Bounds and arrays of a run of an arm, a limp one and a rigid vehicle."""
    stored = armed_run.trajectories
    names = ("time_s", "joint_position", "joint_velocity", "outcome", "p_m")
    arrays = {name: np.asarray(stored[name]) for name in names}
    running = np.isfinite(arrays["p_m"]).all(-1) & (arrays["outcome"] == 0)
    bounds = find_bounds(armed_run.scenario.members(), 5)
    return bounds, arrays["time_s"], arrays["joint_position"], arrays["joint_velocity"], running


def faults(recorded, position=None, velocity=None):
    bounds, time_s, recorded_position, recorded_velocity, running = recorded
    position = recorded_position if position is None else position
    velocity = recorded_velocity if velocity is None else velocity
    found = find_joint_faults(bounds, time_s, position, velocity, running)
    return {name: np.unique(np.argwhere(wrong)[:, 2]).tolist() for name, wrong in found.items()}


def test_recorded_joints_are_sound(recorded):
    assert recorded[0].must_have.tolist() == [True, True, False]
    assert faults(recorded) == {"joint_position": [], "joint_velocity": []}


def test_joints_beyond_their_limits_are_found(recorded):
    position = recorded[2].copy()
    position[0, 3:, LIMP, 2] = recorded[0].upper[LIMP, 2] + 1.0
    assert faults(recorded, position)["joint_position"] == [LIMP]


def test_joints_of_a_rigid_robot_and_missing_ones_are_found(recorded):
    position, velocity = recorded[2].copy(), recorded[3].copy()
    position[1, 2, RIGID] = velocity[1, 2, RIGID] = 0.0
    position[1, 2, ARM] = velocity[1, 2, ARM] = np.nan
    assert faults(recorded, position, velocity)["joint_position"] == [ARM, RIGID]


def test_speeds_that_do_not_belong_to_the_positions_are_found(recorded):
    velocity = recorded[3].copy()
    velocity[0, 4, ARM, 1] = 60.0
    assert faults(recorded, velocity=velocity)["joint_velocity"] == [ARM]
    position = recorded[2].copy()
    position[0, 5, ARM, 1] += 1.0
    assert faults(recorded, position)["joint_velocity"] == [ARM]
    velocity = np.where(np.arange(3)[:, None] == LIMP, np.nan, recorded[3])
    assert faults(recorded, velocity=velocity)["joint_velocity"] == [LIMP]


def test_a_dataset_with_arms_is_made_verified_and_read(tmp_path, capsys):
    write_scenario(tmp_path, SCENARIO.replace("horizon_s = 15.0", "horizon_s = 3.0"))
    (tmp_path / "arms.toml").write_text(FILE)
    made = tmp_path / "made"
    main.main(
        ["dataset", "make", str(tmp_path / "arms.toml"), "--episodes", "2", "--out", str(made)]
    )
    main.main(["dataset", "verify", str(made)])
    assert capsys.readouterr().out.count("nothing wrong") == 4
    data = datasets.open(made, fields=("joint_position",))
    position = data.episode(0).arrays["joint_position"]
    assert np.isnan(position[:, RIGID]).all()
    part = manifest.read_manifest(made).parts[0].path
    array = zarr.open_group(made / part / "trajectories.zarr", mode="r+")["joint_position"]
    array[1, 2, ARM, 1] = 50.0
    table = manifest.read_manifest(made).model_dump(mode="json")
    table["sums"] = checksums.write_checksums(made)
    (made / manifest.MANIFEST).write_text(json.dumps(table))
    (finding, *_) = verification.verify_dataset(made, 0, Progress(), None).findings
    assert finding.where.endswith("joint_position")
