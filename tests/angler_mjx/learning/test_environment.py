"""Environments against `Simulator.segment`, NumPy and what Gymnasium says."""

from dataclasses import replace
from functools import partial

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.control.commands import BodyTwist
from angler_mjx.errors import ConfigError
from angler_mjx.learning import rewards
from angler_mjx.learning.environment import FleetEnv, make
from angler_mjx.learning.vector import FleetVectorEnv
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.simulator.simulator import Simulator

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
    return make(
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
    held = make(
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
        now, seen_held, reward, _, truncated, told = fly(now, twist)
        gained += reward
    assert (np.asarray(told["time_s"]) == 0.4).all()
    np.testing.assert_allclose(now.flight.vehicles.p, state.flight.vehicles.p, atol=1e-5)
    np.testing.assert_allclose(told["energy_j"], info["energy_j"], rtol=1e-4)
    np.testing.assert_allclose(seen_held, seen, atol=1e-4)
    # Progress and energy add up; distance is taken four times as rarely, for four times as long.
    np.testing.assert_allclose(gained, worth, rtol=0.02, atol=0.02)
    for _ in range(3):
        now, _, _, _, truncated, _ = fly(now, twist)
    assert truncated.all()
    with pytest.raises(ConfigError, match="action_repeat = 3: the horizon of 20"):
        make(simulator, worlds=WORLDS, bank=env.bank, action_repeat=3)


def test_only_ended_worlds_are_replaced_and_by_the_bank(env, step):
    state, _ = env.reset()
    late = state.flight.step.at[1].set(env.rules.horizon - 1)
    state = replace(state, flight=replace(state.flight, step=late))
    action = np.full(env.action_shape, 0.3, np.float32)
    after, seen, _, terminated, truncated, info = step(env, state, action)
    assert truncated.tolist() == [False, True, False, False]
    assert not terminated.any()
    row = int(after.row[1])
    for got, bank in zip(
        jax.tree.leaves(after.flight), jax.tree.leaves(env.bank.begun), strict=True
    ):
        np.testing.assert_array_equal(got[1], bank[row])
    np.testing.assert_array_equal(seen[1], env.observed[row])
    assert not np.array_equal(seen[1], info["final_obs"][1])
    np.testing.assert_array_equal(seen[0], info["final_obs"][0])
    assert after.row[jnp.array([0, 2, 3])].tolist() == [0, 2, 3]
    assert after.flight.step.tolist() == [1, 0, 1, 1]
    np.testing.assert_array_equal(after.action[1], 0.0)


def test_a_world_whose_robots_all_ended_terminates(env, step):
    state, _ = env.reset()
    outcome = state.flight.tally.outcome.at[2].set(1)
    tally = replace(state.flight.tally, outcome=outcome)
    state = replace(state, flight=replace(state.flight, tally=tally))
    _, _, reward, terminated, truncated, _ = step(env, state, np.zeros(env.action_shape))
    assert terminated.tolist() == [False, False, True, False]
    assert not truncated.any()
    np.testing.assert_array_equal(reward[2], 0.0)


def test_rewards_are_what_numpy_says(env, step):
    state, _ = env.reset()
    action = np.full(env.action_shape, 0.5, np.float32)
    after, _, reward, _, _, info = step(env, state, action)
    goal = np.asarray(env.bank.worlds.environment.goal_m)[:WORLDS]
    before = np.linalg.norm(np.asarray(state.flight.vehicles.p) - goal, axis=-1)
    now = np.linalg.norm(np.asarray(after.flight.vehicles.p) - goal, axis=-1)
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
    ends = 0
    for _ in range(3 * STEPS):
        action = vector.action_space.sample()
        seen, reward, terminated, truncated, info = vector.step(action)
        assert seen in vector.observation_space
        assert reward.shape == terminated.shape == truncated.shape == (WORLDS,)
        ends += bool(truncated.any())
        assert ("final_obs" in info) == bool((terminated | truncated).any())
    assert ends >= 3
    assert vector._step._cache_size() == 1


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
    ],
)
def test_wrong_names_are_refused(simulator, env, wrong, message):
    with pytest.raises(ConfigError, match=message):
        make(simulator, **{"worlds": WORLDS, "bank": env.bank, **wrong})


def test_a_wrong_shape_is_refused(env):
    state, _ = env.reset()
    with pytest.raises(ConfigError, match=r"must be \[4, 2, 6\]"):
        env.step(state, jnp.zeros((4, 6)))


def test_every_default_reward_is_a_term():
    assert set(rewards.DEFAULT) <= set(rewards.TERMS)
