"""What is kept of answers that are not what they should be."""

from types import SimpleNamespace

import numpy as np
import pytest

from angler_mjx.planning.answers import Answer
from angler_mjx.planning.planner import NoPlan, joint_path, way_points
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.studies.benchmark import planning

LINE = way_points([0, 2], [(0, 0, 0), (1, 0, 0)])
TURN = joint_path([0, 2], [(0, 0, 0), (1, 0, 0)], [0, 1])


def said(paths, status="planned"):
    return Answer(paths=paths, status=status, reason="", planning_s=0.1)


def test_paths_of_another_kind_than_was_said_are_none():
    lines, joints = SimpleNamespace(joints=False), SimpleNamespace(joints=True)
    assert planning._check_path_kind(said([LINE, LINE]), lines).status == "planned"
    assert (
        planning._check_path_kind(said([TURN, NoPlan("x")], "partial"), joints).status == "partial"
    )
    mixed = planning._check_path_kind(said([LINE, TURN]), lines)
    assert mixed.status == "partial"
    assert mixed.paths[0] is LINE
    assert mixed.paths[1].reason == "gives JointTrajectory, and its class says joints = False"
    assert planning._check_path_kind(said([LINE, LINE]), joints).status == "none"


@pytest.mark.parametrize(
    ("times", "kept"),
    [
        ([0, 1, 2, 2, 2], [0, 1, 2]),
        ([0, 1, 1, 2, 2], [0, 1, 1, 2]),
        ([0, 10, 5, 5, 5], [0, 10, 5]),
        ([0, 0, 0, 0, 0], [0, 0]),
        ([0, 1, 2, np.nan, np.nan], [0, 1, 2, np.nan, np.nan]),
    ],
)
def test_only_rows_that_repeat_the_last_are_cut_from_a_batch(times, kept):
    """What is wrong with a path stays there to be seen."""
    time = np.array(times, np.float32)[None, None]
    place = np.arange(15, dtype=np.float32).reshape(1, 1, 5, 3)
    batch = Trajectory(time_s=time, position_m=place, found=np.ones((1, 1), bool))
    one = planning._extract_path(batch, 0, 0)
    np.testing.assert_array_equal(one.time_s, np.array(kept, np.float32))
    np.testing.assert_array_equal(one.position_m, place[0, 0, : len(kept)])
