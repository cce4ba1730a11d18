"""Sessions of robots that hold a body: steps, observations, commands, reset."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from angler_mjx.robot.control.commands import PoseTarget
from angler_mjx.runs.session.batch_session import BatchSession
from angler_mjx.runs.session.online_policy import build_session_problem
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.sim.state import Outcome

TO_M, TURN_DEG = np.array([-1.0, -2.0, -6.5]), 20.0


@pytest.fixture(scope="module")
def session():
    task = {
        "type": "carry",
        "offset_m": [0.0, 0.0, 0.4],
        "to_m": TO_M.tolist(),
        "turn_deg": TURN_DEG,
        "break_force_n": 60.0,
    }
    time = {"horizon_s": 60.0, "record_hz": 0.0, "physics_dt_s": 0.01}
    return BatchSession(load_scenario("carry_pipe", task=task, time=time))


def body(observation):
    """Return position and attitude of the pipe."""
    row = observation.cargo.obstacle
    scene = observation.obstacles
    return scene.position_m[row], Rotation.from_quat(scene.attitude[row], scalar_first=True)


def test_left_alone_robots_bring_the_body_to_its_goal(session):
    begin = session.reset()
    start_m, start = body(begin)
    np.testing.assert_allclose(start_m, [-1.0, -3.0, -6.0], atol=1e-6)
    assert begin.cargo.held.all()
    np.testing.assert_array_equal(begin.cargo.reading.wrench, 0.0)
    np.testing.assert_allclose(
        begin.cargo.distance_m, np.linalg.norm(TO_M - [-1.0, -3.0, -6.0]), rtol=1e-5
    )
    np.testing.assert_allclose(begin.cargo.angle_rad, np.radians(TURN_DEG), rtol=1e-4)
    problem = build_session_problem(session).cargo
    np.testing.assert_allclose(problem.turn_rad, np.radians(TURN_DEG), rtol=1e-5)
    for _ in range(round(40.0 / session.dt_s)):
        now = session.step()
        if all(one.outcome is not Outcome.RUNNING for one in now.status):
            break
    assert [one.outcome for one in now.status] == [Outcome.REACHED] * 2
    problem = build_session_problem(session).cargo
    np.testing.assert_array_equal(problem.start_m, body(now)[0])
    assert abs(problem.turn_rad) < np.radians(5.0)
    end_m, end = body(now)
    assert np.linalg.norm(end_m - TO_M) < 0.1
    wanted = Rotation.from_euler("z", TURN_DEG, degrees=True) * start
    assert (wanted.inv() * end).magnitude() < np.radians(5.0)
    # Each robot bears half of 16 N at rest, and forces are in its own frame.
    turn = Rotation.from_quat(np.asarray(now.truth.q), scalar_first=True)
    weight = turn.apply(np.asarray(now.cargo.reading.wrench)[:, :3])
    assert np.all(weight[:, 2] < -4.0)
    assert np.all(weight[:, 2] > -12.0)


def test_commands_move_robots_and_the_body_with_them(session):
    begin = session.reset()
    start_m, _ = body(begin)
    shift = np.array([0.5, 0.0, 0.0])
    commands = {
        robot: PoseTarget(
            position_m=np.asarray(begin.truth.p[robot]) + shift,
            velocity_mps=np.zeros(3),
            yaw_rad=np.float32(begin_yaw(begin, robot)),
        )
        for robot in range(2)
    }
    now = session.step(commands)
    assert not any(one.refused for one in now.status)
    for _ in range(round(15.0 / session.dt_s)):
        now = session.step()
    end_m, _ = body(now)
    np.testing.assert_allclose(end_m - start_m, shift, atol=0.1)
    assert now.cargo.held.all()


def test_robots_that_pull_apart_lose_the_body_and_a_reset_gives_it_back(session):
    begin = session.reset()
    away = np.array([3.0, 0.0, 0.0])
    sides = np.sign(np.asarray(begin.truth.p)[:, 0] - body(begin)[0][0])
    commands = {
        robot: PoseTarget(
            position_m=np.asarray(begin.truth.p[robot]) + side * away,
            velocity_mps=np.zeros(3),
            yaw_rad=np.float32(begin_yaw(begin, robot)),
        )
        for robot, side in enumerate(sides)
    }
    now = session.step(commands)
    for _ in range(round(20.0 / session.dt_s)):
        now = session.step()
    assert Outcome.DROPPED in [one.outcome for one in now.status]
    assert not now.cargo.held.all()
    again = session.reset()
    assert again.cargo.held.all()
    np.testing.assert_array_equal(body(again)[0], body(begin)[0])
    np.testing.assert_array_equal(again.truth.p, begin.truth.p)


def begin_yaw(observation, robot):
    """Return the heading of a robot, rad."""
    turn = Rotation.from_quat(np.asarray(observation.truth.q[robot]), scalar_first=True)
    return turn.as_euler("ZYX")[0]
