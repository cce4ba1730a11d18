"""The sliding terms act, stay within their bounds, and drive the sliding variable down."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.robot.control.commands import BodyTwist, Estimate
from angler_mjx.robot.control.laws import aitsm, ismc
from angler_mjx.robot.vehicles import library, params

DT = 0.05


def test_the_sliding_term_of_ismc_acts():
    """At |s| = 0.1 m/s it is worth 0.27 m/s^2; the law it is modelled on has 0.0005 there."""
    gains = ismc.IsmcGains(sliding_radps2=4.0, layer_radps=1.5)
    s = jnp.array([0.1, -0.1, 1e-3, 1.5, -9.0, 0.0])
    term = np.asarray(ismc.sliding_term(gains, s))
    assert np.all(np.sign(term) == np.sign(s))
    # rho / lambda for small s, rho tanh(1) at the layer, rho far outside.
    np.testing.assert_allclose(term[:3], np.asarray(s[:3]) * 4 / 1.5, rtol=3e-3)
    np.testing.assert_allclose(term[3], 4 * np.tanh(1.0), rtol=1e-5)
    np.testing.assert_allclose(term[4], -4.0, rtol=1e-4)


def test_the_sliding_term_of_aitsm_acts():
    gains = aitsm.AitsmGains()
    s = jnp.array([0.1, -0.1, 1e-3, 0.5, -2.0, 0.0])
    term = np.asarray(aitsm.sliding_term(gains, jnp.full(6, 0.5), s))
    expected = 0.5 * np.sqrt(np.abs(s)) * np.clip(np.asarray(s) / 0.3, -1, 1)
    # The root is rounded off below 1e-12.
    np.testing.assert_allclose(term, expected, rtol=1e-5, atol=1e-9)
    assert np.all(term[:5] != 0)


def test_the_adaptive_gain_grows_falls_and_is_bounded():
    gains = aitsm.AitsmGains()

    def run(k, s, steps):
        for _ in range(steps):
            k = aitsm.adapt_gain(gains, k, s, DT)
        return np.asarray(k)

    large, none = jnp.full(6, 3.0), jnp.zeros(6)
    start = jnp.zeros(6)
    grown = run(start, large, 10)
    # 0.5 (its least) and then 6 /s less the leak, for 0.45 s.
    np.testing.assert_allclose(grown, 0.5 + 0.45 * 6, rtol=0.1)
    assert np.all(run(start, large, 100) == gains.sliding_most)
    fallen = run(jnp.full(6, 4.0), none, 200)
    # The leak's exp(-0.2 * 10) of what is above the least; Euler's steps are 1 % each.
    np.testing.assert_allclose(fallen - 0.5, 3.5 * np.exp(-2.0), rtol=0.03)


def test_sliding_variable_is_brought_down_against_a_disturbance():
    """V' < 0 outside the layer that the disturbance leaves: on nu' = tau / M + d, exact model."""
    unit = _unit_vehicle()
    command = BodyTwist(nu=jnp.zeros(6).at[0].set(1.0))
    disturbance = jnp.array([-2.0, 1.0, 0.0, 0.0, 0.0, -1.0])

    def run(law, gains):
        def one(pair, _):
            nu, carry = pair
            at = Estimate(p=jnp.zeros(3), q=jnp.array([1.0, 0, 0, 0]), nu=nu)
            carry, wrench = law.step(gains, unit, carry, at, command, DT, 1000.0, 0.0)
            return (nu + DT * (wrench.tau + disturbance), carry), nu - command.nu

        at = Estimate(p=jnp.zeros(3), q=jnp.array([1.0, 0, 0, 0]), nu=jnp.zeros(6))
        return np.asarray(jax.lax.scan(one, (at.nu, law.reset(at)), length=400)[1])

    for law, gains in ((ismc, ismc.IsmcGains()), (aitsm, aitsm.AitsmGains())):
        error = run(law, gains)
        # 20 s: ten time constants of K = 2; a constant disturbance leaves nothing.
        assert np.abs(error[-1]).max() < 1e-3, law.__name__
        # It comes down: after 5 s the error is below a tenth of the step.
        assert np.abs(error[100:]).max() < 0.1, law.__name__


def _unit_vehicle():
    """1 kg, 1 kg m^2, nothing else."""
    vehicle = params.build_vehicle(library.load_vehicle("bluerov2_heavy"), "wu2018", 14.8)
    return dataclasses.replace(
        vehicle,
        mass_kg=jnp.ones(()),
        inertia_kgm2=jnp.eye(3),
        M_A=jnp.zeros((6, 6)),
        D_l=jnp.zeros(6),
        D_q=jnp.zeros(6),
    )
