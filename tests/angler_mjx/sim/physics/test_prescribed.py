"""Base of a vehicle whose joints move as prescribed: one state against the recursion."""

import jax.numpy as jnp
import numpy as np

from angler_mjx.robot.vehicles import library
from angler_mjx.sim.physics.prescribed import accelerate_base
from angler_mjx.sim.physics.step import Water

from ...compiling import quickly
from . import armed as arms

SALT = Water(density_kgpm3=1025.0)


def test_the_base_accelerates_as_the_recursion_asks(x64):
    """In fresh water, which is the default; in salt water buoyancy is another."""
    armed = arms.build(library.load_vehicle(arms.SHIPPED), "wu2018")
    names = ("p", "q", "nu", "theta", "speed", "flow", "flow_rate")
    sampled = arms.sample_states(armed, 1, 5)
    *state, flow, rate = (sampled[name][0] for name in names)
    acceleration = np.random.default_rng(6).normal(size=6 + armed.count)
    asked = armed.chain.inverse(*state, acceleration[:6], acceleration[6:], flow, rate)

    def evaluate(wrench, water):
        return accelerate_base(
            armed.params,
            *map(jnp.asarray, state[:3]),
            arms.motion(*state[3:]),
            jnp.asarray(acceleration[6:]),
            wrench=wrench,
            v_c=flow,
            Dv_c=rate,
            water=water,
        )

    fresh, salt = quickly(lambda wrench: (evaluate(wrench, None), evaluate(wrench, SALT)))(
        asked[:6]
    )
    np.testing.assert_allclose(fresh, acceleration[:6], rtol=1e-9, atol=1e-9)
    assert np.max(np.abs(salt - fresh)) > 1e-3
