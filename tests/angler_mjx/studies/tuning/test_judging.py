"""Measures and objectives against numpy and closed forms."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.sim.engines.free_flight import FreeFlight
from angler_mjx.studies.flights import kinds, measures
from angler_mjx.studies.flights.measures import LEVER_M, FlightMeasures, ReferenceMotion
from angler_mjx.studies.tuning import objectives

from ...compiling import quickly

DT = 0.05
STEPS = 600
of_flight = quickly(measures.measure_flight, static_argnums=3)


@pytest.fixture(scope="module")
def vehicle():
    built = kinds.build_params(kinds.shipped_vehicles()[:1]).vehicle
    return jax.tree.map(lambda leaf: leaf[0], built)


def flown(vehicle, p, q=None, nu=None, pwm=None, pose=None, still=1.0, heading=1.0):
    n = len(p)
    flight = FreeFlight(
        p=jnp.asarray(p),
        q=jnp.asarray(np.tile([1.0, 0, 0, 0], (n, 1)) if q is None else q),
        nu=jnp.zeros((n, 6)) if nu is None else jnp.asarray(nu),
        target_m=jnp.zeros((n, 3)),
        pwm_us=jnp.full((n, vehicle.B.shape[1]), 1500.0) if pwm is None else jnp.asarray(pwm),
    )
    reference = ReferenceMotion(
        pose=jnp.zeros((n, 4)) if pose is None else jnp.asarray(pose),
        still=jnp.array(still),
        heading=jnp.array(heading),
        length_m=jnp.array(2.0),
    )
    return of_flight(flight, reference, vehicle, DT)


def test_measures_of_a_flight_whose_integrals_are_known(vehicle):
    t = DT * np.arange(STEPS)
    amplitude, yaw = 0.3, 0.4
    p = np.stack([amplitude * np.sin(2 * math.pi * t), 0 * t, 0 * t], axis=1)
    q = np.tile([math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)], (STEPS, 1))
    pwm = np.where(np.arange(STEPS) % 2, 1510.0, 1490.0)[:, None] * np.ones(vehicle.B.shape[1])
    found = flown(vehicle, p, q, pwm=pwm)
    # Whole periods, 20 steps each: the sums of sines are exact, to float32.
    square = amplitude**2 / 2
    angle = 2 * (1 - math.cos(yaw))
    assert float(found.ise_m2s) == pytest.approx(30 * (square + LEVER_M**2 * angle), rel=1e-5)
    assert float(found.rms_m) == pytest.approx(math.sqrt(square), rel=1e-5)
    assert float(found.swing_m) == pytest.approx(math.sqrt(square), rel=1e-4)
    assert float(found.end_m) == pytest.approx(amplitude, rel=1e-5)
    assert float(found.jitter_us) == pytest.approx(20.0, rel=1e-5)
    assert not bool(found.failed)
    assert found.position_m.shape == (120, 3)
    without = flown(vehicle, p, q, still=0.0, heading=0.0)
    # A course that moves has no swing, only the offset that gives the root its derivative.
    assert float(without.swing_m) == 0.0
    assert float(without.ise_m2s) == pytest.approx(30 * square, rel=1e-5)


@pytest.mark.parametrize("what", ["nan", "lean", "turn"])
def test_flights_that_are_lost_fail(vehicle, what):
    p, nu = np.zeros((STEPS, 3)), np.zeros((STEPS, 6))
    q = np.tile([1.0, 0, 0, 0], (STEPS, 1))
    if what == "nan":
        p[300:] = np.nan
    if what == "lean":
        q[300] = [math.cos(0.55), math.sin(0.55), 0, 0]  # 63 degrees
    if what == "turn":
        nu[300, 5] = 10.1
    assert bool(flown(vehicle, p, q, nu).failed)
    if what != "nan":
        mended = q.copy()
        mended[300] = [math.cos(0.5), math.sin(0.5), 0, 0]  # 57 degrees
        assert not bool(flown(vehicle, p, mended, 0.9 * nu).failed)


def some(n, seed):
    rng = np.random.default_rng(seed)
    names = ("ise_m2s", "energy_jpm", "swing_m", "jitter_us", "rms_m", "end_m")
    scale = (1.0, 500.0, 0.05, 10.0, 0.1, 0.1)
    drawn = {k: s * rng.uniform(0.5, 1.5, n) for k, s in zip(names, scale, strict=True)}
    return FlightMeasures(**drawn, failed=np.zeros(n, bool), position_m=np.zeros((n, 1, 3)))


GROUP = np.array([0] * 10 + [1] * 30)


def batch(found):
    return jax.tree.map(lambda leaf: np.asarray(leaf)[None], found)


def test_objectives_are_the_formulas_that_are_documented():
    start, found = some(40, 1), some(40, 2)
    mean = np.array([start.ise_m2s[g == GROUP].mean() for g in (0, 1)])[GROUP]
    energy = np.array([start.energy_jpm[g == GROUP].mean() for g in (0, 1)])[GROUP]

    def over_groups(x):
        return 0.5 * (x[GROUP == 0].mean() + x[GROUP == 1].mean())

    def tail(m):
        share = m.ise_m2s / mean + (m.swing_m / 0.05) ** 2 + (m.jitter_us / 20.0) ** 2
        return np.sort(share)[-4:].mean()

    wanted = {
        "ise": over_groups(found.ise_m2s / mean),
        "energy": 0.5 * over_groups(found.ise_m2s / mean + found.energy_jpm / energy),
        "robust": tail(found) / tail(start),
    }
    for objective, value in wanted.items():
        judge = objectives.build_objective(objective, GROUP, start)
        assert judge.cost(start) == pytest.approx(1.0, rel=1e-6)
        # Sums of 40 float32 numbers.
        assert judge.cost(found) == pytest.approx(value, rel=1e-5)


def test_a_flight_that_fails_counts_a_hundred_whatever_its_numbers():
    start = some(40, 1)
    judge = objectives.build_objective("ise", GROUP, start)
    found = batch(some(40, 2))
    sound = judge.costs(found)[0]
    for leaf in (found.ise_m2s, found.swing_m):
        leaf[0, 3] = np.nan
    found.failed[0, 3] = True
    share = float(some(40, 2).ise_m2s[3]) / start.ise_m2s[:10].mean()
    # One of ten in a group that is one of two.
    assert judge.costs(found)[0] == pytest.approx(sound + (100.0 - share) / 20, rel=1e-5)


@pytest.mark.parametrize("objective", ["ise", "energy", "robust"])
def test_gradients_are_those_of_the_cost(objective):
    judge = objectives.build_objective(objective, GROUP, some(40, 1))
    rng = np.random.default_rng(5)
    # The i-th measure grows by its slope times the knob.
    slopes = {
        name: getattr(some(40, 7), name)[None, :, None] * rng.normal(size=(1, 40, 2))
        for name in ("ise_m2s", "energy_jpm", "swing_m", "jitter_us")
    }
    found = some(40, 2)
    found.failed[12] = True
    slopes["ise_m2s"][0, 12] = np.nan
    gradient = judge.gradients(batch(found), slopes)[0]

    def cost(turn):
        moved = {k: getattr(found, k) + (np.nan_to_num(s[0]) @ turn) for k, s in slopes.items()}
        return judge.cost(FlightMeasures(**{**vars(found), **moved}))

    h = 3e-3
    for i, step in enumerate(h * np.eye(2)):
        # Differences of float32 costs near 1 over 6e-3 err by some 1e-4.
        assert gradient[i] == pytest.approx((cost(step) - cost(-step)) / (2 * h), abs=1e-3)
