"""Flights of plans that are looked after: late robots, and obstacles that no plan knew of."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import angler_mjx as angler
from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.runs.session.batch_session import BatchSession
from angler_mjx.runs.session.online_policy import OnlineFlyer, build_session_problem
from angler_mjx.runs.simulator import scenario_policy
from angler_mjx.runs.storage import device_to_host
from angler_mjx.sim import policy as policies
from angler_mjx.sim.information import Information
from angler_mjx.sim.state import Outcome

SCENARIO = """
name = "crossing"
engine = "fused"
worlds = 1
tile = 1

[time]
horizon_s = 30.0
record_hz = 5.0

[world]
preset = "open"
shape = [10, 10, 4]
depth_m = 2.0
placement = "given"
start_m = [[-5.0, 0.0, -6.0], [0.0, -5.0, -4.0]]
goal_m = [[5.0, 0.0, -6.0], [0.0, 5.0, -4.0]]

[[world.currents]]
type = "uniform"
velocity_mps = [0.0, -0.15, 0.0]

[[world.obstacles.explicit]]
type = "sphere"
radius_m = 0.7
position_m = [0.0, 1.6, -6.0]
motion = {type = "drift"}

[[fleet]]
vehicle = "bluerov2_heavy"
count = 2
"""
"""The sphere is on the first robot's line when the robot is."""

REPLANNED = {"replan_hz": 1.0, "delay_s": 0.25, "information": {"obstacles": "observed"}}


@pytest.fixture(scope="module")
def load(tmp_path_factory):
    file = tmp_path_factory.mktemp("online") / "crossing.toml"
    file.write_text(SCENARIO)
    return lambda **changes: angler.load_scenario(file, **changes)


@pytest.fixture(scope="module")
def free(load):
    return angler.Simulator(load())


@pytest.fixture(scope="module")
def kept(load):
    return angler.Simulator(load(execution={"order": "kept"}))


@pytest.fixture(scope="module")
def replanned(load):
    return angler.Simulator(load(planner=REPLANNED))


def fly(simulator, worlds):
    """The last state, and places of robots and obstacles [samples, ...]."""
    state, robots, obstacles = simulator.reset(worlds), [], []
    for _ in range(simulator.segments):
        state, seen = simulator.segment(worlds, state)
        robots.append(np.asarray(seen.p)[0])
        obstacles.append(np.asarray(seen.obstacle_p)[0])
    return state, np.concatenate(robots), np.concatenate(obstacles)


def outcomes(state):
    return [Outcome(x) for x in np.asarray(state.tally.outcome)[0]]


def late(simulator):
    """Worlds in which the first robot is to fly at 3 m/s, which it cannot.

    By its plan it passes the crossing 1.7 s from the start, in truth when the second one does.
    """
    worlds = simulator.worlds()
    place, rows = worlds.environment, simulator.paths.points
    start = jnp.array([[[-5.0, 0.0, -4.0], [0.0, -3.6, -4.0]]])
    goal = jnp.array([[[5.0, 0.0, -4.0], [0.0, 5.0, -4.0]]])
    time = np.repeat(np.array([[[10 / 3], [8.6 / 0.5]]], np.float32), rows, axis=2)
    time[..., 0] = 0.0
    points = np.repeat(np.asarray(goal)[:, :, None], rows, axis=2)
    points[:, :, 0] = start
    path = Trajectory(time_s=time, position_m=points, found=np.ones((1, 2), bool))
    there = replace(worlds, environment=replace(place, start_m=start, goal_m=goal))
    return simulator.with_paths(there, path)


def gap(robots):
    return np.linalg.norm(robots[:, 0] - robots[:, 1], axis=-1)


@pytest.mark.nightly(by="test_robots_that_keep_their_order_do_not_meet, which meet without")
def test_robots_meet_where_one_is_late_and_nobody_waits(free):
    state, robots, _ = fly(free, late(free))
    assert outcomes(state) == [Outcome.COLLISION_ROBOT] * 2
    assert gap(robots).min() < 0.7


def test_robots_that_keep_their_order_do_not_meet(kept):
    worlds = late(kept)
    state, robots, _ = fly(kept, worlds)
    assert outcomes(state) == [Outcome.REACHED] * 2
    assert np.asarray(state.tally.min_separation_m).min() > 0.1
    radii = np.asarray(kept.add_parameters(worlds).control.vehicle.radius_m)[0]
    assert gap(robots).min() > radii.sum()
    # The second one stood before the crossing, and came last.
    assert np.asarray(state.tally.end_time_s)[0, 1] > 8.6 / 0.5 + 1.0


def blind(simulator):
    """Worlds whose robots are told to go straight at 0.5 m/s: plans that know no obstacle."""
    worlds = simulator.worlds()
    start, goal = worlds.environment.start_m, worlds.environment.goal_m
    rows = simulator.paths.points
    points = np.repeat(np.asarray(goal)[:, :, None], rows, axis=2)
    points[:, :, 0] = start
    time = np.full((1, 2, rows), 20.0, np.float32)  # 10 m
    time[..., 0] = 0.0
    path = Trajectory(time_s=time, position_m=points, found=np.ones((1, 2), bool))
    return simulator.with_paths(worlds, path)


@pytest.mark.nightly(by="test_an_obstacle_that_drifts_into_a_plan_is_planned_around")
def test_an_obstacle_that_drifts_into_a_plan_is_hit_without_another(free):
    state, _, _ = fly(free, blind(free))
    assert outcomes(state)[0] is Outcome.COLLISION_DYNAMIC


def test_an_obstacle_that_drifts_into_a_plan_is_planned_around(replanned):
    worlds = blind(replanned)
    state, robots, bodies = fly(replanned, worlds)
    assert outcomes(state) == [Outcome.REACHED] * 2
    vehicle = replanned.add_parameters(worlds).control.vehicle
    radius = float(np.asarray(vehicle.radius_m)[0, 0])
    assert np.linalg.norm(robots[:, 0] - bodies[:, 0], axis=-1).min() > radius + 0.7
    # The plan that it was given leads through: at its times it comes nearer than the two may be.
    times = np.arange(len(bodies))[:, None] / 5.0
    start, goal = (
        np.asarray(x)[0, 0] for x in (worlds.environment.start_m, worlds.environment.goal_m)
    )
    planned = start + np.clip(times / 20.0, 0.0, 1.0) * (goal - start)
    assert np.linalg.norm(planned - bodies[:, 0], axis=-1).min() < radius + 0.7


def test_what_a_robot_was_not_planned_for_is_counted_until_its_end(replanned):
    """The first robot's goal lies outside the cube: nobody finds a way to it, once a second."""
    worlds = blind(replanned)
    place = worlds.environment
    worlds = replace(
        worlds, environment=replace(place, goal_m=place.goal_m.at[0, 0].set([50.0, 0.0, -6.0]))
    )
    state, _, _ = fly(replanned, worlds)
    assert outcomes(state) == [Outcome.RUNNING, Outcome.REACHED]
    whole = np.asarray(device_to_host.select_end(state, recorded=False).columns["failed_replans"])
    np.testing.assert_array_equal(whole, [[29, 0]])  # at 1, 2, ... 29 s of 30
    ended = replace(
        state.tally,
        outcome=state.tally.outcome.at[0, 0].set(Outcome.COLLISION_DYNAMIC),
        end_time_s=state.tally.end_time_s.at[0, 0].set(10.3),
    )
    early = device_to_host.select_end(replace(state, tally=ended), recorded=False)
    np.testing.assert_array_equal(early.columns["failed_replans"], [[10, 0]])


def test_nothing_is_counted_where_nothing_is_planned_anew(kept):
    state = kept.reset(kept.worlds())
    for end in (state, replace(state, policy=None)):
        assert device_to_host.select_end(end, recorded=False).columns == {}


@pytest.mark.nightly(by="the flight around the obstacle, in the fused engine")
def test_both_engines_replan_alike(load, replanned):
    other = angler.Simulator(load(engine="mjx", planner=REPLANNED))
    (ours, p, _), (theirs, q, _) = (fly(x, x.worlds()) for x in (replanned, other))
    assert outcomes(ours) == outcomes(theirs)
    # Until the third plan: rounding may choose another way among equals.
    np.testing.assert_allclose(p[:15], q[:15], atol=2e-3)


@pytest.mark.nightly(by="the same policy in a batch, and session/ for what sessions are told")
def test_a_session_flies_as_a_batch(load, replanned):
    _, robots, _ = fly(replanned, replanned.worlds())
    session = BatchSession(load(planner=REPLANNED))
    seen, flyer, places = session.reset(), OnlineFlyer(session), []
    for step in range(200):
        if step % 4 == 0:
            places.append(np.asarray(seen.estimate.p))
        seen = session.step(flyer.commands(seen))
    # 10 s, ten plans.
    np.testing.assert_allclose(places, robots[:50], atol=5e-3)
    asked = build_session_problem(session, Information(obstacles="observed"))
    body = np.asarray(session.inside().state.obstacles.p)[0]
    np.testing.assert_allclose(asked.obstacles.p_m[:, 0], body, atol=1e-5)
    np.testing.assert_allclose(asked.obstacles.velocity_mps[0], [0.0, -0.15, 0.0], atol=5e-3)
    np.testing.assert_allclose(asked.team.start_m, seen.estimate.p, atol=1e-6)
    assert asked.horizon_s == pytest.approx(20.0)
    session.close()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"planner": {"replan_hz": 40.0}}, r"planner\.replan_hz .*= 40: .* = 0\.5 must be a whole"),
        ({"planner": {"replan_hz": 3.0}}, r"planner\.replan_hz .*= 3: .*must be a whole number"),
        ({"planner": {"delay_s": 1.0}}, r"planner\.delay_s .*= 1: there is no replanning"),
        ({"planner": {"replan_hz": 1.0, "delay_s": 1.5}}, r"planner\.delay_s = 1\.5: longer than"),
        ({"planner": {"replan_hz": 1.0, "delay_s": 0.07}}, r"delay_s .*= 0\.07: .*whole number"),
        ({"execution": {"order": "any"}}, r"execution\.order"),
        (
            {"execution": {"order": "kept"}, "controller": {"name": "los"}},
            r'execution\.order .*= "kept": guides robots by poses, and no stage of controller',
        ),
        (
            {"planner": {"replan_hz": 1.0, "information": {"obstacles": "all"}}},
            r"information.*obstacles = 'all'",
        ),
    ],
)
def test_what_cannot_be_flown_is_refused_by_its_key(load, changes, said):
    with pytest.raises(ConfigError, match=said):
        load(**changes)


def test_a_run_that_goes_on_is_commanded_by_the_same_policy(load, kept):
    """Made from the scenario's file, it is the one that the simulator wrote down."""
    made = scenario_policy.resolve_policy(load(execution={"order": "kept"}), None)
    assert policies.describe_policy(made) == policies.describe_policy(kept.policy)


def test_another_policy_beside_it_is_refused(load, kept):
    with pytest.raises(ConfigError, match=r"policy Online: .*order = .kept.* commands the robots"):
        angler.Simulator(load(execution={"order": "kept"}), policy=kept.policy)


HOST = """
class Never:
    def plan(self, problem):
        return []
"""


def test_a_planner_of_the_host_is_refused_in_a_batch(load, tmp_path):
    (tmp_path / "never.py").write_text(HOST)
    planner = {"name": f"{tmp_path}/never.py:Never", "replan_hz": 1.0}
    with pytest.raises(ConfigError, match=r"planner\.replan_hz = 1: planner .* plans on the host"):
        angler.Simulator(load(planner=planner, tile=2))
