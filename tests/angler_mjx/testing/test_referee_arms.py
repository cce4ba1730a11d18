"""The referee on robots with arms: postures, contact of links, limits of joints."""

import json
import shutil
import tomllib

import numpy as np
import pytest
import zarr

from angler_mjx.robot.vehicles import library
from angler_mjx.runs.rollout import rollout
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.testing import referee
from angler_mjx.testing.referee.arms import read_arm

from ..armed import ARM, LIMP
from ..link_poses import locate_by_mujoco


@pytest.mark.parametrize("posture", [(3.1416, 0.01, 1.5708, 0.0, 0.0), (4.0, 1.5, 2.7, 0.5, 0.01)])
def test_capsules_lie_where_mujoco_has_the_links(posture):
    name = "bluerov2_heavy_alpha5"
    config, path = library.load_vehicle(name), library.locate_vehicle(name)
    arm = read_arm(tomllib.loads(path.read_text()))
    starts, ends = arm.locate_capsules(np.array([posture]))
    poses = locate_by_mujoco(config, np.zeros(3), [1.0, 0.0, 0.0, 0.0], posture)
    capsules = [(link.name, item) for link in config.find_links(None) for item in link.capsules]
    assert len(capsules) == len(arm.r_m) == 6
    for i, (link, capsule) in enumerate(capsules):
        origin, turn = poses[link]
        np.testing.assert_allclose(starts[0, i], origin + turn @ capsule.from_m, atol=1e-9)
        np.testing.assert_allclose(ends[0, i], origin + turn @ capsule.to_m, atol=1e-9)


def test_a_vehicle_without_links_has_no_arm():
    path = library.locate_vehicle("bluerov2_heavy")
    assert read_arm(tomllib.loads(path.read_text())) is None


def read_shipped(change=None):
    """Return the arm of the shipped vehicle with a changed end effector."""
    table = tomllib.loads(library.locate_vehicle("bluerov2_heavy_alpha5").read_text())
    if change is None:
        del table["end_effector"]
    else:
        table["end_effector"] |= change
    return read_arm(table)


def test_an_end_effector_lies_on_the_link_that_carries_it():
    """Not the last one: the elbow, which is that of the end of its capsule too."""
    config = library.load_vehicle("bluerov2_heavy_alpha5")
    names = [link.name for link in config.find_links(None)]
    end_m = config.find_links(None)[names.index("elbow")].capsules[0].to_m
    arm = read_shipped({"link": "elbow", "position_m": list(end_m)})
    postures = np.array([[3.1416, 0.01, 1.5708, 0.0, 0.0], [4.0, 1.5, 2.7, 0.5, 0.01]])
    ends = arm.locate_capsules(postures)[1][:, names.index("elbow")]
    np.testing.assert_allclose(arm.locate_end_effector(postures), ends, atol=1e-12)


def test_an_arm_may_have_no_end_effector():
    assert read_shipped().end_link == -1


@pytest.mark.parametrize("beyond", [-1.0, 0.0, 1.0])
def test_joints_may_be_beyond_their_limits_by_the_give_of_stops(beyond):
    """Below, within and above, in the second state and of the third joint."""
    arm = read_shipped()
    joints = np.stack([0.5 * (arm.lower + arm.upper)] * 3)
    limit = arm.lower[2] if beyond < 0 else arm.upper[2]
    for fraction, is_fault in ((0.04, False), (0.06, beyond != 0.0)):
        joints[1, 2] = limit + beyond * fraction * (arm.upper[2] - arm.lower[2])
        assert bool(arm.find_excess(joints)) == is_fault
    if beyond:
        assert f"joint {arm.names[2]} is at {joints[1, 2]:.4g} in state 1" in arm.find_excess(
            joints
        )


def test_a_run_with_arms_is_worked_out_anew(armed_run):
    verdict = referee.judge(armed_run.path)
    assert verdict.conclusion == "agrees", verdict.differences


def test_an_arm_that_touches_ends_the_flight(armed_run):
    """The jaws meet the ball; the vehicle itself is still away from it."""
    row = armed_run.episodes.to_pylist()[ARM]
    assert (row["outcome"], row["failure_pair"]) == ("collision_dynamic", "obstacle:0")
    p = np.array([row[f"failure_{axis}_m"] for axis in "xyz"])
    ahead = np.linalg.norm(p - [0.1, -3.11, -5.12]) - 0.1
    assert ahead - library.reach_m(library.load_vehicle("bluerov2_heavy")) > 0.1
    assert -0.05 < row["min_clearance_m"] <= 0.0


def damaged(run, out, change):
    """A copy of a run with changed arrays."""
    shutil.copytree(run.path, out)
    change(zarr.open_group(out / "trajectories.zarr", mode="r+"))
    return referee.judge(out).differences


def test_a_joint_beyond_its_limits_is_a_fault(armed_run, tmp_path):
    def change(group):
        group["joint_position"][0, 3, ARM, 1] = -0.5

    faults = damaged(armed_run, tmp_path / "out", change)
    text = " ".join(str(one.stored) for one in faults)
    assert "joint axis_d is at -0.5 in state 3, and its limits are 0 and 3.49" in text


def test_another_posture_is_another_clearance(armed_run, tmp_path):
    def change(group):
        group["joint_position"][:, :, LIMP, 1] = 1.4

    faults = {one.quantity for one in damaged(armed_run, tmp_path / "out", change)}
    assert faults & {"min_clearance_m", "min_separation_m"}


def test_end_effectors_arrive_and_not_centres(tmp_path):
    """The referee finds the end effectors at the goals, and would not the centres."""
    table = {
        "name": "reach",
        "engine": "mjx",
        "worlds": 1,
        "goal_tolerance_m": 0.05,
        "time": {"horizon_s": 20.0, "record_hz": 20.0},
        "world": {
            "preset": "open",
            "placement": "given",
            "start_m": [[-4.0, -6.0, -5.0]],
            "goal_m": [[-2.5, -6.0, -5.0]],
        },
        "task": {"type": "goal", "reached_by": "end_effector"},
        "controller": {"name": "arm"},
        "fleet": [{"vehicle": "bluerov2_heavy_alpha5", "parameter_set": "wu2018"}],
    }
    run = rollout(Scenario.model_validate(table), out=tmp_path / "run")
    assert run.summary["outcomes"]["reached"]["count"] == 1
    assert referee.judge(tmp_path / "run").conclusion == "agrees"
    config = json.loads((tmp_path / "run" / "config.json").read_text())
    config["task"]["reached_by"] = "center"
    (tmp_path / "run" / "config.json").write_text(json.dumps(config))
    assert referee.judge(tmp_path / "run").conclusion != "agrees"
