"""The surrogate: elements against closed forms, mixer against the firmware's table, loops."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.robot.control.laws.ardusub import law as ardusub
from angler_mjx.robot.control.laws.ardusub import mixer as ardusub_mixer
from angler_mjx.robot.control.laws.ardusub import pid as ardusub_pid

from ....compiling import quickly
from .equations import HEAVY, SIX, in_flu

DT = 0.05


def test_frame_factors_are_the_firmwares(robots):
    vehicles, _ = robots
    heavy = np.asarray(ardusub_mixer.frame_factors(vehicles.B[0]))
    np.testing.assert_array_equal(heavy, in_flu(HEAVY))
    six = np.asarray(ardusub_mixer.frame_factors(vehicles.B[3]))
    np.testing.assert_array_equal(six, in_flu(SIX))


def test_groups_are_scaled_as_a_whole(robots):
    vehicles, _ = robots
    factors = ardusub_mixer.frame_factors(vehicles.B[0])
    output, cut = ardusub_mixer.mix_demand(factors, jnp.array([1.0, 1.0, 0, 0, 0, 0]), 1.0)
    # Forward and left at full: the pair that would get 2 gets 1, the other none; direction stays.
    np.testing.assert_allclose(np.abs(output), [1, 0, 0, 1, 0, 0, 0, 0], atol=1e-6)
    assert bool(cut)
    # Climb at full does not take from the plane's group.
    output, cut = ardusub_mixer.mix_demand(factors, jnp.array([0.5, 0.0, 1.0, 0, 0, 0]), 1.0)
    np.testing.assert_allclose(np.abs(output), [0.5] * 4 + [1.0] * 4, atol=1e-6)
    assert not bool(cut)


@pytest.mark.parametrize("kind", [0, 3], ids=["heavy", "six"])
def test_a_throttle_beyond_its_end_is_one_at_its_end(robots, kind):
    """Far below its depth the acceleration loop asks for more than there is."""
    factors = ardusub_mixer.frame_factors(robots[0].B[kind])
    for sign in (1.0, -1.0):
        demand = jnp.array([0.3, 0.0, sign * 2.0, 0.0, 0.0, 0.0])
        output, cut = ardusub_mixer.mix_demand(factors, demand, 1.0)
        full, full_cut = ardusub_mixer.mix_demand(factors, demand.at[2].set(sign), 1.0)
        np.testing.assert_array_equal(output, full)
        assert bool(cut) == bool(full_cut)
        np.testing.assert_array_equal(np.abs(output[4:6]), 1.0)


def test_forward_gives_way_to_throttle_on_the_six_thruster_frame(robots):
    vehicles, _ = robots
    factors = ardusub_mixer.frame_factors(vehicles.B[3])
    output, _ = ardusub_mixer.mix_demand(factors, jnp.array([0.9, 0.0, 0.4, 0, 0, 0]), 1.0)
    np.testing.assert_allclose(np.abs(output), [0.6] * 4 + [0.4] * 2 + [0.0] * 2, atol=1e-6)
    free, _ = ardusub_mixer.mix_demand(factors, jnp.array([0.9, 0.0, 0.4, 0, 0, 0]), 0.0)
    np.testing.assert_allclose(np.abs(free[:4]), 0.9, atol=1e-6)


def test_square_root_controller_brakes_in_time():
    """Following its rate exactly, the error ends at zero and never decelerates harder than told."""
    gain, most, dt = 6.0, 2.0, 0.001

    def step(error, _):
        rate = ardusub_pid.sqrt_controller(error, gain, most, dt)
        return error - rate * dt, rate

    error, rates = quickly(lambda e: jax.lax.scan(step, e, length=3000))(jnp.asarray(3.0))
    assert abs(float(error)) < 1e-3
    # Per step, float32 of rates of 3: 3e-7 / 1e-3.
    assert np.max(-np.diff(rates)) / dt < most * 1.01 + 1e-3
    # Linear near zero, with the sign.
    np.testing.assert_allclose(
        ardusub_pid.sqrt_controller(jnp.array([0.01, -0.01]), 6.0, 2.0, dt),
        [0.06, -0.06],
        rtol=1e-6,
    )


def test_pid_terms():
    same = {"FLTT": 0.0, "FLTE": 0.0, "FLTD": 0.0}
    terms = ardusub_pid.PidParameters(P=2.0, I=0.5, D=0.1, IMAX=0.06, **same)
    carry = ardusub_pid.reset(jnp.zeros(1))
    free = jnp.asarray(False)
    carry, out = ardusub_pid.update_pid(terms, carry, jnp.ones(1), jnp.zeros(1), free, DT)
    # P 2, I 0.025, D 0.1 / 0.05.
    np.testing.assert_allclose(out, 2 + 0.025 + 2, rtol=1e-6)
    held, _ = ardusub_pid.update_pid(terms, carry, jnp.ones(1), jnp.zeros(1), jnp.asarray(True), DT)
    np.testing.assert_array_equal(held.integral, carry.integral)
    for _ in range(5):
        carry, out = ardusub_pid.update_pid(terms, carry, jnp.ones(1), jnp.zeros(1), free, DT)
    np.testing.assert_allclose(out, 2 + 0.06, rtol=1e-6)
    # One pole: after a time constant, 1 - 1 / e; backward Euler at a hundredth of it: 1 % less.
    y = jnp.zeros(())
    for _ in range(100):
        y = ardusub_pid.low_pass(y, jnp.ones(()), 5.0, 0.01 / (2 * np.pi * 5.0))
    assert float(y) == pytest.approx(1 - np.exp(-1), rel=0.01)


@pytest.fixture(scope="module")
def flown(pool):
    stock = ardusub.ArduSubGains()
    stiff = dataclasses.replace(
        stock, PSC_VELXY_P=8.0, PSC_VELXY_I=2.0, ATC_RAT_YAW_P=0.3, ATC_RAT_YAW_I=0.18
    )

    surrogate = pool.Controller(
        ardusub.reset,
        lambda gains, vehicle, carry, at, target, flow: ardusub.step(
            gains, vehicle, carry, at, pool.as_pose(target), DT, 1000.0, 9.81
        ),
        stock,
    )
    variants = {"stock": pool.Variant("ardusub"), "stiff": pool.Variant("ardusub", stiff)}
    return pool.fly({"ardusub": surrogate}, variants)


def test_the_firmwares_gains_keep_station_in_a_current(flown, pool):
    """As the real firmware does in 0.5 m/s; its integral is slow."""
    flights = flown["stock"]
    metres, degrees = flights.steady(pool.CURRENT)
    able = [i for i, kind in enumerate(pool.kinds) if kind[1] != "von_benzon2022"]
    # 1 to 6 cm and closing after 20 s; von_benzon2022, with three times the drag, needs longer.
    assert metres[able].max() < 0.08
    assert metres.max() < 0.4
    assert degrees.max() < 1


def test_the_firmwares_gains_hunt_in_still_water_within_bounds(flown, pool):
    flights = flown["stock"]
    # The step arrives, and what is left swings within the dead band of 25 us: 0.5 m/s^2 of demand,
    # over P = 6 of velocity and 1 of position 8 cm. The real firmware's swings by 6 cm.
    metres, _ = flights.steady(pool.STEP)
    assert metres.max() < 0.09
    depth = np.abs(flights.p[:, pool.STEP, -200:, 2] - (pool.deep[2] + 1.06))
    # Depth has its own loop: net buoyancy keeps its thrusters out of their dead band.
    assert depth.max() < 0.03
    # Heading: a dead band of 25 / 400 over P = 0.18 over 6 is 3.3 degrees.
    _, degrees = flights.steady(pool.TURN)
    assert degrees.max() < 5
    # A step of 2 m across all axes is not shaped here: 11 degrees with the quickest set.
    assert flights.tilt_deg[:, :3].max() < 13


def test_higher_gains_settle(flown, pool):
    flights = flown["stiff"]
    metres, _ = flights.steady(pool.STEP)
    assert metres.max() < 0.05
    metres, _ = flights.steady(pool.CURRENT)
    assert metres.max() < 0.02
    assert np.all(flights.settled_s(pool.STEP) < 15)


def test_signals_are_within_their_range_and_padding_is_neutral(flown, pool):
    pwm = flown["stock"].pwm
    assert pwm.min() >= 1100
    assert pwm.max() <= 1900
    assert np.all(pwm[3, ..., 6:] == 1500)


def test_trim_moves_the_neutral_signal(robots, states, pool):
    vehicles, _ = robots
    vehicle, (estimate, _) = jax.tree.map(lambda x: x[0], (vehicles, states))
    at = dataclasses.replace(estimate, q=jnp.array([1.0, 0, 0, 0]), nu=jnp.zeros(6))
    here = type(pool.as_pose(states[1]))(
        position_m=at.p, velocity_mps=jnp.zeros(3), yaw_rad=jnp.zeros(())
    )
    gains = ardusub.ArduSubGains(SERVO_TRIM=1510.0)
    step = quickly(partial(ardusub.step, gains, dt=DT, density=1000.0, gravity=9.81))
    _, out = step(vehicle, ardusub.reset(at), at, here)
    np.testing.assert_allclose(out.pwm_us, 1510.0, atol=1e-2)
