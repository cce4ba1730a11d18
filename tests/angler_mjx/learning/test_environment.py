"""Environments against `Simulator.segment`, NumPy and what Gymnasium says."""

from dataclasses import replace
from functools import partial

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.wrappers.vector import DictInfoToList, RecordEpisodeStatistics
from scipy.spatial.transform import Rotation

from angler_mjx.errors import ConfigError
from angler_mjx.learning import actions, observations, rewards
from angler_mjx.learning.environment import FleetEnv, make_env
from angler_mjx.learning.observations import ObservedState
from angler_mjx.learning.vector import FleetVectorEnv
from angler_mjx.robot.control.commands import BodyTwist, PoseTarget
from angler_mjx.robot.control.stack import wants_flow
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.sim.engines.cuda.engine import CudaEngine
from angler_mjx.sim.state import Outcome

WORLDS, STEPS = 4, 20
TEXT = """
schema_version = 1
name = "learning"
worlds = 4
seed = 3
tile = 4
engine = "fused"
[time]
horizon_s = 1.0
record_hz = 0.0
[world]
preset = "open"
placement = "parallel"
[[fleet]]
vehicle = "bluerov2_heavy"
count = 2
[[world.currents]]
type = "gauss_markov"
max_speed_mps = 0.3
"""
REWARD = {"progress": 2.0, "energy": -0.1, "distance": -1.0, "roughness": -0.5}


@pytest.fixture(scope="module")
def simulator(tmp_path_factory):
    path = tmp_path_factory.mktemp("learning") / "s.toml"
    path.write_text(TEXT)
    return Simulator(load_scenario(path))


@pytest.fixture(scope="module")
def env(simulator):
    return make_env(
        simulator, worlds=WORLDS, bank=6, reward=REWARD, observe=("velocity", "goal", "current")
    )


@pytest.fixture(scope="module")
def step():
    return jax.jit(FleetEnv.step)


@pytest.mark.nightly(
    by="tests/angler_mjx/learning/test_environment.py::test_only_ended_worlds_are_replaced_and_by_the_bank"
)
def test_a_fixed_command_flies_as_a_segment_does(simulator, env, step):
    worlds = simulator.worlds()
    twist = np.zeros((WORLDS, 2, 6), np.float32)
    twist[..., 0] = 0.4
    begun = simulator.reset(worlds)
    wanted, _ = simulator.segment(worlds, begun, BodyTwist(nu=jnp.asarray(twist)))
    state, _ = env.reset()
    for _ in range(simulator.segment_steps - 1):
        state, *_ = step(env, state, twist)
    *_, truncated, info = step(env, state, twist)
    away = np.linalg.norm(wanted.vehicles.p - worlds.environment.goal_m, axis=-1)
    np.testing.assert_allclose(info["aim_distance_m"], away, rtol=1e-5)
    np.testing.assert_allclose(info["energy_j"], wanted.tally.energy_j, rtol=1e-4)
    assert truncated.all()


def test_an_action_that_is_held_is_as_many_steps_of_it(simulator, env, step):
    held = make_env(
        simulator,
        worlds=WORLDS,
        bank=env.bank,
        reward=REWARD,
        observe=("velocity", "goal", "current"),
        action_repeat=4,
    )
    twist = np.full((WORLDS, 2, 6), 0.1, np.float32)
    state, _ = env.reset()
    worth = 0.0
    for _ in range(8):
        state, seen, reward, _, _, info = step(env, state, twist)
        worth += reward
    fly = jax.jit(partial(FleetEnv.step, held))  # beside the program that others count
    now, _ = held.reset()
    gained = 0.0
    for _ in range(2):
        now, seen_held, reward, _, truncated, details = fly(now, twist)
        gained += reward
    assert (np.asarray(details["time_s"]) == 0.4).all()
    np.testing.assert_allclose(now.world_state.vehicles.p, state.world_state.vehicles.p, atol=1e-5)
    np.testing.assert_allclose(details["energy_j"], info["energy_j"], rtol=1e-4)
    np.testing.assert_allclose(seen_held, seen, atol=1e-4)
    # Progress and energy add up; distance is taken four times as rarely, for four times as long.
    np.testing.assert_allclose(gained, worth, rtol=0.02, atol=0.02)
    for _ in range(3):
        now, _, _, _, truncated, _ = fly(now, twist)
    assert truncated.all()
    with pytest.raises(ConfigError, match="action_repeat = 3: the horizon of 20"):
        make_env(simulator, worlds=WORLDS, bank=env.bank, action_repeat=3)


@pytest.mark.usefixtures("compiled_sources")
def test_an_environment_on_kernels_steps_as_on_lanes(env, step):
    """Kernels run here as C, in blocks that the worlds do not fill; a world ends, a robot too."""
    engine = CudaEngine(block=3)
    bank = replace(
        env.bank,
        laid=engine.pack_constants(env.fleet, env.bank.worlds),
        packed_state=engine.pack_state(env.bank.initial_state),
    )
    on_kernels = replace(env, bank=bank, rules=replace(env.rules, engine=engine))
    both = []
    for each in (env, on_kernels):
        state, _ = each.reset()
        late = state.world_state.step.at[1].set(env.rules.horizon - 2)
        state = state.with_world_state(replace(state.world_state, step=late))
        fly = step if each is env else jax.jit(partial(FleetEnv.step, each))
        for number in range(3):
            action = np.full(env.action_shape, 0.3, np.float32)
            action[2, 0] = np.nan if number == 1 else 0.3
            results = fly(env, state, action) if each is env else fly(state, action)
            state, *_ = results
        both.append((state.world_state, state.row, state.action, *results[1:]))
    lanes, kernels = both
    assert lanes[0].step.tolist() == [3, 1, 3, 3]
    assert np.isfinite(lanes[-1]["energy_j"]).all()
    for ours, theirs in zip(jax.tree.leaves(kernels), jax.tree.leaves(lanes), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-5)


def test_only_ended_worlds_are_replaced_and_by_the_bank(env, step):
    state, _ = env.reset()
    late = state.world_state.step.at[1].set(env.rules.horizon - 1)
    state = state.with_world_state(replace(state.world_state, step=late))
    action = np.full(env.action_shape, 0.3, np.float32)
    after, seen, _, terminated, truncated, info = step(env, state, action)
    assert truncated.tolist() == [False, True, False, False]
    assert not terminated.any()
    row = int(after.row[1])
    for got, bank in zip(
        jax.tree.leaves(after.world_state), jax.tree.leaves(env.bank.initial_state), strict=True
    ):
        np.testing.assert_array_equal(got[1], bank[row])
    np.testing.assert_array_equal(seen[1], env.initial_observation[row])
    assert not np.array_equal(seen[1], info["final_obs"][1])
    np.testing.assert_array_equal(seen[0], info["final_obs"][0])
    assert after.row[jnp.array([0, 2, 3])].tolist() == [0, 2, 3]
    assert after.world_state.step.tolist() == [1, 0, 1, 1]
    np.testing.assert_array_equal(after.action[1], 0.0)


def test_a_world_whose_robots_all_ended_terminates(env, step):
    state, _ = env.reset()
    outcome = state.world_state.tally.outcome.at[2].set(1)
    tally = replace(state.world_state.tally, outcome=outcome)
    state = state.with_world_state(replace(state.world_state, tally=tally))
    _, _, reward, terminated, truncated, _ = step(env, state, np.zeros(env.action_shape))
    assert terminated.tolist() == [False, False, True, False]
    assert not truncated.any()
    np.testing.assert_array_equal(reward[2], 0.0)


def test_rewards_are_what_numpy_says(env, step):
    state, _ = env.reset()
    action = np.full(env.action_shape, 0.5, np.float32)
    after, _, reward, _, _, info = step(env, state, action)
    goal = np.asarray(env.bank.worlds.environment.goal_m)[:WORLDS]
    before = np.linalg.norm(np.asarray(state.world_state.vehicles.p) - goal, axis=-1)
    now = np.linalg.norm(np.asarray(after.world_state.vehicles.p) - goal, axis=-1)
    terms = info["reward_terms"]
    np.testing.assert_allclose(terms["progress"], 2.0 * (before - now), atol=1e-5)
    np.testing.assert_allclose(terms["distance"], -0.05 * now, rtol=1e-5)
    np.testing.assert_allclose(terms["energy"], -1e-4 * np.asarray(info["energy_j"]), rtol=1e-5)
    np.testing.assert_allclose(terms["roughness"], -0.5 * 0.25, rtol=1e-6)
    np.testing.assert_allclose(reward, sum(np.asarray(x) for x in terms.values()), atol=1e-5)


def test_gymnasium_sees_a_vector_env_that_compiles_once(env):
    vector = FleetVectorEnv(env)
    assert vector.metadata["autoreset_mode"] == gymnasium.vector.AutoresetMode.SAME_STEP
    seen, _ = vector.reset(seed=1)
    assert seen in vector.observation_space
    ends, compiled = 0, None
    for _ in range(3 * STEPS):
        action = vector.action_space.sample()
        seen, reward, terminated, truncated, info = vector.step(action)
        assert seen in vector.observation_space
        assert reward.shape == terminated.shape == truncated.shape == (WORLDS,)
        ends += bool(truncated.any())
        assert ("final_obs" in info) == bool((terminated | truncated).any())
        # Other tests may have compiled the same function for other types of actions.
        compiled = compiled or vector._step._cache_size()
    assert ends >= 3
    assert vector._step._cache_size() == compiled


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"action": "thrust"}, "action = 'thrust'"),
        ({"observe": ("velocity", "sonar")}, "there is no 'sonar'"),
        ({"reward": {"glory": 1.0}}, "there is no 'glory'"),
        ({"reward": {"energy": float("nan")}}, "reward.energy = nan"),
        ({"aim": "home"}, "aim = 'home'"),
        ({"horizon": 1000}, "horizon = 1000"),
        ({"worlds": 0}, "worlds = 0"),
        ({"scale": (1.0,)}, "has 6 numbers"),
        ({"scale": (1.0,) * 5 + (-1.0,)}, "has 6 numbers"),
    ],
)
def test_wrong_names_are_refused(simulator, env, wrong, message):
    with pytest.raises(ConfigError, match=message):
        make_env(simulator, **{"worlds": WORLDS, "bank": env.bank, **wrong})


def test_a_wrong_shape_is_refused(env):
    state, _ = env.reset()
    with pytest.raises(ConfigError, match=r"must be \[4, 2, 6\]"):
        env.step(state, jnp.zeros((4, 6)))


def test_the_bank_has_as_many_worlds_as_are_named(env):
    assert env.bank.count == 6


ALL = ("velocity", "upright", "goal", "heading", "depth", "current", "robots", "obstacles")
ALL = (*ALL, "cells", "action")
NOISY = TEXT.replace("count = 2\n", 'count = 2\nestimate = "noisy"\n') + (
    "[world.obstacles.dynamic]\ncount = 2\n"
)


@pytest.fixture(
    scope="module",
    params=[
        "noisy",
        pytest.param("ekf", marks=pytest.mark.nightly(by="the same of noisy, in this file")),
    ],
)
def instrumented(request, tmp_path_factory):
    """Robots with instruments, whose stages use the current."""
    path = tmp_path_factory.mktemp("instrumented") / "s.toml"
    path.write_text(NOISY.replace('"noisy"', f'"{request.param}"'))
    simulator = Simulator(load_scenario(path))
    kinds = [name for name in ALL if name != "current" or wants_flow(simulator.spec.stages)]
    return make_env(simulator, worlds=WORLDS, bank=5, observe=kinds, action="waypoint")


@pytest.fixture(scope="module")
def stepped(instrumented):
    """States, observations, what the controllers used next, the action and its result; thrice."""

    @jax.jit
    def fly(env, state, command):
        return env.rules.engine.control_step(
            env.rules.spec, env.fleet, env.bank.worlds, state.world_state, command, rows=state.row
        )

    go = jax.jit(FleetEnv.step)
    state, seen = instrumented.reset()
    rows = []
    for _ in range(3):
        p, yaw = state.world_state.vehicles.p, jnp.zeros((WORLDS, 2))
        still = PoseTarget(position_m=p, velocity_mps=jnp.zeros_like(p), yaw_rad=yaw)
        used = fly(instrumented, state, still)[1].belief
        after = go(instrumented, state, jnp.full(instrumented.action_shape, 0.1))
        by = {
            name: fly(instrumented, state, waypoint(details))[0]
            for name, details in (("belief", used), ("truth", state.world_state.vehicles))
        }
        rows.append((state, parts_of(instrumented, seen), used, after[0], by))
        state, seen = after[:2]
    return rows


def waypoint(details):
    """The command of an action of 0.1 from a pose: 0.2 m and 0.314 rad on, level."""
    yaw = Rotation.from_quat(np.asarray(details.q)[..., [1, 2, 3, 0]].reshape(-1, 4))
    yaw = yaw.as_euler("ZYX")[:, 0].reshape(WORLDS, 2)
    c, s = np.cos(yaw), np.sin(yaw)
    level = np.stack([0.2 * (c - s), 0.2 * (s + c), np.full_like(c, 0.2)], axis=-1)
    position = jnp.asarray(np.asarray(details.p) + level, details.p.dtype)
    return PoseTarget(
        position_m=position,
        velocity_mps=jnp.zeros_like(position),
        yaw_rad=jnp.asarray(yaw + 0.1 * np.pi, position.dtype),
    )


def parts_of(env, seen):
    """Parts of an observation by name."""
    ends = np.cumsum([part.size for part in env.rules.parts])
    assert ends[-1] == seen.shape[-1]
    pieces = np.split(np.asarray(seen), ends[:-1], axis=-1)
    return {part.name: piece for part, piece in zip(env.rules.parts, pieces, strict=True)}


def turned(q, vector):
    """Vectors of W in F by SciPy, for quaternions wxyz."""
    turn = Rotation.from_quat(np.asarray(q)[..., [1, 2, 3, 0]].reshape(-1, 4))
    return turn.inv().apply(np.asarray(vector).reshape(-1, 3)).reshape(*np.shape(q)[:-1], 3)


def test_every_observation_is_what_the_controllers_use_in_the_next_step(stepped):
    """From the first one on, which is no truth."""
    for state, seen, belief, *_ in stepped:
        np.testing.assert_allclose(seen["velocity"], belief.nu, atol=1e-5)
        np.testing.assert_allclose(seen["depth"][..., 0], belief.p[..., 2], atol=1e-5)
        assert np.abs(seen["velocity"] - state.world_state.vehicles.nu).max() > 1e-3


def test_others_are_seen_at_the_time_of_the_observation(instrumented, stepped):
    for state, seen, belief, *_ in stepped:
        p, q = belief.p, belief.q
        to = np.asarray(state.world_state.vehicles.p)[:, ::-1] - np.asarray(p)
        far = np.linalg.norm(to, axis=-1, keepdims=True) >= 10.0
        wanted = np.where(far, [10.0, 0.0, 0.0], turned(q, to))
        np.testing.assert_allclose(seen["robots"][..., :3], wanted, atol=1e-4)
        goal = np.asarray(instrumented.bank.worlds.environment.goal_m)[np.asarray(state.row)]
        np.testing.assert_allclose(seen["goal"], turned(q, goal - np.asarray(p)), atol=1e-4)


def test_a_waypoint_lies_from_where_the_robot_takes_itself_to_be(stepped):
    for _, _, _, after, by in stepped:
        thrust = np.asarray(after.world_state.vehicles.thrust)
        np.testing.assert_allclose(thrust, by["belief"].vehicles.thrust, atol=1e-3)
        assert np.abs(thrust - by["truth"].vehicles.thrust).max() > 0.05


def test_a_first_observation_has_no_action_and_every_part_its_size(instrumented, stepped):
    seen = stepped[0][1]
    np.testing.assert_array_equal(seen["action"], 0.0)
    sizes = {name: part.shape[-1] for name, part in seen.items()}
    sizes.pop("current", None)
    assert sizes == {
        **{"velocity": 6, "upright": 3, "goal": 3, "heading": 2, "depth": 1, "robots": 9},
        **{"obstacles": 12, "cells": 27, "action": 4},
    }
    norm = np.linalg.norm(seen["heading"], axis=-1)
    np.testing.assert_allclose(norm, 1.0, atol=1e-5)


@pytest.fixture(scope="module")
def sight(env):
    """Truth of worlds with random rock, robots at its edges and turned anywhere."""
    rng = np.random.default_rng(0)
    worlds = env.bank.worlds
    grid = worlds.environment.grid
    shape = np.array(grid.occupied.shape[1:])
    rock = rng.random(grid.occupied.shape) < 0.3
    worlds = replace(
        worlds,
        environment=replace(worlds.environment, grid=replace(grid, occupied=jnp.asarray(rock))),
    )
    rows = jnp.array([3, 0, 5, 1])
    index = rng.integers(0, shape, (WORLDS, 2, 3))
    index[0] = shape - 1  # the last cell of each axis
    cell, origin = np.asarray(grid.cell_m)[rows], np.asarray(grid.origin_m)[rows]
    p = origin[:, None] + (index + rng.uniform(0.3, 0.7, index.shape)) * cell[:, None, None]
    q = Rotation.random(2 * WORLDS, rng=1).as_quat()[:, [3, 0, 1, 2]].reshape(WORLDS, 2, 4)
    begun = jax.tree.map(lambda leaf: leaf[rows], env.bank.initial_state)
    vehicles = replace(begun.vehicles, p=jnp.asarray(p), q=jnp.asarray(q))
    return ObservedState(
        worlds=worlds,
        rows=rows,
        state=replace(begun, vehicles=vehicles),
        estimate=vehicles,
        flow=jnp.zeros_like(vehicles.p),
        aim_m=vehicles.p,
        aim_yaw_rad=jnp.zeros((WORLDS, 2)),
        action=jnp.zeros((WORLDS, 2, 6)),
    )


@pytest.mark.parametrize("level", [True, False])
def test_cells_lie_in_the_frame_of_the_robot(sight, level):
    """Ahead first, by turning each point by SciPy and looking it up."""
    q = np.asarray(sight.estimate.q)
    if level:  # a heading of 90 degrees: what is ahead lies along y of W
        q = np.broadcast_to([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)], q.shape)
    details = replace(sight.estimate, q=jnp.asarray(q))
    seen = observations.observe_cells(replace(sight, estimate=details))
    grid = sight.worlds.environment.grid
    for w, row in enumerate(np.asarray(sight.rows)):
        rock = np.asarray(grid.occupied)[row]
        for r in range(2):
            turn = Rotation.from_quat(q[w, r][[1, 2, 3, 0]])
            for i, offset in enumerate(np.ndindex(3, 3, 3)):
                point = np.asarray(sight.estimate.p)[w, r] + turn.apply(
                    np.array(offset) - 1.0
                ) * float(grid.cell_m[row])
                at = np.floor((point - np.asarray(grid.origin_m)[row]) / float(grid.cell_m[row]))
                at = at.astype(int)
                inside = (at >= 0).all() and (at < rock.shape).all()
                assert seen[w, r, i] == (not inside or rock[tuple(at)])


def test_numbers_are_clipped_to_bounds_that_are_those_of_the_space(sight):
    parts = observations.select_parts(ALL, 6)
    details = replace(sight.estimate, p=sight.estimate.p.at[..., 2].set(-2000.0))
    seen = observations.build_observation(
        parts, replace(sight, estimate=details, aim_m=details.p + 500.0)
    )
    low, high = observations.build_bounds(parts)
    assert ((seen >= low) & (seen <= high)).all()
    at = [part.name for part in parts for _ in range(part.size)].index
    assert low[at("depth")] == -1000.0
    np.testing.assert_array_equal(seen[..., at("depth")], -1000.0)
    assert high[at("goal")] == 100.0
    assert high[at("robots")] == 10.0


def test_nobody_farther_than_ten_metres_is_seen(sight):
    identity = jnp.zeros_like(sight.estimate.q).at[..., 0].set(1.0)
    for away, wanted in ((9.7, 9.7), (10.3, None)):
        p = sight.estimate.p.at[:, 1].set(sight.estimate.p[:, 0] + jnp.array([0.0, 0.0, -away]))
        vehicles = replace(sight.estimate, p=p, q=identity)
        here = replace(sight, estimate=vehicles, state=replace(sight.state, vehicles=vehicles))
        first = observations.observe_robots(here)[:, 0, :3]
        expected = [10.0, 0.0, 0.0] if wanted is None else [0.0, 0.0, -wanted]
        np.testing.assert_allclose(first, np.broadcast_to(expected, first.shape), atol=1e-4)
        np.testing.assert_array_equal(
            observations.observe_obstacles(here).reshape(WORLDS, 2, 3, 4)[..., 3], 0.0
        )


def test_ranges_of_actions_are_those_of_the_docs():
    ranges = {name: actions.build_action_space(name, 3).range for name in actions.KINDS}
    assert ranges == {
        "plan": (),
        "waypoint": (2.0, 2.0, 2.0, pytest.approx(np.pi)),
        "pose": (2.0, 2.0, 2.0, pytest.approx(np.pi)),
        "twist": (1.0,) * 6,
        "wrench": (80.0, 80.0, 80.0, 15.0, 15.0, 15.0),
        "pwm": (400.0,) * 3,
    }


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
def test_a_robot_whose_action_is_no_number_diverges_and_rewards_are_finite(env, step, number):
    state, _ = env.reset()
    action = np.zeros(env.action_shape, np.float32)
    action[1, 0, 2], action[2, 1, 0] = number, 7.0
    state, seen, reward, terminated, _, info = step(env, state, action)
    wanted = np.zeros((WORLDS, 2))
    wanted[1, 0] = Outcome.DIVERGED
    np.testing.assert_array_equal(info["outcome"], wanted)
    for _ in range(2):
        assert np.isfinite(seen).all()
        assert np.isfinite(reward).all()
        assert all(np.isfinite(term).all() for term in info["reward_terms"].values())
        assert np.isfinite(info["energy_j"]).all()
        state, seen, reward, terminated, _, info = step(env, state, np.zeros_like(action))
    assert not terminated.any()


def test_numbers_that_are_clipped_or_not_finite_are_counted(env, step):
    state, _ = env.reset()
    action = np.zeros(env.action_shape, np.float32)
    action[1, 0, 2:4], action[2, 1, :3] = np.nan, [1.5, -1.0, -7.0]
    info = step(env, state, action)[-1]
    assert np.argwhere(info["not_finite"]).tolist() == [[1, 0]]
    assert np.argwhere(info["clipped"]).tolist() == [[2, 1]]
    assert (info["not_finite"][1, 0], info["clipped"][2, 1]) == (2, 2)


@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_numbers_on_the_host_that_are_not_finite_are_refused(env, number):
    vector = FleetVectorEnv(env)
    vector.reset()
    wrong = np.zeros(env.action_shape, np.float32)
    wrong[1, 0, 2] = number
    with pytest.raises(ConfigError, match=rf"action\[1, 0, 2\] = {number}: must be a finite"):
        vector.step(wrong)
    state, _ = env.reset()
    with pytest.raises(ConfigError, match="1 of 48 are not"):
        env.step(state, wrong)


def test_infos_are_those_that_gymnasiums_wrappers_read(env):
    """Its own wrappers count episodes and make one dictionary a world of the infos."""
    plain = FleetVectorEnv(env)
    vector = DictInfoToList(RecordEpisodeStatistics(FleetVectorEnv(env)))
    plain.reset(seed=1)
    vector.reset(seed=1)
    gained, ended = np.zeros(WORLDS), 0
    for _ in range(STEPS):
        action = np.full(env.action_shape, 0.2, np.float32)
        _, reward, terminated, truncated, _ = plain.step(action)
        *_, infos = vector.step(action)
        gained += reward
        for w in np.flatnonzero(terminated | truncated):
            ended += 1
            assert infos[w]["episode"]["r"] == pytest.approx(gained[w], rel=1e-4)
            assert infos[w]["episode"]["l"] == STEPS
            assert infos[w]["final_info"]["time_s"] == pytest.approx(1.0)
            assert "time_s" not in infos[w]  # of the world that replaced it
        for w in np.flatnonzero(~(terminated | truncated)):
            assert infos[w]["reward_terms"].keys() == REWARD.keys()
            assert "final_info" not in infos[w]
    assert ended == WORLDS


def test_every_default_reward_is_a_term():
    assert set(rewards.DEFAULT_WEIGHTS) <= set(rewards.TERMS)
