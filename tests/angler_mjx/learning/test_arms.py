"""Environments of fleets with arms: joints among observations and actions."""

import jax
import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.learning.environment import FleetEnv, make_env
from angler_mjx.robot.vehicles import library
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario

JOINTS = 5
SCENARIO = {
    "name": "learning_arms",
    "engine": "mjx",
    "worlds": 2,
    "tile": 2,
    "time": {"horizon_s": 10.0},
    "world": {
        "preset": "open",
        "placement": "given",
        "start_m": [[-2.0, -2.0, -8.0], [-2.0, 2.0, -8.0]],
        "goal_m": [[4.0, -2.0, -8.0], [4.0, 2.0, -8.0]],
    },
    "controller": {"name": "arm"},
    "fleet": [{"vehicle": "bluerov2_heavy_alpha5"}, {"vehicle": "bluerov2_heavy"}],
}


@pytest.fixture(scope="module")
def env():
    simulator = Simulator(Scenario.model_validate(SCENARIO))
    return make_env(
        simulator, worlds=2, bank=2, action="whole_body", observe=("velocity", "joints")
    )


def test_joints_go_where_the_action_says_and_are_observed(env):
    """In the order and within the limits of the vehicle file; the base keeps its place."""
    joints = library.load_vehicle("bluerov2_heavy_alpha5").find_joints()
    lower, upper = (
        np.array([getattr(joint, end) for joint in joints]) for end in ("lower", "upper")
    )
    home = np.array([joint.home for joint in joints])
    assert env.action_shape == (2, 2, 6 + JOINTS)
    assert env.observation_shape == (2, 2, 6 + 2 * JOINTS)
    state, begun = env.reset()
    np.testing.assert_allclose(begun[:, 0, 6:11], np.tile(home, (2, 1)), atol=1e-6)
    wanted = home + np.array([0.3, 0.5, -0.4, 0.6, 0.0])
    action = np.zeros(env.action_shape, np.float32)
    action[..., 6:] = (wanted - 0.5 * (lower + upper)) / (0.5 * (upper - lower))
    step = jax.jit(FleetEnv.step)
    for count in range(60):
        state, seen, *_ = step(env, state, action)
        if count == 5:
            assert np.abs(np.asarray(seen)[:, 0, 11:]).max() > 0.05
    np.testing.assert_allclose(np.asarray(seen)[:, 0, 6:11], np.tile(wanted, (2, 1)), atol=0.05)
    # The robot without an arm has no joints that move, and both stay.
    np.testing.assert_array_equal(np.asarray(seen)[:, 1, 6:], 0.0)
    assert np.abs(np.asarray(seen)[..., :3]).max() < 0.1


def test_joints_are_refused_by_name_where_there_are_none():
    fleet = {
        "fleet": [{"vehicle": "bluerov2_heavy", "count": 2}],
        "controller": {"name": "cascade"},
    }
    simulator = Simulator(Scenario.model_validate(SCENARIO | fleet))
    with pytest.raises(ConfigError, match="action = 'whole_body': no vehicle of the fleet has"):
        make_env(simulator, worlds=2, bank=2, action="whole_body")
    with pytest.raises(ConfigError, match="observe: 'joints': no vehicle of the fleet has"):
        make_env(simulator, worlds=2, bank=2, observe=("velocity", "joints"))
