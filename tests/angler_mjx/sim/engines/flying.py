"""Short flights of a scene by an engine, in float64."""

from functools import partial

import jax

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
