"""Grippers that begin open, close at a body that lies on the sea floor, and lift it."""

from dataclasses import replace
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from angler_mjx.errors import ConfigError
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.sim.cargo import (
    ApproachSpec,
    CargoSpec,
    close_grips,
    find_grip_speeds,
    open_grips,
)
from angler_mjx.sim.physics.contact.grips import GripSpec, take_hold
from angler_mjx.sim.state import Outcome

APPROACH = ApproachSpec(
    above_m=1.0, within_m=0.05, within_rad=0.1, within_mps=0.02, wait_s=1.0, lift_m=0.0
)
BODY = Rotation.from_rotvec([0.1, -0.2, 0.7])
BODY_M = np.array([1.0, -2.0, -5.0])
HOLD_M = np.array([[0.8, 0.1, 0.4], [-0.8, 0.0, 0.4]])


def hold(positions_m, turns, body_m=BODY_M, body=BODY):
    """Return grips of robots at these poses."""
    q = jnp.asarray([turn.as_quat(scalar_first=True) for turn in turns], jnp.float32)
    body_q = jnp.asarray(body.as_quat(scalar_first=True)[None], jnp.float32)
    return take_hold(
        GripSpec(body=0),
        jnp.asarray(positions_m, jnp.float32),
        q,
        jnp.asarray(body_m[None], jnp.float32),
        body_q,
    )


WANTED = open_grips(hold(BODY_M + HOLD_M, [Rotation.identity()] * 2))
BOTH = jnp.ones(2, bool)
STILL = jnp.zeros(2)


def test_a_gripper_closes_where_it_is_when_it_is_near():
    assert not WANTED.held.any()
    at_m = BODY_M + HOLD_M + [[0.0, 0.03, 0.03], [0.0, 0.0, 0.06]]
    now = hold(at_m, [Rotation.identity()] * 2)
    closed = close_grips(APPROACH, WANTED, now, STILL, BOTH, jnp.float32(3.0))
    assert closed.held.tolist() == [True, False]
    assert closed.closed_s.tolist() == [3.0, np.inf]
    # In the body's frame, where the robot is and not where it was to be.
    wanted = BODY.inv().apply(at_m[0] - BODY_M)
    np.testing.assert_allclose(closed.position_m[0], wanted, atol=1e-5)
    np.testing.assert_array_equal(closed.position_m[1], WANTED.position_m[1])


def test_it_is_the_pose_in_the_frame_of_the_body_that_counts():
    """The body has moved and turned, one robot with it, and the other has stayed."""
    turn, shift = Rotation.from_rotvec([0.0, 0.0, 0.4]), np.array([0.5, 0.0, 0.2])
    body_m = BODY_M + shift
    at_m = np.stack([body_m + turn.apply(HOLD_M[0]), BODY_M + HOLD_M[1]])
    now = hold(at_m, [turn, Rotation.identity()], body_m, turn * BODY)
    closed = close_grips(APPROACH, WANTED, now, STILL, BOTH, jnp.float32(3.0))
    assert closed.held.tolist() == [True, False]


def test_an_attitude_that_is_off_keeps_it_open():
    turns = [Rotation.from_rotvec([0.0, 0.09, 0.0]), Rotation.from_rotvec([0.0, 0.0, 0.11])]
    now = hold(BODY_M + HOLD_M, turns)
    closed = close_grips(APPROACH, WANTED, now, STILL, BOTH, jnp.float32(3.0))
    assert closed.held.tolist() == [True, False]


def test_a_gripper_that_moves_against_the_body_stays_open():
    now = hold(BODY_M + HOLD_M, [Rotation.identity()] * 2)
    speed = jnp.array([0.019, 0.021])
    closed = close_grips(APPROACH, WANTED, now, speed, BOTH, jnp.float32(3.0))
    assert closed.held.tolist() == [True, False]


def test_speeds_are_those_of_the_gripper_against_its_point_of_the_body():
    turns = [Rotation.from_rotvec([0.0, 0.3, 1.0]), Rotation.identity()]
    at_m, lever_m = BODY_M + HOLD_M, np.array([[0.2, 0.0, -0.4], [0.0, 0.0, 0.0]])
    tips = np.stack([p + turn.apply(r) for p, turn, r in zip(at_m, turns, lever_m, strict=True)])
    linear, spin = np.array([0.1, 0.0, -0.2]), np.array([0.3, -0.1, 0.2])
    body_v = linear + np.cross(spin, tips - BODY_M)
    # The first robot's gripper moves with the body while it turns; the second's is at rest.
    turning = np.array([0.0, 0.5, 0.0])
    own = turns[0].inv().apply(body_v[0]) - np.cross(turning, lever_m[0])
    nu = np.array([[*own, *turning], np.zeros(6)])
    body_nu = np.concatenate([BODY.inv().apply(linear), BODY.inv().apply(spin)])
    vehicles, bodies = SimpleNamespace(), SimpleNamespace()
    vehicles.p, vehicles.nu = jnp.asarray(at_m), jnp.asarray(nu)
    vehicles.q = jnp.asarray([turn.as_quat(scalar_first=True) for turn in turns])
    bodies.p, bodies.nu = jnp.asarray(BODY_M[None]), jnp.asarray(body_nu[None])
    bodies.q = jnp.asarray(BODY.as_quat(scalar_first=True)[None])
    spec = CargoSpec(
        body=0, goal_m=(0.0, 0.0, 0.0), turn_rad=0.0, tolerance_m=0.1, tolerance_rad=0.1
    )
    speed = find_grip_speeds(spec, vehicles, jnp.asarray(lever_m), bodies)
    np.testing.assert_allclose(speed, [0.0, np.linalg.norm(body_v[1])], atol=2e-6)


def test_it_closes_once_and_for_robots_on_their_way():
    now = hold(BODY_M + HOLD_M, [Rotation.identity()] * 2)
    closed = close_grips(APPROACH, WANTED, now, STILL, jnp.array([True, False]), jnp.float32(3.0))
    assert closed.held.tolist() == [True, False]
    opened = replace(closed, held=jnp.zeros(2, bool))
    again = close_grips(APPROACH, opened, now, STILL, BOTH, jnp.float32(4.0))
    assert again.held.tolist() == [False, True]
    assert again.closed_s.tolist() == [3.0, 4.0]


FLOOR_M, PIPE_M = -11.0, np.array([-1.0, -1.0, -10.95])
GOAL_M = np.array([0.0, -1.0, -8.0])
PIPE = {
    "type": "capsule",
    "position_m": PIPE_M.tolist(),
    "rpy_deg": [0.0, 90.0, 0.0],
    "radius_m": 0.05,
    "length_m": 2.4,
    "mass_kg": 21.0,
    "motion": {"type": "drift"},
}


def scenario(**task):
    """Return a flight of two robots that fetch a pipe from the sea floor."""
    return load_scenario(
        "carry_pipe",
        worlds=1,
        tile=1,
        time={"horizon_s": 40.0, "record_hz": 0.0, "physics_dt_s": 0.01},
        world={"obstacles": {"explicit": [PIPE]}},
        task={
            "to_m": GOAL_M.tolist(),
            "turn_deg": 0.0,
            "approach": {"above_m": 1.0, "lift_m": 2.5, "wait_s": 3.0},
            **task,
        },
    )


@pytest.fixture(scope="module")
def simulator():
    return Simulator(scenario())


@pytest.fixture(scope="module")
def worlds(simulator):
    return simulator.worlds()


def test_plans_go_to_the_body_lift_it_and_keep_to_the_cruise_speed(worlds):
    path = worlds.path
    assert np.all(path.found)
    position, time_s = np.asarray(path.position[0]), np.asarray(path.time_s[0])
    start_m = np.array([[1.2, 0, 1.4], [-1.2, 0, 1.4]])
    order = np.argsort(position[:, 0, 0])[::-1]
    np.testing.assert_allclose(position[order, 0, :3], PIPE_M + start_m, atol=0.06)
    up = np.array([0.0, 0.0, 1.0])
    held_m = position[:, 0, :3] - up
    np.testing.assert_allclose(position[:, 1, :3], held_m, atol=1e-5)
    np.testing.assert_allclose(position[:, 2, :3], held_m, atol=1e-5)
    assert np.all(time_s[:, 2] - time_s[:, 1] >= 3.0)
    np.testing.assert_allclose(position[:, 3, :3], held_m + 2.5 * up, atol=1e-5)
    np.testing.assert_allclose(position[:, -1, :3], held_m + GOAL_M - PIPE_M, atol=1e-4)
    assert np.all(np.diff(time_s, axis=1) > 0.0)
    # Rest at the ends of the first legs; cubics between them are at most 1.5 times as fast.
    np.testing.assert_array_equal(np.asarray(path.velocity[0])[:, :4], 0.0)
    legs = np.linalg.norm(np.diff(position[:, :4, :3], axis=1), axis=2)
    assert np.max(1.5 * legs / np.diff(time_s[:, :4], axis=1)) <= 0.4


def test_robots_fetch_a_pipe_from_the_sea_floor(simulator, worlds):
    state = simulator.reset(worlds)
    assert not state.grips.held.any()
    heights, held, segments = [], [], simulator.segments
    for _ in range(segments):
        state, _ = simulator.segment(worlds, state)
        heights.append(float(state.obstacles.p[0, 0, 2]))
        held.append(np.asarray(state.grips.held[0]).copy())
    assert np.all(np.asarray(state.tally.outcome) == Outcome.REACHED)
    closed_s = np.asarray(state.grips.closed_s[0])
    # The way down takes 3.85 s; the last centimetres are slow.
    assert np.all((closed_s > 2.5) & (closed_s < 7.5))
    assert np.all(held[-1])
    np.testing.assert_allclose(heights[-1], GOAL_M[2], atol=0.1)
    assert np.all(np.asarray(state.tally.grip_force_n) < 120.0)


def test_the_approach_is_part_of_the_problem_and_old_digests_stay():
    plain = load_scenario("carry_pipe")
    assert load_scenario("carry_pipe", task={"approach": None}).digest() == plain.digest()
    assert load_scenario("carry_pipe", task={"approach": {}}).digest() != plain.digest()


def test_a_body_below_the_start_is_no_approach():
    with pytest.raises(ConfigError, match="above_m"):
        scenario(approach={"above_m": -1.0})
