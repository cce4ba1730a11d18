"""What a planner gives is looked at before anything flies it, and refused by name."""

from dataclasses import replace

import numpy as np
import pytest

from angler_mjx.planning.answers import check_answer, check_paths
from angler_mjx.planning.planner import NoPlan, joint_path, way_points
from angler_mjx.robot.control.commands.joint_trajectory import CUBIC

from .problems import problem

START, GOAL = (1.0, 1.0, 1.0), (6.0, 1.0, 1.0)
ONE = problem([START], [GOAL], cruise=0.5, horizon_s=60.0)
TWO = problem([START, (1, 4, 1)], [GOAL, (6, 4, 1)], cruise=0.5)
GOOD = way_points([0, 10], [START, GOAL])


def many(points):
    along = np.linspace(0, 1, points)
    return way_points(10 * along, np.array(START) + along[:, None] * [5, 0, 0])


def changed(**arrays):
    return replace(GOOD, **arrays)


@pytest.mark.parametrize(
    ("path", "reason"),
    [
        (way_points([0, np.nan], [START, GOAL]), "NaN or infinite times at point 1"),
        (way_points([0, 10], [START, (np.inf, 1, 1)]), "NaN or infinite points at point 1"),
        (way_points([0, 5, 4], [START, START, GOAL]), "goes back in time from 5 to 4 s at point 2"),
        (way_points([1, 11], [START, GOAL]), "begins at 1 s, not at 0"),
        (way_points([0, 10], [(1, 1, 1.02), GOAL]), "begins 0.02 m from the robot's start"),
        (
            way_points([0, 10, 10], [START, (3, 1, 1), GOAL]),
            "jumps 3 m at 10 s (point 2)",
        ),
        (
            way_points([0, 2, 11.8], [START, START, GOAL]),
            "moves at 0.51 m/s after 2 s (points 1 and 2); at most 0.5 m/s, its cruise speed",
        ),
        (way_points([0, 61], [START, GOAL]), "ends at 61 s, after the horizon of 60"),
        (many(1025), "has 1025 points; at most 1024 can be flown"),
        (way_points([0], [START]), "has 1 points; at least 2 are needed"),
        (way_points([], np.zeros((0, 3))), "has 0 points; at least 2 are needed"),
        (changed(position_m=np.zeros((2, 2))), "has points of shape [2, 2], not [2, 3]"),
        (changed(time_s=np.zeros((2, 1))), "has times of shape [2, 1], not [n]"),
        (changed(time_s=["a", "b"]), "has times that are no numbers but <U1"),
        (changed(position_m=[[1, 1, 1], [6, 1]]), "has points that are no array"),
        (changed(found=np.asarray(False)), "no way was found"),
        (np.zeros((2, 3)), "no path but ndarray"),
        (NoPlan("too deep"), "too deep"),
    ],
)
def test_what_cannot_be_flown_is_refused_with_its_reason(path, reason):
    (refused,) = check_paths([path], ONE)
    assert isinstance(refused, NoPlan)
    assert reason in refused.reason


def test_who_is_faster_only_by_rounding_is_believed():
    (path,) = check_paths([way_points([0, 9.96], [START, GOAL])], ONE)
    assert not isinstance(path, NoPlan)


def test_who_counts_on_a_current_may_be_faster_over_ground_but_may_not_jump():
    fast, jump = way_points([0, 4], [START, GOAL]), way_points([0, 4, 4], [START, START, GOAL])
    assert isinstance(check_paths([fast], ONE)[0], NoPlan)
    assert not isinstance(check_paths([fast], ONE, any_speed=True)[0], NoPlan)
    assert "jumps" in check_paths([jump], ONE, any_speed=True)[0].reason


def test_a_path_may_have_as_many_points_as_are_flown():
    assert not isinstance(check_paths([many(64)], ONE, 64)[0], NoPlan)
    assert isinstance(check_paths([many(65)], ONE, 64)[0], NoPlan)


def test_padding_repeats_the_last_point():
    (path,) = check_paths([way_points([0, 10, 10, 10], [START, GOAL, GOAL, GOAL])], ONE)
    assert not isinstance(path, NoPlan)


def test_curves_are_held_to_the_cruise_speed_between_their_points():
    still = np.zeros((2, 4))
    yaw = [0.0, 0.0]
    smooth = joint_path([0, 15.0], [START, GOAL], yaw, still)
    short = joint_path([0, 14.0], [START, GOAL], yaw, still)
    assert smooth.degree[0] == CUBIC
    # A cubic at rest at both ends is fastest in the middle: 1.5 times its mean speed.
    assert not isinstance(check_paths([smooth], ONE)[0], NoPlan)
    assert "moves at 0.536 m/s after 0 s" in check_paths([short], ONE)[0].reason


def test_joints_other_than_the_vehicle_s_are_refused():
    path = joint_path([0, 15.0], [START, GOAL], [0, 0])
    odd = replace(path, joints=("x", "y", "z", "elbow"))
    assert "has the joints" in check_paths([odd], ONE)[0].reason
    bent = replace(path, degree=np.array([2, 1], np.int32))
    assert "a degree that is not 1, 3 or 5" in check_paths([bent], ONE)[0].reason


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ([GOOD], "gave 1 paths for 2 robots"),
        ([GOOD] * 3, "gave 3 paths for 2 robots"),
        (None, "gave no list of paths but NoneType"),
        ({0: GOOD, 1: GOOD}, "gave no list of paths but dict"),
        (GOOD, "gave no list of paths but Trajectory"),
    ],
)
def test_the_wrong_robots_are_refused(given, reason):
    got = check_answer(given, TWO, 0.1, None)
    assert got.paths == [NoPlan(reason)] * 2
    assert (got.status, got.reason) == ("error", reason)


def test_the_rest_of_a_team_keeps_its_paths():
    got = check_answer(
        [GOOD, GOOD], TWO, 0.1, {"best_m": np.float64(5), "words": "x", "flag": True}
    )
    assert got.status == "partial"
    assert got.reason == "robot 1: begins 3 m from the robot's start"
    np.testing.assert_array_equal(got.paths[0].position_m, np.float32([START, GOAL]))
    assert got.paths[0].found.dtype == bool
    assert got.extras == {"best_m": 5.0}


@pytest.mark.parametrize(
    ("told", "kept"),
    [
        ([(0.1, 9), (np.float64(0.2), 8.5)], ((0.1, 9.0), (0.2, 8.5))),
        ([(0.1, 9), (0.05, 8), (0.2, np.nan), (np.inf, 7), (0.2, 6)], ((0.1, 9.0), (0.2, 6.0))),
        ([(-1.0, 9), 3, "ab", (1, 2, 3), None, (0.5, "x"), (0.6, 1)], ((0.6, 1.0),)),
        ([(n, -n) for n in range(1500)], tuple((float(n), -float(n)) for n in range(1000))),
        (None, ()),
        ({"a": 1}, ()),
        ("ab", ()),
    ],
)
def test_of_progress_only_rising_finite_pairs_are_kept(told, kept):
    assert check_answer([GOOD, GOOD], TWO, 0.1, None, progress=told).progress == kept
