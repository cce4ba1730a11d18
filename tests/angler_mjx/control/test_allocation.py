"""Allocation: what the thrusters really deliver of a wrench, and what is given up first."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import thruster
from angler_mjx.control import allocation
from angler_mjx.control.commands import BodyWrench
from angler_mjx.vehicles import library, params
from angler_mjx.vehicles.thrusters import PWM_LOW_US, PWM_STEP_US

N = 200
HEAVY, LIGHT = 0, 1
ATTITUDE, HEAVE, PLANE = slice(3, 6), 2, slice(0, 2)


@pytest.fixture(scope="module")
def vehicles():
    return params.stack(
        [
            params.build(library.load("bluerov2_heavy"), "wu2018", 16.0),
            params.build(library.load("bluerov2"), "blue_gazebo", 14.8),
        ]
    )


@pytest.fixture(scope="module")
def deliver(vehicles):
    """PWM, thrust and wrench of every vehicle for wrenches [2, N, 6]."""
    given = allocation.build(vehicles)

    def one(given, B, tau):
        pwm = allocation.allocate(given, BodyWrench(tau=tau)).pwm_us
        look = jax.vmap(thruster.lookup, (None, 0, None, None))
        thrust = look(given.thrust_n, pwm, PWM_LOW_US, PWM_STEP_US)
        return pwm, thrust, jnp.sum(B * thrust, axis=1)

    many = jax.jit(jax.vmap(jax.vmap(one, (None, None, 0))))
    return lambda tau: tuple(map(np.asarray, many(given, vehicles.B, jnp.asarray(tau))))


def wrenches(scale, seed=0):
    return np.random.default_rng(seed).normal(size=(2, N, 6)) * scale


SMALL = np.array([10, 10, 12, 1, 1, 1.5])
# float32 sums of eight thrusts, each with the table's inverse in between (a thrust step of 0.3 N
# per 4 us read at 1e-4 us: 1e-5 N), and thrusts below 0.005 N left out.
NEAR = 8 * 0.005


def test_an_unsaturated_demand_is_delivered(deliver):
    tau = wrenches(SMALL)
    _, _, got = deliver(tau)
    assert np.abs(got - tau)[HEAVY].max() < NEAR
    five = [0, 1, 2, 3, 5]
    assert np.abs(got - tau)[LIGHT][:, five].max() < NEAR
    # Pitch is not commanded there: it is what the surge thrusters' arm of 0.011 m makes of surge.
    assert np.abs(got[LIGHT, :, 4] + 0.011 * got[LIGHT, :, 0]).max() < 1e-4  # float32


def test_no_demand_is_neutral(deliver):
    pwm, thrust, _ = deliver(np.zeros((2, N, 6)))
    np.testing.assert_array_equal(pwm, 1500)
    np.testing.assert_array_equal(thrust, 0)
    # A wrench that is only rounding does not make thrusters jump across their dead band.
    pwm, _, _ = deliver(wrenches(1e-4))
    np.testing.assert_array_equal(pwm, 1500)


def test_thrusters_that_are_not_there_stay_neutral(deliver):
    pwm, thrust, _ = deliver(wrenches(100 * SMALL))
    np.testing.assert_array_equal(pwm[LIGHT, :, 6:], 1500)
    np.testing.assert_array_equal(thrust[LIGHT, :, 6:], 0)


def test_signals_stay_within_their_range(deliver):
    for scale in (1, 10, 1000):
        pwm, _, got = deliver(wrenches(scale * SMALL))
        assert np.all(np.isfinite(got))
        assert pwm.min() >= 1100
        assert pwm.max() <= 1900


def test_attitude_comes_first(deliver):
    """A demand of attitude that fits is met whatever else is asked for."""
    tau = wrenches(SMALL)
    tau[..., :3] *= 50
    _, _, got = deliver(tau)
    assert np.abs(got - tau)[HEAVY][:, ATTITUDE].max() < NEAR
    assert np.abs(got - tau)[LIGHT][:, [3, 5]].max() < NEAR


def test_heave_comes_before_surge_and_sway(deliver):
    tau = wrenches(SMALL)
    tau[..., PLANE] *= 50
    _, _, got = deliver(tau)
    assert np.abs(got - tau)[..., HEAVE].max() < NEAR


def test_surge_and_sway_keep_their_direction(deliver):
    tau = wrenches(SMALL)
    tau[..., PLANE] *= 50
    _, _, got = deliver(tau)
    asked, given = tau[..., PLANE], got[..., PLANE]
    across = asked[..., 0] * given[..., 1] - asked[..., 1] * given[..., 0]
    assert (np.abs(across) / np.linalg.norm(asked, axis=-1)).max() < NEAR
    share = np.sum(asked * given, axis=-1) / np.sum(asked**2, axis=-1)
    assert np.all(share > 0)
    assert np.all(share < 1.001)  # NEAR on demands above 40 N.
    assert np.mean(share < 0.9) > 0.5  # The demand did saturate.


def test_a_saturated_demand_runs_a_thruster_at_its_end(deliver, vehicles):
    """What is given up is no more than what must be."""
    tau = np.zeros((2, N, 6))
    tau[..., PLANE] = wrenches(1.0)[..., PLANE] * 1e4
    pwm, thrust, _ = deliver(tau)
    ends = np.asarray(vehicles.thrust_n)[:, None, [0, -1]]
    room = np.minimum(ends[..., 1:] - thrust, thrust - ends[..., :1])
    assert room.min(axis=-1).max() < 1e-3  # float32 on 50 N through the table.
    assert np.all((pwm.min(axis=-1) < 1100.1) | (pwm.max(axis=-1) > 1899.9))
