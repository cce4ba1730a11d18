"""Datasets of robots that hold a body: made by the command, and their grips checked."""

import json

import numpy as np
import pytest
import zarr
from scipy.spatial.transform import Rotation

from angler_mjx.cli import main
from angler_mjx.learning import datasets
from angler_mjx.learning.datasets.verifying import integrity
from angler_mjx.learning.datasets.verifying.carrying import GripCheck
from angler_mjx.sim.cargo import CargoSpec

FILE = """
schema_version = 1
name = "carry"
description = "For tests."
scenario = "small_carry.toml"
seed = 4

[[scene]]
name = "open"

[[expert]]
name = "carry"
"""
SMALL = "tests/commands/small_carry.toml"
GOAL_M, TURN_RAD = (1.0, 0.0, -5.0), 0.5


def build_check(**changes):
    """Return a check of two worlds with two robots."""
    settings = {
        "cargo": CargoSpec(
            body=1, goal_m=GOAL_M, turn_rad=TURN_RAD, tolerance_m=0.1, tolerance_rad=0.1
        ),
        "slip_m": 1e-3,
        "break_force_n": 20.0,
        "control_dt_s": 0.05,
        "columns": {
            "time_to_goal_s": np.array([[5.0, 5.0], [np.nan, np.nan]]),
            "failure_time_s": np.array([[np.nan, np.nan], [2.0, 5.0]]),
            "cargo_distance_m": np.array([[0.5, 0.5], [7.0, 0.5]]),
            "cargo_angle_rad": np.array([[0.2, 0.2], [7.0, 0.2]]),
        },
    }
    return GripCheck(**(settings | changes))


def build_arrays():
    """Return samples of a body that moves and turns, and of two robots that hold it."""
    turn = Rotation.from_rotvec(np.arange(6)[:, None] * [0.0, 0.1, 0.2])
    body = np.arange(6)[:, None] * [0.3, 0.0, -0.1]
    robots = [body + turn.apply(offset) for offset in ([1.0, 0.0, 0.4], [-1.0, 0.0, 0.4])]
    q = turn.as_quat(scalar_first=True)
    poses = {
        "p_m": np.stack(robots, axis=1),
        "obstacle_p_m": np.stack([np.zeros_like(body), body], axis=1),
        "obstacle_q": np.stack([np.tile([1.0, 0.0, 0.0, 0.0], (6, 1)), q], axis=1),
        "grips/held": np.ones((6, 2), np.uint8),
        "grips/wrench": np.full((6, 2, 6), 5.0),
    }
    return {name: np.stack([values, values]) for name, values in poses.items()}


def find(check, arrays):
    """Return the robots with faults by the name of their array."""
    running = np.ones((2, 6, 2), bool)
    running[1, 3:, 1] = False
    faults = check.find_faults(arrays, running)
    return {name: np.argwhere(wrong).tolist() for name, wrong in faults.items() if wrong.any()}


def test_grips_that_hold_are_sound():
    assert find(build_check(), build_arrays()) == {}


def test_a_robot_that_left_its_grip_is_found():
    arrays = build_arrays()
    arrays["p_m"][0, 4, 1, 2] += 0.003
    assert find(build_check(), arrays) == {"grips/held": [[0, 4, 1]]}
    assert find(build_check(slip_m=0.01), arrays) == {}
    assert find(build_check(slip_m=None), arrays) == {}


def test_a_grip_that_is_open_or_bears_too_much_is_found():
    arrays = build_arrays()
    arrays["grips/held"][0, 2, 0] = 0
    arrays["grips/wrench"][1, 1, 1, 1] = 19.9
    arrays["grips/wrench"][1, 2, 1] = np.nan
    arrays["grips/wrench"][1, 4, 1] = np.nan  # its episode is over
    arrays["grips/wrench"][0, 1, 0, 4] = 99.0  # a moment breaks nothing
    assert find(build_check(), arrays) == {
        "grips/held": [[0, 2, 0]],
        "grips/wrench": [[1, 1, 1], [1, 2, 1]],
    }


def test_columns_are_those_of_the_last_state_of_the_body():
    start = Rotation.from_rotvec([0.0, 0.0, 0.3])
    end = Rotation.from_rotvec([0.0, 0.0, 0.3 + TURN_RAD]) * Rotation.from_rotvec([0.2, 0.0, 0.0])
    p = np.zeros((2, 2, 3))
    p[:, 1] = np.add(GOAL_M, [0.0, 0.3, 0.4])
    q = np.tile([1.0, 0.0, 0.0, 0.0], (2, 2, 1))
    q[:, 1] = end.as_quat(scalar_first=True)
    ends = {"end/step": np.array([100, 100]), "end/obstacle_p_m": p, "end/obstacle_q": q}
    start_q = np.tile(start.as_quat(scalar_first=True), (2, 1))
    wrong = build_check().find_wrong_errors(0, start_q, ends)
    # That of the second world's first robot, which ended before, is not judged.
    assert not any(values.any() for values in wrong.values())
    p[1, 1, 0] += 0.01
    wrong = build_check().find_wrong_errors(0, start_q, ends)
    assert wrong["cargo_distance_m"].tolist() == [[False, False], [False, True]]
    assert not wrong["cargo_angle_rad"].any()
    wrong = build_check().find_wrong_errors(1, start_q[1:], {k: v[1:] for k, v in ends.items()})
    assert wrong["cargo_distance_m"].tolist() == [[False, True]]


@pytest.fixture(scope="module")
def made(tmp_path_factory, pytestconfig):
    folder = tmp_path_factory.mktemp("carry")
    text = (pytestconfig.rootpath / SMALL).read_text(encoding="utf-8")
    (folder / "small_carry.toml").write_text(text, encoding="utf-8")
    (folder / "carry.toml").write_text(FILE, encoding="utf-8")
    out = folder / "out"
    main.main(["dataset", "make", str(folder / "carry.toml"), "--episodes", "2", "--out", str(out)])
    return out


def test_a_dataset_has_the_body_and_its_grips(made):
    fields = ("grips/wrench", "grips/held", "obstacle_p_m", "obstacle_q")
    episode = datasets.open(made, fields=fields).episode(0)
    arrays = episode.arrays
    assert arrays["grips/held"].all()
    # After the first period the pipe of 15 kg, which displaces 16 l, pulls at both.
    assert np.all(np.linalg.norm(arrays["grips/wrench"][2:, :, :3], axis=-1) > 0.1)
    assert arrays["obstacle_p_m"].shape == (len(episode.time_s), 1, 3)
    assert episode.outcomes == ("reached", "reached")


def test_its_values_are_verified(made, capsys):
    main.main(["dataset", "verify", str(made), "--json"])
    assert json.loads(capsys.readouterr().out)["agrees"] is True
    run = next((made / "runs").iterdir())
    array = zarr.open_group(run / "trajectories.zarr", mode="r+")["grips/wrench"]
    stored = array[:]
    changed = stored.copy()
    changed[1, 3, 0] = np.nan
    array[:] = changed
    checked = integrity._check_task(made, 0.0, (f"runs/{run.name}", range(2)))
    array[:] = stored
    assert [name for name, _ in checked.faults] == ["grips/wrench"]
