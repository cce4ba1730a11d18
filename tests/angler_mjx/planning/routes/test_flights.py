"""Fleets flown along routes, named by a scenario file: past each other, around rock, and held."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import angler_mjx as angler
from angler_mjx.errors import ConfigError
from angler_mjx.planning.planner import PathShape
from angler_mjx.planning.routes import route_fields
from angler_mjx.runs.simulator import scenario_policy
from angler_mjx.sim.information import Information
from angler_mjx.sim.state import Outcome
from angler_mjx.sim.world_context import GoalAssignment, WorldContext
from angler_mjx.world import routes as reading

from ...compiling import quickly

SCENARIO = """
name = "meeting"
engine = "fused"
worlds = 1
tile = 1
seed = 1

[time]
horizon_s = 60.0
record_hz = 5.0

[world]
preset = "open"
shape = [8, 8, 4]
depth_m = 2.0
placement = "given"
start_m = [[-3.75, 0.75, -5.75], [3.75, 0.75, -5.75]]
goal_m = [[3.75, 0.75, -5.75], [-3.75, 0.75, -5.75]]

[[fleet]]
vehicle = "bluerov2_heavy"
count = 2

[policy]
name = "routes"
"""


@pytest.fixture(scope="module")
def load(tmp_path_factory):
    folder = tmp_path_factory.mktemp("routes")

    def made(text=SCENARIO, **overrides):
        path = folder / "scenario.toml"
        path.write_text(text)
        return angler.load_scenario(path, **overrides)

    return made


@pytest.fixture(scope="module")
def simulator(load):
    return without_planner(load())


def without_planner(scenario):
    return angler.Simulator(scenario, paths=PathShape(points=2))


def fly(simulator, worlds):
    """Final state, and places [samples, robots, 3] in the only world."""
    state, seen = simulator.reset(worlds), []
    for _ in range(simulator.segments):
        state, sample = simulator.segment(worlds, state)
        seen.append(np.asarray(sample.p)[0])
    return state, np.concatenate(seen)


def with_rock(simulator, worlds, cells, **places):
    """The same world with other rock and places, and routes to its goals."""
    environment = worlds.environment
    occupied = np.zeros(environment.grid.occupied.shape, bool)
    occupied[0][tuple(np.transpose(cells))] = True
    grid = replace(environment.grid, occupied=jnp.asarray(occupied))
    moved = {name: jnp.asarray(at, jnp.float32)[None] for name, at in places.items()}
    environment = replace(environment, grid=grid, **moved)
    clearance = jnp.max(simulator.add_parameters(worlds).control.vehicle.radius_m, axis=1) + 0.1
    routes = jax.jit(jax.vmap(route_fields.compute_routes))(
        environment, environment.goal_m, clearance
    )
    return replace(worlds, environment=environment, routes=routes)


@pytest.mark.nightly(by="routes/test_avoidance.py, and the flights out of a pocket below")
def test_robots_that_meet_head_on_pass_each_other_on_their_left_hand_sides(simulator):
    worlds = simulator.worlds()
    state, seen = fly(simulator, worlds)
    assert np.all(np.asarray(state.tally.outcome) == Outcome.REACHED)
    assert np.min(np.asarray(state.tally.min_separation_m)) > 0.1
    # Where they are abreast, the one that goes east is south of the other.
    abreast = np.argmin(np.abs(seen[:, 0, 0] - seen[:, 1, 0]))
    assert seen[abreast, 0, 1] < seen[abreast, 1, 1] - 0.5


@pytest.fixture(scope="module")
def around(simulator):
    """Robot 0 begins in a pocket of rock that is open to the west; its goal is east of it."""
    worlds = simulator.worlds()
    back = [(4, y, z) for y in range(1, 7) for z in range(4)]
    sides = [(x, y, z) for x in (2, 3) for y in (1, 6) for z in range(4)]
    lids = [(x, y, z) for x in (2, 3) for y in range(1, 7) for z in (0, 3)]
    rock = np.array(sorted({*back, *sides, *lids}))
    goals = [[3.75, 0.75, -5.75], [-5.25, -5.25, -3.5]]
    starts = [[-0.75, 0.75, -5.75], [5.25, 5.25, -3.5]]
    return rock, with_rock(simulator, worlds, rock, start_m=starts, goal_m=goals)


@pytest.fixture(scope="module")
def flown(simulator, around):
    return fly(simulator, around[1])


def test_a_robot_leaves_a_pocket_that_its_goal_lies_behind(around, flown):
    state, seen = flown
    assert np.all(np.asarray(state.tally.outcome) == Outcome.REACHED)
    # The straight way is 4.5 m; it must go back around the walls.
    assert np.min(seen[:, 0, 0]) < -2.5
    assert np.asarray(state.tally.path_length_m)[0, 0] > 9.0


def test_no_corner_is_cut_through_rock(simulator, around, flown):
    rock, worlds = around
    seen, radius = flown[1], float(simulator.add_parameters(worlds).control.vehicle.radius_m[0, 0])
    low = np.asarray(worlds.environment.grid.origin_m)[0] + 1.5 * rock
    off = np.maximum(np.maximum(low - seen[..., None, :], seen[..., None, :] - low - 1.5), 0.0)
    assert np.min(np.linalg.norm(off, axis=-1)) > radius + 0.02


def test_the_way_that_is_left_shrinks_all_along_the_flight(around, flown):
    routes = jax.tree.map(lambda leaf: leaf[0], around[1].routes)
    seen = jnp.asarray(flown[1])

    @jax.jit
    def left(places):
        each = jax.vmap(lambda i, p: reading.distance_to_goal(routes, i, p))
        return jax.vmap(lambda p: each(jnp.arange(2), p))(places)

    way = np.asarray(left(seen))
    for robot in range(2):
        until = np.argmax(way[:, robot] < 0.3)
        assert until > 50
        best = np.minimum.accumulate(way[:until, robot])
        # Lattice ways are up to 13 % longer than those that are flown, and told in parts.
        assert np.max(way[:until, robot] - best) < 0.6


def test_who_has_no_way_stays_and_what_is_told_there_holds_it(simulator, around):
    worlds = around[1]
    shut = [(1, y, z) for y in range(1, 7) for z in range(4)]
    goals, starts = (np.asarray(getattr(worlds.environment, x)[0]) for x in ("goal_m", "start_m"))
    closed = with_rock(simulator, worlds, [*around[0], *shut], goal_m=goals, start_m=starts)
    state, seen = fly(simulator, closed)
    assert np.asarray(state.tally.outcome).tolist() == [[Outcome.RUNNING, Outcome.REACHED]]
    assert np.max(np.linalg.norm(seen[:, 0] - starts[0], axis=-1)) < 0.1


def test_who_has_nowhere_to_go_makes_way_for_one_whose_place_it_stands_at(simulator, around):
    stands = np.array([0.75, 0.75, -5.75])
    middle = np.array([5, 1, 2])
    shell = [tuple(middle + np.array(i) - 1) for i in np.ndindex(3, 3, 3) if i != (1, 1, 1)]
    starts = [[-3.75, 0.75, -5.75], stands]
    goals = [
        stands + np.array([0.1, 0.0, 0.0]),
        -6.0 + 1.5 * (middle + 0.5) + np.array([0.0, 0.0, -2.0]),
    ]
    worlds = with_rock(simulator, simulator.worlds(), shell, start_m=starts, goal_m=goals)
    state, seen = fly(simulator, worlds)
    assert np.asarray(state.tally.outcome).tolist() == [[Outcome.REACHED, Outcome.RUNNING]]
    assert float(np.min(np.asarray(state.tally.min_separation_m))) > 0.1
    # It went no farther than it had to.
    assert 0.2 < np.max(np.linalg.norm(seen[:, 1] - stands, axis=-1)) < 2.0


def test_a_robot_that_is_sent_nowhere_stays_where_it_was_told_so(simulator):
    worlds = simulator.add_parameters(simulator.worlds())
    policy, world = simulator.policy, jax.tree.map(lambda x: x[0], worlds)
    state = jax.tree.map(lambda x: x[0], simulator.reset(simulator.worlds()))
    goals = world.environment.goal_m

    @quickly
    def told(memory, p, place):
        here = WorldContext(
            spec=simulator.spec,
            policy=policy,
            world=world,
            number=jnp.int32(0),
            vehicles=replace(state.vehicles, p=p),
            obstacles=state.obstacles,
        )
        known = here.build_policy_input(
            None, assignment=GoalAssignment(goal_m=goals, goal_index=place)
        )
        return policy.act(memory, known, None, jnp.int32(0))

    start, drift = state.vehicles.p, jnp.array([0.3, -0.2, 0.1])
    sent, nowhere = jnp.array([0, 1]), jnp.array([-1, 1])
    memory, command = told(state.policy.carry, start, sent)
    assert command.velocity_mps[0, 0] > 0.4
    # A command holds for 5 steps of 0.05 s; the point is where half of that time leads.
    np.testing.assert_allclose(
        command.position_m - start, 0.125 * command.velocity_mps, rtol=1e-3, atol=1e-6
    )
    memory, command = told(memory, start + drift, nowhere)
    np.testing.assert_allclose(command.velocity_mps[0], np.zeros(3), atol=1e-6)
    # Carried away from there, it goes back; the other flies on.
    memory, command = told(memory, start + 2.0 * drift, nowhere)
    np.testing.assert_allclose(command.velocity_mps[0], -0.8 * drift, atol=1e-5)
    assert command.velocity_mps[1, 0] < -0.4


@pytest.mark.nightly(by="tests of policies, which fly alike in every engine")
def test_engines_agree(load):
    ends = []
    for engine in ("mjx", "fused"):
        simulator = without_planner(load(engine=engine, time={"horizon_s": 2.0}))
        worlds = simulator.worlds()
        state, _ = fly(simulator, worlds)
        ends.append(np.asarray(state.vehicles.p))
    assert np.max(np.abs(ends[0] - np.asarray(worlds.environment.start_m))) > 0.2
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-4)


def test_scenarios_say_how_often_and_what_it_knows(load):
    policy = scenario_policy.resolve_policy(load(), None)
    assert (policy.period, policy.observation_period, policy.routes_margin_m) == (5, 5, 0.1)
    assert policy.information == Information(obstacles="observed")
    told = load(planner={"information": {"obstacles": "truth"}, "margin_m": 0.2})
    assert scenario_policy.resolve_policy(told, None).information == Information(obstacles="truth")
    assert scenario_policy.resolve_policy(told, None).routes_margin_m == 0.2
    blind = load(policy={"information": {"obstacles": "nothing"}, "routes": {"hz": 10.0}})
    assert scenario_policy.resolve_policy(blind, None).information == Information()
    assert scenario_policy.resolve_policy(blind, None).period == 2
    with pytest.raises(ConfigError, match=r"policy\.routes\.hz = 3"):
        load(policy={"routes": {"hz": 3.0}})
    with pytest.raises(ConfigError, match=r'policy\.name = "routes".*takes one; take another'):
        load(controller={"name": "los"})


def test_worlds_without_routes_are_refused(simulator):
    worlds = replace(simulator.worlds(), routes=None)
    with pytest.raises(ConfigError, match="drawn without routes"):
        simulator.reset(worlds)
