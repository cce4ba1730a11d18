"""A hatch that a robot fits through only with its arm folded, planned and flown."""

from dataclasses import replace

import numpy as np
import pytest

from angler_mjx.planning.planner import NoPlan
from angler_mjx.robot.vehicles import library
from angler_mjx.robot.vehicles.params import build_vehicle
from angler_mjx.runs.rollout import rollout
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.testing import referee

pytest.importorskip("ompl", reason="needs the extra plan: OMPL")
pytest.importorskip("coal", reason="needs the extra plan: coal")
from angler_mjx.planning.host.collision import TeamModel
from angler_mjx.planning.host.ompl.planners import PLANNERS
from angler_mjx.planning.host.robots import PlannedRobot, build_arm

VEHICLE = "bluerov2_heavy_alpha5"
HEIGHT_M, HALF_WIDTH_M, REACH_M = -5.2, 0.35, 1.6
"""Height and half edge of the square hatch, in a plate 0.3 m thick that closes the cube."""
SIDE_M = REACH_M - HALF_WIDTH_M
MIDDLE_M = HALF_WIDTH_M + 0.5 * SIDE_M
PLATE = [
    *(((x, 0.0, HEIGHT_M), (SIDE_M, 2.0 * REACH_M, 0.3)) for x in (-MIDDLE_M, MIDDLE_M)),
    *(((0.0, y, HEIGHT_M), (2.0 * HALF_WIDTH_M, SIDE_M, 0.3)) for y in (-MIDDLE_M, MIDDLE_M)),
]
HATCH = {
    "name": "hatch",
    "engine": "mjx",
    "worlds": 1,
    "tile": 1,
    "seed": 10,  # of which the search takes the fewest edges
    "goal_tolerance_m": 0.1,
    "time": {"horizon_s": 60.0, "record_hz": 20.0},
    "world": {
        "preset": "open",
        "placement": "given",
        "shape": [2, 2, 4],
        "cell_m": 1.6,
        "depth_m": 2.0,
        "start_m": [[0.0, 0.0, -4.1]],
        "goal_m": [[0.0, 0.0, -6.3]],
        "obstacles": {
            "explicit": [
                {"type": "box", "position_m": position, "size_m": size} for position, size in PLATE
            ]
        },
    },
    "controller": {"name": "arm"},
    "fleet": [{"vehicle": VEHICLE, "parameter_set": "wu2018"}],
    "planner": {
        "name": "RRTConnect",
        "deadline_s": 60.0,
        "RRTConnect": {"arm": True, "edge_limit": 100_000, "margin_m": 0.02},
    },
}


@pytest.fixture(scope="module")
def scenario():
    return Scenario.model_validate(HATCH)


@pytest.fixture(scope="module")
def problem(scenario):
    return replace(Simulator(scenario).problems(0, 1)[0], deadline_s=60.0)


@pytest.fixture(scope="module")
def model(problem):
    """Collision model of the vehicle file, without any margin."""
    config = library.load_vehicle(VEHICLE)
    return TeamModel(
        [PlannedRobot.of(build_vehicle(config, None, 16.0), arm=build_arm(config))], problem
    )


def test_with_the_arm_at_home_nothing_fits_through(problem, model):
    """At no place in the middle of the hatch, and at no heading."""
    home = np.asarray(problem.team.arms.joint_position, float)[0]
    places, headings = np.linspace(-0.15, 0.15, 13), np.linspace(-np.pi, np.pi, 73)
    assert not any(
        model.state(np.array([x, y, HEIGHT_M, yaw, *home]))
        for x in places
        for y in places
        for yaw in headings
    )
    kind = PLANNERS["RRTConnect"]
    (path,) = kind(kind.Settings(edge_limit=3000)).plan(replace(problem, deadline_s=10.0))
    assert isinstance(path, NoPlan)


def test_the_arm_is_folded_for_the_hatch_and_the_flight_keeps_clear(
    scenario, problem, model, tmp_path
):
    """The flown clearance is the referee's, by kinematics of its own."""
    run = rollout(scenario, out=tmp_path / "run")
    (row,) = run.episodes.to_pylist()
    assert (row["outcome"], row["planned"]) == ("reached", True)
    assert row["min_clearance_m"] > 0.005
    assert row["joint_commands_clipped"] == 0
    verdict = referee.judge(run.path)
    assert verdict.conclusion == "agrees", verdict.differences
    # In the hatch the joints are elsewhere than at home, and the base would be held there.
    p = np.asarray(run.trajectories["p_m"])[0, :, 0]
    joints = np.asarray(run.trajectories["joint_position"])[0, :, 0]
    in_hatch = np.flatnonzero(np.abs(p[:, 2] - HEIGHT_M) < 0.05)
    assert len(in_hatch)
    home = np.asarray(problem.team.arms.joint_position, float)[0]
    assert np.abs(joints[in_hatch] - home).max(axis=1).min() > 0.5
    q = np.asarray(run.trajectories["q"])[0, :, 0]
    for sample in in_hatch:
        w, x, y, z = q[sample]
        yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        assert model.state(np.array([*p[sample], yaw, *joints[sample]]))
        assert not model.state(np.array([*p[sample], yaw, *home]))
