"""Sessions of fleets with arms: joints are commanded, refused by name, and observed."""

import re
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import angler_mjx as angler
from angler_mjx.errors import ConfigError
from angler_mjx.planning.online import guidance, replanning
from angler_mjx.planning.online.policy import Online
from angler_mjx.planning.online.replanning import Replanning
from angler_mjx.report.interop import joint_trajectory_file
from angler_mjx.robot.control.commands import BodyTwist, PoseTarget
from angler_mjx.robot.control.commands.joint_goal import JointGoal, JointPoint
from angler_mjx.robot.control.commands.joint_tolerance import JointTolerance, build_tolerances
from angler_mjx.robot.control.commands.joint_trajectory import (
    LINEAR,
    VEHICLE_JOINTS,
    JointTrajectory,
)
from angler_mjx.robot.control.commands.trajectory import hold_position
from angler_mjx.robot.control.commands.whole_body import JointTarget, WholeBodyCommand
from angler_mjx.runs.session.batch_session import BatchSession
from angler_mjx.runs.session.command_preparation import stack_tolerances
from angler_mjx.runs.session.online_policy import build_session_problem
from angler_mjx.runs.session.robot_plan import RobotPlan
from angler_mjx.runs.simulator.world_preparation import problem_settings
from angler_mjx.sim.information import Information
from angler_mjx.sim.world_context import WorldContext

from ...armed import ARM, RIGID, SCENARIO, write_scenario

PAGE = Path(__file__).parents[4] / "docs" / "how_to" / "sessions.md"
ARM_JOINTS = ("axis_e", "axis_d", "axis_c", "axis_b", "axis_a")
ELBOW = 1


@pytest.fixture(scope="module")
def armed(tmp_path_factory):
    """A session of the three robots, without the ball."""
    begin, end = SCENARIO.index("[[world.obstacles"), SCENARIO.index("[[fleet]]")
    text = SCENARIO[:begin] + SCENARIO[end:]
    return BatchSession(write_scenario(tmp_path_factory.mktemp("free"), text))


@pytest.fixture
def session(armed):
    armed.reset()
    return armed


def target(session, change, joint=ELBOW):
    """The home posture, a joint of it moved."""
    position = np.asarray(session.observe().estimate.joints.position)[ARM].copy()
    position[joint] += change
    still = np.zeros(len(ARM_JOINTS))
    return JointTarget(position=position, velocity=still, acceleration=still)


def here(session, robot=ARM):
    seen = session.observe().estimate
    pose = [*np.asarray(seen.p)[robot], 0.0]
    return np.append(pose, [] if robot == RIGID else np.asarray(seen.joints.position)[robot])


def trajectory(session, joints=VEHICLE_JOINTS + ARM_JOINTS, change=0.4, robot=ARM):
    """From where the robot is, the elbow moved within two seconds."""
    position = np.tile(here(session, robot), (2, 1))[:, : len(joints)]
    position = np.pad(position, [(0, 0), (0, len(joints) - position.shape[1])])
    position[1, 5:6] += change
    return JointTrajectory(
        joints=joints,
        time_s=np.array([0.0, 2.0]),
        position=position,
        velocity=np.zeros(position.shape),
        acceleration=np.zeros(position.shape),
        degree=np.full(2, LINEAR),
        commanded=np.ones(len(joints), bool),
    )


def run(session, seconds, commands=None):
    seen = session.step(commands)
    for _ in range(round(seconds / session.dt_s) - 1):
        seen = session.step()
    return seen


def elbow(seen, robot=ARM):
    return float(np.asarray(seen.estimate.joints.position)[robot, ELBOW])


def test_robots_say_what_joints_they_have(session):
    with_arm, _, rigid = session.robots
    assert with_arm.joints == ARM_JOINTS
    assert rigid.joints == ()
    assert {JointTarget, WholeBodyCommand} <= set(with_arm.accepts)
    assert not {JointTarget, WholeBodyCommand} & set(rigid.accepts)


def test_joints_are_observed_of_robots_that_have_any(session):
    seen = session.observe()
    assert np.isfinite(seen.truth.joints.position[ARM]).all()
    assert np.isnan(seen.estimate.joints.position[RIGID]).all()
    assert np.isnan(seen.estimate.joints.velocity[RIGID]).all()


def test_a_target_moves_the_joints_and_leaves_the_plan(session):
    begin = elbow(session.observe())
    seen = run(session, 4.0, {ARM: target(session, 0.4)})
    assert seen.status[ARM].command == "plan"
    assert seen.status[ARM].refused == ""
    assert elbow(seen) == pytest.approx(begin + 0.4, abs=0.02)
    assert np.asarray(seen.estimate.p)[ARM, 0] > -0.9


def test_the_example_of_the_page_moves_a_joint(session, monkeypatch):
    monkeypatch.setattr(angler, "BatchSession", lambda _: session)
    blocks = re.findall(r"(?ms)^```python\n(.*?)^```", PAGE.read_text())
    (example,) = [block for block in blocks if "JointTarget" in block]
    names = {"np": np, "angler": angler}
    exec(example, names)
    assert elbow(names["seen"]) == pytest.approx(names["position"][ELBOW], abs=0.02)
    assert names["seen"].status[ARM].command == "plan"


def test_trajectories_of_files_move_joints_by_name(session, tmp_path):
    begin = elbow(session.observe())
    point = JointPoint(time_s=2.0, positions=(begin + 0.3, 0.01))
    goals = {ARM: JointGoal(joint_names=("axis_d", "axis_a"), points=(point,))}
    joint_trajectory_file.write_trajectories(tmp_path / "plan.json", goals)
    read = joint_trajectory_file.read_trajectories(tmp_path / "plan.json", robots=3)
    assert read == goals
    assert elbow(run(session, 4.0, read)) == pytest.approx(begin + 0.3, abs=0.02)
    wrong = JointGoal(joint_names=("wrist",), points=(replace(point, positions=(0.0,)),))
    with pytest.raises(ConfigError, match=r"'wrist' is no joint of this robot; have .* axis_a"):
        session.check(ARM, wrong)


def test_joints_hold_beside_the_next_command_of_the_base(session):
    begin = elbow(session.observe())
    twist = BodyTwist(nu=np.array([0.1, 0, 0, 0, 0, 0]))
    both = WholeBodyCommand(base=twist, joints=target(session, 0.4))
    seen = run(session, 4.0, {ARM: both})
    assert seen.status[ARM].command == "WholeBodyCommand"
    assert elbow(seen) == pytest.approx(begin + 0.4, abs=0.02)
    seen = run(session, 1.0, {ARM: twist})
    assert elbow(seen) == pytest.approx(begin + 0.4, abs=0.02)


def test_a_target_beyond_limits_is_clipped_and_counted(session):
    run(session, 1.0, {ARM: target(session, 99.0)})
    clipped = np.asarray(session.inside().state.carry.joints_clipped)[0]
    assert clipped[ARM] > 0
    assert clipped[RIGID] == 0


def test_a_trajectory_moves_all_joints(session):
    begin = elbow(session.observe())
    seen = run(session, 4.0, {ARM: trajectory(session)})
    assert seen.status[ARM].refused == ""
    assert seen.status[ARM].note == "SUCCESSFUL"
    assert elbow(seen) == pytest.approx(begin + 0.4, abs=0.02)


def test_a_trajectory_of_the_vehicle_leaves_its_joints(session):
    begin = elbow(session.observe())
    run(session, 3.0, {ARM: target(session, 0.4)})
    seen = run(session, 4.0, {ARM: trajectory(session, VEHICLE_JOINTS)})
    assert seen.status[ARM].note == "SUCCESSFUL"
    assert elbow(seen) == pytest.approx(begin + 0.4, abs=0.02)
    assert run(session, 0.1, {RIGID: trajectory(session, VEHICLE_JOINTS, robot=RIGID)})


def test_a_target_takes_the_joints_from_a_trajectory(session):
    begin = elbow(session.observe())
    run(session, 0.2, {ARM: trajectory(session)})
    seen = run(session, 4.0, {ARM: target(session, -0.1)})
    assert seen.status[ARM].command == "JointTrajectory"
    assert seen.status[ARM].note == "SUCCESSFUL"
    assert elbow(seen) < begin


def test_a_message_names_some_joints(session):
    begin = elbow(session.observe())
    point = JointPoint(time_s=2.0, positions=(begin + 0.4,))
    goal = JointGoal(joint_names=("axis_d",), points=(point,))
    run(session, 0.1, {ARM: target(session, 0.01, joint=4)})
    seen = run(session, 4.0, {ARM: goal})
    assert seen.status[ARM].note == "SUCCESSFUL"
    assert elbow(seen) == pytest.approx(begin + 0.4, abs=0.02)
    target_m = np.asarray(session.inside().state.carry.joints.position)[0, ARM, 4]
    assert target_m == pytest.approx(0.01, abs=1e-5)


def test_a_trajectory_begins_where_the_joints_were_commanded(session):
    begin = elbow(session.observe())
    run(session, 3.0, {ARM: target(session, 0.3)})
    session.step({ARM: trajectory(session, change=-0.3)})
    commanded = np.asarray(session.inside().state.carry.joints.position)[0, ARM]
    assert commanded[ELBOW] == pytest.approx(begin + 0.3, abs=0.01)


FAULTS = {
    "a joint that it lacks": (ARM, (*ARM_JOINTS, "wrist"), "'wrist' is no joint of this robot"),
    "some are missing": (ARM, ARM_JOINTS[:3], "'axis_b' is missing"),
    "another order": (ARM, ARM_JOINTS[::-1], "have another order"),
    "a rigid vehicle": (RIGID, ARM_JOINTS, "'axis_e' is no joint of this robot"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_trajectories_of_other_joints_are_refused_by_name(session, fault):
    robot, joints, message = FAULTS[fault]
    order = trajectory(session, VEHICLE_JOINTS + joints, robot=robot)
    with pytest.raises(ConfigError, match=f"robot_{robot}: JointTrajectory refused") as refused:
        session.check(robot, order)
    assert message in str(refused.value)
    status = session.step({robot: order}).status[robot]
    assert message in status.refused
    assert status.command == "hold"


def test_messages_of_other_joints_are_refused_by_name(session):
    goal = JointGoal(joint_names=("axis_d",), points=(JointPoint(time_s=2.0, positions=(0.5,)),))
    with pytest.raises(ConfigError, match="'axis_d' is no joint of this robot; have x, y, z, yaw"):
        session.check(RIGID, goal)


def test_motions_of_joints_are_refused_where_they_do_not_fit(session):
    good = target(session, 0.0)
    with pytest.raises(ConfigError, match="takes no JointTarget: bluerov2_heavy has no joints"):
        session.check(RIGID, good)
    short = replace(good, position=np.zeros(4))
    with pytest.raises(ConfigError, match=r"position: has the shape \(4,\), must be \(5,\)"):
        session.check(ARM, short)
    nested = WholeBodyCommand(base=good, joints=good)
    with pytest.raises(ConfigError, match="base: takes no JointTarget"):
        session.check(ARM, nested)
    pose = PoseTarget(
        position_m=np.full(3, np.nan), velocity_mps=np.zeros(3), yaw_rad=np.array(0.0)
    )
    with pytest.raises(ConfigError, match=r"position_m\[0\] = nan"):
        session.check(ARM, WholeBodyCommand(base=pose, joints=good))


def test_tolerances_of_the_vehicle_alone_do_not_judge_joints(armed_scenario):
    allowed = build_tolerances(VEHICLE_JOINTS, default_path=JointTolerance(position=0.5))
    limits = stack_tolerances(allowed, armed_scenario).path.position
    assert limits.shape == (3, 9)
    np.testing.assert_array_equal(limits[ARM], [0.5] * 4 + [np.inf] * 5)
    assert stack_tolerances(None, armed_scenario).path.position.shape == (3, 9)


def test_a_plan_with_joints_is_joined_at_its_joints():
    joints = VEHICLE_JOINTS + ARM_JOINTS
    rows = np.zeros((3, 9))
    rows[:, 5] = [0.0, 1.0, 2.0]
    plan = RobotPlan.of(
        JointTrajectory(
            joints=joints,
            time_s=np.array([0.0, 10.0, 20.0]),
            position=rows,
            velocity=np.zeros((3, 9)),
            acceleration=np.zeros((3, 9)),
            degree=np.full(3, LINEAR),
            commanded=np.ones(9, bool),
        )
    )
    detour = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]])
    back = plan.after(detour, np.array([0.0, 2.0]), 5.0, 0.0, np.full(5, 0.2)).motion
    assert back.joints == joints
    np.testing.assert_allclose(back.position[:, 5], [0.2, 0.5, 1.0, 2.0])
    np.testing.assert_allclose(back.position[0, 4:], 0.2)


def test_problems_in_flight_start_from_the_present_postures(session):
    """Of sessions and of replanning alike; before, from those at home."""
    stretched = target(session, 1.0)
    run(session, 3.0, {ARM: stretched})
    seen = np.asarray(session.observe().estimate.joints.position)
    assert seen[ARM, ELBOW] == pytest.approx(stretched.position[ELBOW], abs=0.05)
    problem = build_session_problem(session)
    np.testing.assert_allclose(problem.team.arms.joint_position[ARM], seen[ARM], atol=1e-6)
    assert np.isfinite(problem.team.capsule_a_m).all()

    internals = session.inside()
    world, vehicles, obstacles = jax.tree.map(
        lambda leaf: leaf[0],
        (internals.worlds, internals.state.vehicles, internals.state.obstacles),
    )
    spec, problems = internals.simulator.spec, []
    context = WorldContext(
        spec=spec,
        policy=Online(information=Information()),
        world=world,
        number=jnp.int32(60),
        vehicles=vehicles,
        obstacles=obstacles,
    )
    inputs = context.build_policy_input(None)

    def keep(problem):
        problems.append(problem)
        return hold_position(problem.team.start_m, 32)

    settings = Replanning(
        planner=keep,
        every=20,
        delay=0,
        dt_s=session.dt_s,
        problem=problem_settings(internals.simulator.scenario, Information()),
    )
    clocks = guidance.initial_clocks(inputs.belief.q)
    plans = replanning.initial_plans(settings, inputs)
    replanning.replan(settings, plans, clocks, inputs, jax.random.key(0))
    for leaf in ("capsule_a_m", "capsule_b_m", "radius_m"):
        np.testing.assert_allclose(
            getattr(problems[0].team, leaf), getattr(problem.team, leaf), atol=1e-5
        )
    np.testing.assert_allclose(problems[0].team.arms.joint_position[ARM], seen[ARM], atol=1e-6)
