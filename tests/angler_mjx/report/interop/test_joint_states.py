"""Joints and links of arms in a bag, read back by an independent reader."""

import numpy as np
import pytest

from angler_mjx.report.interop import mcap
from angler_mjx.robot.vehicles import library

from ...armed import ARM, LIMP, RIGID
from ...link_poses import locate_by_mujoco, world_rotation
from .test_mcap import messages, wxyz, xyz

JOINTS = ["axis_e", "axis_d", "axis_c", "axis_b", "axis_a"]


@pytest.fixture(scope="module")
def held(armed_run, tmp_path_factory):
    path = tmp_path_factory.mktemp("bag") / "out.mcap"
    mcap.export_bag(armed_run, path, [1])
    return messages(path)[0]


@pytest.mark.parametrize("robot", [ARM, LIMP])
def test_joint_states_are_the_run(held, armed_run, robot):
    states = [message for _, message in held[f"/world_1/robot_{robot}/joint_states"]]
    stored = armed_run.trajectories
    assert len(states) > 20
    for field in ("position", "velocity"):
        values = np.array([getattr(state, field) for state in states])
        rows = np.asarray(stored[f"joint_{field}"])[1, : len(states), robot]
        np.testing.assert_array_equal(values, rows)
    assert all(list(state.name) == JOINTS for state in states)
    times = [state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec for state in states]
    np.testing.assert_allclose(times, np.asarray(stored["time_s"])[: len(states)], atol=1e-9)


def test_a_robot_without_joints_has_no_states(held):
    assert f"/world_1/robot_{RIGID}/odometry" in held
    assert f"/world_1/robot_{RIGID}/joint_states" not in held


@pytest.mark.parametrize("robot", [ARM, LIMP])
@pytest.mark.parametrize("k", [0, 15])
def test_frames_of_links_are_where_mujoco_has_them(held, armed_run, robot, k):
    stored, root = armed_run.trajectories, f"world_1/robot_{robot}"
    now = round(float(stored["time_s"][k]) * 1e9)
    at = {
        one.child_frame_id: one
        for time, message in held["/tf"]
        if time == now
        for one in message.transforms
    }
    names = ("p_m", "q", "joint_position")
    p, q, position = (np.asarray(stored[name])[1, k, robot] for name in names)
    want = locate_by_mujoco(library.load_vehicle("bluerov2_heavy_alpha5"), p, q, position)
    assert len(want) == 6
    for name, (origin, rotation) in want.items():
        center, turn, frame = np.zeros(3), np.eye(3), f"{root}/{name}"
        while frame != "world_1":
            step = at[frame]
            local = world_rotation(wxyz(step.transform.rotation))
            center = np.array(xyz(step.transform.translation)) + local @ center
            turn, frame = local @ turn, step.header.frame_id
        # Postures are worked out in float32.
        np.testing.assert_allclose(center, origin, atol=2e-6)
        np.testing.assert_allclose(turn, rotation, atol=2e-6)
