"""Short flights of a scene by an engine, in float64."""

from functools import partial

import jax
import numpy as np

from ...compiling import quickly


def fly_steps(engine, scene, steps):
    """The state after so many control steps, and the signals of each."""
    with jax.enable_x64(True):
        start = quickly(partial(engine.reset, scene.spec))(scene.fleet, scene.worlds)

        @quickly
        def some(kinds, worlds, state):
            def one(state, _):
                after, sample = engine.control_step(scene.spec, kinds, worlds, state, None)
                return after, sample.pwm_us

            return jax.lax.scan(one, state, length=steps)

        return jax.device_get(some(scene.fleet, scene.worlds, jax.device_get(start)))


def assert_same_flight(ends):
    """The flights of both engines are the same to rounding, in signals, motion and energy."""
    (ours, pwm), (theirs, other_pwm) = ends["fused"], ends["mjx"]
    np.testing.assert_allclose(pwm, other_pwm, rtol=1e-9, atol=1e-7)
    for name in ("p", "q", "nu", "thrust"):
        np.testing.assert_allclose(
            getattr(ours.vehicles, name), getattr(theirs.vehicles, name), rtol=1e-9, atol=1e-9
        )
    np.testing.assert_allclose(ours.tally.energy_j, theirs.tally.energy_j, rtol=1e-9)
