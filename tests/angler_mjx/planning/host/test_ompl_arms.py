"""Plans of bases and arms together: a goal deep in a slot that the hull does not fit into."""

from dataclasses import replace

import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.planning.answers import check_answer
from angler_mjx.planning.planner import NoPlan, joint_path
from angler_mjx.robot.control.commands.joint_trajectory import VEHICLE_JOINTS
from angler_mjx.robot.vehicles import library
from angler_mjx.robot.vehicles.params import build_vehicle
from angler_mjx.runs.rollout import rollout
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage import trajectory_layout
from angler_mjx.runs.storage.plans.read import open_plans
from angler_mjx.runs.storage.plans.write import plan_worlds
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.testing import referee

from ...link_poses import locate_by_mujoco

pytest.importorskip("ompl", reason="needs the extra plan: OMPL")
pytest.importorskip("coal", reason="needs the extra plan: coal")
from angler_mjx.planning.host.collision import TeamModel
from angler_mjx.planning.host.ompl.planners import PLANNERS
from angler_mjx.planning.host.robots import PlannedRobot, build_arm

VEHICLE = "bluerov2_heavy_alpha5"
GOAL_M = (-0.05, -5.0, -5.0)
SLOT = {
    "name": "slot",
    "engine": "mjx",
    "worlds": 1,
    "tile": 1,
    "goal_tolerance_m": 0.05,
    "time": {"horizon_s": 30.0, "record_hz": 20.0},
    "world": {
        "preset": "open",
        "placement": "given",
        "shape": [12, 12, 12],
        "cell_m": 2.0,
        "start_m": [[-2.0, -5.0, -5.0]],
        "goal_m": [GOAL_M],
        # 30 cm high; its mouth is at x = -0.3 m.
        "obstacles": {
            "explicit": [
                {"type": "box", "position_m": [0.5, -5.0, z], "size_m": [1.6, 3.0, 0.7]}
                for z in (-4.5, -5.5)
            ]
        },
    },
    "task": {"type": "goal", "reached_by": "end_effector"},
    "controller": {"name": "arm"},
    "fleet": [{"vehicle": VEHICLE, "parameter_set": "wu2018"}],
    "planner": {
        "name": "RRTConnect",
        "deadline_s": 60.0,
        "RRTConnect": {"arm": True, "edge_limit": 3000},
    },
}


def plan(problem, name="RRTConnect", **settings):
    kind = PLANNERS[name]
    planner = kind(kind.Settings(edge_limit=3000, **settings))
    return check_answer(planner.plan(problem), problem, 0.0, planner.extras)


@pytest.fixture(scope="module")
def scenario():
    return Scenario.model_validate(SLOT)


@pytest.fixture(scope="module")
def problem(scenario):
    return replace(Simulator(scenario).problems(0, 1)[0], deadline_s=60.0)


@pytest.fixture(scope="module")
def planned(problem):
    (path,) = plan(problem, arm=True).paths
    assert not isinstance(path, NoPlan), path.reason
    return path


def test_with_the_arm_at_home_there_is_no_plan(problem):
    answer = plan(problem)
    assert answer.status == "none"
    assert answer.reason == "its goal is taken or outside"


def test_a_plan_moves_the_arm_and_ends_with_the_end_effector_at_the_goal(problem, planned):
    """Judged by MuJoCo's kinematics of the vehicle file."""
    config = library.load_vehicle(VEHICLE)
    assert planned.joints == (*VEHICLE_JOINTS, *problem.joint_names)
    end = planned.position[-1]
    turn = [np.cos(0.5 * end[3]), 0.0, 0.0, np.sin(0.5 * end[3])]
    poses = locate_by_mujoco(config, end[:3], turn, end[4:])
    origin, rotation = poses[config.end_effector.link]
    tip_m = origin + rotation @ config.end_effector.position_m
    np.testing.assert_allclose(tip_m, GOAL_M, atol=1e-3)
    assert np.abs(end[4:] - planned.position[0, 4:]).max() > 0.3


def test_joints_keep_their_limits_and_speeds_and_grippers_stay(problem, planned):
    joints = {joint.name: joint for joint in library.load_vehicle(VEHICLE).joints}
    span = np.diff(planned.time_s)
    for name, column in zip(problem.joint_names, planned.position[:, 4:].T, strict=True):
        joint = joints[name]
        assert np.all((column >= joint.lower - 1e-5) & (column <= joint.upper + 1e-5))
        assert np.all(np.abs(np.diff(column)) <= joint.actuator.max_speed * span + 1e-5)
        if joint.is_gripper:
            assert np.ptp(column) == 0.0
    moved_m = np.linalg.norm(np.diff(planned.position[:, :3], axis=0), axis=1)
    assert np.all(moved_m <= problem.team.cruise_speed_mps[0] * span + 1e-4)


def test_no_link_touches_anything_on_the_way(problem, planned):
    """Judged by the arm of the vehicle file, every 5 mm, 3 cm away."""
    config = library.load_vehicle(VEHICLE)
    model = TeamModel(
        [PlannedRobot.of(build_vehicle(config, None, 16.0), arm=build_arm(config))], problem
    )
    at_s = np.linspace(0.0, planned.time_s[-1], 600)
    q = np.array([np.interp(at_s, planned.time_s, column) for column in planned.position.T]).T
    assert min(model.clearance(row) for row in q) > 0.03


def test_equal_problems_have_equal_plans(problem, planned):
    (again,) = plan(problem, arm=True).paths
    np.testing.assert_array_equal(again.position, planned.position)
    np.testing.assert_array_equal(again.time_s, planned.time_s)


@pytest.mark.parametrize("name", ["RRT", "BITstar"])
def test_other_planners_of_ompl_plan_arms(problem, name):
    kind = PLANNERS[name]
    planner = kind(kind.Settings(arm=True, first=True))
    (path,) = check_answer(planner.plan(problem), problem, 0.0, None).paths
    assert not isinstance(path, NoPlan), path.reason
    assert len(path.joints) == 9


def test_the_flight_arrives_and_the_referee_agrees(scenario, tmp_path):
    run = rollout(scenario, out=tmp_path / "run")
    (row,) = run.episodes.to_pylist()
    assert (row["outcome"], row["planned"]) == ("reached", True)
    assert row["min_clearance_m"] > 0.0
    assert row["joint_commands_clipped"] == 0
    verdict = referee.judge(run.path)
    assert verdict.conclusion == "agrees", verdict.differences
    path = tmp_path / "plans.zarr"
    simulator = Simulator(scenario)
    assert plan_worlds(path, scenario, simulator) == 1
    file = open_plans(path, scenario)
    assert file.shape == simulator.paths
    read, _ = file.of([0], simulator.worlds(), simulator)
    stored = trajectory_layout.read_plan(run.trajectories, 0, np.ones(1, bool))
    assert read.joints == stored.joints
    for name in ("time_s", "position", "velocity", "degree"):
        np.testing.assert_array_equal(getattr(read, name)[0], getattr(stored, name))


def test_a_path_whose_joints_cannot_be_flown_is_refused(problem):
    start, names = problem.team.start_m[0], problem.joint_names
    home = problem.team.arms.joint_position[0]

    def refused(first, last, joints=names):
        arm = dict(zip(joints, np.stack([first, last]).T, strict=True))
        path = joint_path([0.0, 1.0], [start, start], [0.0, 0.0], arm=arm)
        (answer,) = check_answer([path], problem, 0.0, None).paths
        return answer.reason if isinstance(answer, NoPlan) else ""

    moved = home + np.array([0.2, 0.0, 0.0, 0.0, 0.0])
    assert refused(home, moved) == ""
    assert refused(moved, home) == "joint axis_e begins elsewhere than it is"
    assert (
        refused(home, home + np.array([3.0, 0.0, 0.0, 0.0, 0.0]))
        == "joint axis_e goes beyond its limits"
    )
    assert (
        refused(home, home + np.array([0.0, 0.0, 1.0, 0.0, 0.0]))
        == "joint axis_c moves faster than it can"
    )
    assert "has the joints" in refused(home[:1], home[:1], names[:1])


def test_settings_and_fleets_without_joints_are_refused_by_name():
    kind = PLANNERS["RRT"]
    with pytest.raises(ConfigError, match=r'planner.RRT.mode = "prioritised": joints of arms'):
        kind(kind.Settings(arm=True, mode="prioritised"))
    rigid = SLOT | {
        "fleet": [{"vehicle": "bluerov2_heavy"}],
        "task": {"type": "goal"},
        "controller": {"name": "cascade"},
        "world": {"preset": "open"},
    }
    with pytest.raises(ConfigError, match="planner RRTConnect: arm = true, and no vehicle"):
        Simulator(Scenario.model_validate(rigid))
    assert Scenario.model_validate(SLOT).policy.name == "none"
    grid = SLOT | {"planner": {"name": "grid", "grid": {"arm": True}}}
    with pytest.raises(ConfigError, match="arm"):
        Simulator(Scenario.model_validate(grid))


@pytest.mark.parametrize("name", ["PRM", "PRMstar"])
def test_planners_that_run_on_are_refused(name):
    """They ran on beyond their limits."""
    kind = PLANNERS[name]
    with pytest.raises(ConfigError, match=rf"planner\.{name}\.arm: it runs on beyond"):
        kind(kind.Settings(arm=True))
    kind(kind.Settings())
