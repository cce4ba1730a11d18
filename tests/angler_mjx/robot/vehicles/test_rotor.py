"""The rotor of third order: one exact step, against scipy and the published response."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import signal

from angler_mjx.errors import ConfigError
from angler_mjx.robot.vehicles import params, rotor
from angler_mjx.robot.vehicles.library import load_vehicle
from angler_mjx.robot.vehicles.rotor import RotorFilter
from angler_mjx.sim.physics import rotors

STEP_S, STEPS = 1e-3, 300


@pytest.fixture(scope="module", autouse=True)
def x64():
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="module")
def heavy():
    return params.build_vehicle(
        load_vehicle("bluerov2_heavy"), None, 16.0, rotor_response="third_order"
    )


@pytest.fixture(scope="module")
def respond(heavy):
    """Thrust and mean thrust [STEPS, 8] of rotors that begin at rest, for commands [STEPS, 8]."""

    @jax.jit
    def run(commands):
        def one(states, command):
            states, mean = rotors.advance_rotors(heavy, states, command, STEP_S)
            return states, (states[0], mean)

        return jax.lax.scan(one, rotors.at_rest(heavy, float), commands)[1]

    return lambda commands: tuple(map(np.asarray, run(commands)))


def test_the_step_response_is_the_published_one(respond, deviation):
    thrust, _ = respond(jnp.ones((STEPS, 8)))
    time = STEP_S * np.arange(1, STEPS + 1)
    system = signal.TransferFunction([6136.0, 108700.0], [1.0, 89.0, 9258.0, 108700.0])
    _, expected = signal.step(system, T=np.concatenate([[0.0], time]))
    # float64: 300 steps of rounding.
    deviation.close("rotor.third_order_step", thrust, np.tile(expected[1:, None], 8), atol=1e-12)
    one = thrust[:, 0]
    # The numbers of the published model: two or three digits.
    assert one[19] == pytest.approx(0.63, abs=0.005)
    assert time[np.argmax(one > 0.9)] == pytest.approx(0.029, abs=0.001)
    assert one[75] == pytest.approx(0.855, abs=5e-4)
    assert time[np.abs(one - 1) > 0.05][-1] == pytest.approx(0.121, abs=0.002)


def test_any_held_command_is_followed_exactly(respond, deviation):
    """Commands that jump every 10 ms; and the mean of every step, by steps of a tenth."""
    random = np.random.default_rng(0)
    commands = np.repeat(random.uniform(-40, 50, (STEPS // 10, 8)), 10, axis=0)
    thrust, mean = respond(jnp.asarray(commands))
    system = signal.TransferFunction([6136.0, 108700.0], [1.0, 89.0, 9258.0, 108700.0])
    for i in range(8):
        # scipy takes the command of the row before each step; the last row is not reached.
        time = STEP_S * np.arange(STEPS + 1)
        held = np.concatenate([commands[:, i], [0.0]])
        _, expected, _ = signal.lsim(system, held, time, interp=False)
        # float64 on 50 N; scipy's states are 1e4 times larger than the thrust.
        deviation.close("rotor.third_order_commands", thrust[:, i], expected[1:], atol=1e-8)
    # Ten short steps of one command are one long one: thrusts, and means.
    heavy = params.build_vehicle(
        load_vehicle("bluerov2_heavy"), None, 16.0, rotor_response="third_order"
    )
    states = rotors.at_rest(heavy, float)
    for block in range(3):
        states, whole = rotors.advance_rotors(
            heavy, states, jnp.asarray(commands[10 * block]), 0.01
        )
        part = slice(10 * block, 10 * block + 10)
        np.testing.assert_allclose(states[0], thrust[part][-1], rtol=0, atol=1e-12)
        np.testing.assert_allclose(whole, mean[part].mean(axis=0), rtol=0, atol=1e-12)


def test_states_rest_where_they_settle():
    """Any stable filter, one with a term in s^2 and a slow pole; in one long step."""
    filter = RotorFilter(numerator=(3.0, 40.0, 500.0), denominator=(20.0, 150.0, 500.0))
    step = rotor.discretise_rotor(filter, 1.7)
    # The slowest pole is at -4.4 1/s: 5e-4 are left after 1.7 s.
    assert np.abs(step.transition).max() < 5e-3
    # The mean of a step's response: what it falls short by is (a_1 - b_1) / a_0 (final value
    # theorem) over the time; the rest is what has not settled.
    short = step.mean @ step.settled * 1.7
    assert short == pytest.approx((150.0 - 40.0) / 500.0, abs=1e-3)


def test_a_vehicle_keeps_its_own_response_where_none_is_named(heavy):
    config = load_vehicle("bluerov2_heavy")
    assert params.build_vehicle(config, None, 16.0).rotor is None
    other = config.model_copy(
        update={"rotor": config.rotor.model_copy(update={"response": "third_order"})}
    )
    assert params.build_vehicle(other, None, 16.0).rotor == heavy.rotor
    assert params.build_vehicle(other, None, 16.0, rotor_response="first_order").rotor is None


def test_a_response_without_numbers_is_refused():
    config = load_vehicle("bluerov2")
    bare = config.model_copy(
        update={"rotor": config.rotor.model_copy(update={"third_order": None})}
    )
    with pytest.raises(ConfigError, match=r"bluerov2.*\[rotor.third_order\]"):
        params.build_vehicle(bare, None, 16.0, rotor_response="third_order")
