"""Sessions of a robot with an arm: the autopilot steers its thrusters, and joints follow ours."""

from contextlib import contextmanager

import numpy as np
import pytest

from angler_mjx.report.interop import mcap
from angler_mjx.robot.control.commands import BodyTwist, PoseTarget
from angler_mjx.robot.control.commands.whole_body import (
    EndEffectorTarget,
    JointTarget,
    WholeBodyCommand,
)
from angler_mjx.runs.storage.folder import Run
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.state import Outcome
from angler_mjx.testing import referee
from angler_sitl.missions import mission
from angler_sitl.missions.mission import MissionSettings
from angler_sitl.session import SitlSession

START, GOAL = (0.0, 0.0, -10.0), (2.0, 0.0, -10.0)
SCENARIO = {
    "name": "armed",
    "engine": "mjx",
    "goal_tolerance_m": 0.05,
    "time": {"horizon_s": 60.0, "record_hz": 10.0},
    "world": {"preset": "open", "placement": "given", "start_m": [START], "goal_m": [GOAL]},
    "task": {"type": "goal", "reached_by": "end_effector"},
    "controller": {"name": "arm"},
    "fleet": [{"vehicle": "bluerov2_heavy_alpha5", "parameter_set": "wu2018"}],
}


@pytest.fixture(scope="module")
def scenario():
    return Scenario.model_validate(SCENARIO)


@pytest.fixture(scope="module")
def session(scenario, stand_in):
    with SitlSession(scenario, binary=stand_in.path) as opened:
        yield opened


def joints_of(session):
    """Positions [J] of the joints, and their servos' targets."""
    state = session.inside().state
    return (
        np.asarray(state.vehicles.joints.position)[0, 0],
        np.asarray(state.carry.joints.position)[0, 0],
    )


def hold(joints):
    """The base stays at its start; joints go to these positions."""
    position = np.asarray(joints, np.float32)
    still = np.zeros_like(position)
    base = PoseTarget(
        position_m=np.array(START, np.float32),
        velocity_mps=np.zeros(3, np.float32),
        yaw_rad=np.float32(0.0),
    )
    joints = JointTarget(position=position, velocity=still, acceleration=still)
    return WholeBodyCommand(base=base, joints=joints)


def run(session, seconds, command=None):
    observation = session.step(None if command is None else {0: command})
    for _ in range(round(seconds / session.dt_s) - 1):
        observation = session.step()
    return observation


def test_joints_follow_their_targets_and_stay_under_commands_to_the_base(session):
    session.reset()
    home, _ = joints_of(session)
    wanted = home + np.array([0.0, 0.5, 0.3, 0.4, 0.0])
    observation = run(session, 3.0, hold(wanted))
    assert observation.status[0].command == WholeBodyCommand.__name__
    assert observation.status[0].refused == ""
    there, target = joints_of(session)
    np.testing.assert_allclose(target, wanted, atol=1e-6)
    np.testing.assert_allclose(there, wanted, atol=0.05)  # servos give way to weight
    run(session, 0.5, hold(wanted).base)
    np.testing.assert_allclose(joints_of(session)[1], wanted, atol=1e-6)
    sample = session.inside().sample
    np.testing.assert_allclose(np.asarray(sample.joints.position)[0, 0], there, atol=0.05)


def test_a_command_beyond_limits_is_clipped_and_counted(session):
    session.reset()
    home, _ = joints_of(session)
    run(session, 0.5, hold(home + 100.0))
    upper = np.asarray(session.inside().worlds.control.vehicle.links.upper)[0, 0]
    np.testing.assert_allclose(joints_of(session)[1], upper, atol=1e-6)
    assert int(session.inside().state.carry.joints_clipped[0, 0]) == 10


@pytest.mark.parametrize(
    ("joints", "fault"),
    [(np.zeros(3), "shape (3,), must be (5,)"), (np.full(5, np.nan), "must be a finite number")],
)
def test_a_wrong_command_to_joints_is_refused(session, joints, fault):
    session.reset()
    refused = session.step({0: hold(joints)}).status[0].refused
    assert refused.startswith("robot_0: WholeBodyCommand refused")
    assert fault in refused
    assert np.isfinite(joints_of(session)[0]).all()
    session.step({0: hold(joints_of(session)[0])})
    assert session.observe().status[0].refused == ""


def test_levels_take_commands_to_the_arm(session):
    accepted = session.robots[0].accepts
    assert {EndEffectorTarget, WholeBodyCommand, BodyTwist} < set(accepted)


def test_a_target_of_the_end_effector_moves_the_arm_and_the_base(session):
    session.reset()
    _, before = joints_of(session)
    target = EndEffectorTarget(
        position_m=np.array([1.2, 0.1, -10.3], np.float32),
        q=np.array([1, 0, 0, 0], np.float32),
        velocity_mps=np.zeros(3, np.float32),
        angular_velocity_radps=np.zeros(3, np.float32),
        is_oriented=np.bool_(False),
    )
    seen = run(session, 2.0, target)
    assert seen.status[0].command == EndEffectorTarget.__name__
    assert np.abs(joints_of(session)[1] - before).max() > 0.1
    assert np.linalg.norm(np.asarray(seen.target_m)[0] - START) > 0.05


class Unwatched:
    """Stands where the live table does."""

    @contextmanager
    def __call__(self, session):
        yield self

    def after(self, observation):
        pass


@pytest.mark.sitl
def test_an_arm_reaches_beside_a_real_ardusub(ardusub, scenario, tmp_path):
    settings = MissionSettings(out=tmp_path / "run", binary=ardusub.path)
    flight, made = mission.run_mission(scenario, settings, lambda _: None, Unwatched())
    assert flight.last.status[0].outcome is Outcome.REACHED
    stored = Run(made.path)
    joints = np.asarray(stored.trajectories["joint_position"])[0, :, 0]
    assert np.isfinite(joints).all()
    assert np.ptp(joints, axis=0).max() > 0.2
    verdict = referee.judge(stored.path)
    assert [difference.format_line() for difference in verdict.differences] == []
    mcap.export_bag(stored, tmp_path / "out.mcap", [0])
