"""Gradients of a closed-loop rollout against finite differences and against mjx's, in float64."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.sim.engines.gradients import tracking_cost

from ...compiling import quickly

STEPS = 40
"""Two seconds: the robots accelerate, turn, and saturate."""


@pytest.fixture(scope="module")
def scene(scenes):
    build, members, obstacles = scenes
    with jax.enable_x64(True):
        return build(2, members=members("bluerov2_heavy"), config=obstacles["none"])


@pytest.fixture(scope="module")
def costs(scene, engines_by_name):
    """For each engine, a function gains -> (cost, gradient), and the gains.

    An engine that nobody asks is not compiled.
    """

    def of(engine):
        @cache
        def start():
            return quickly(partial(engine.reset, scene.spec))(scene.fleet, scene.worlds)

        @quickly
        def both(gains, kinds, worlds, start):
            return jax.value_and_grad(tracking_cost)(
                gains, engine, scene.spec, kinds, worlds, start, control_steps=STEPS
            )

        return lambda gains: both(gains, scene.fleet, scene.worlds, start())

    with jax.enable_x64(True):
        gains = jax.tree.map(jnp.asarray, scene.spec.gains)
        return {name: of(engine) for name, engine in engines_by_name.items()}, gains


def vector(gains):
    return np.array(jax.tree.leaves(gains))


def test_is_the_gradient_by_finite_differences(costs, deviation):
    with jax.enable_x64(True):
        functions, gains = costs
        flat, tree = jax.tree.flatten(gains)
        gradient = vector(functions["fused"](gains)[1])

        def cost(i, h):
            moved = [x + h * (k == i) for k, x in enumerate(flat)]
            return functions["fused"](jax.tree.unflatten(tree, moved))[0]

        differences = [(cost(i, 1e-6) - cost(i, -1e-6)) / 2e-6 for i in range(len(flat))]
    # The cost is 7e-3, a sum of thousands of terms: rounded to about 1e-16, over steps of 2e-6.
    # Found is 3e-10.
    deviation.close("gradient.differences", gradient, differences, rtol=1e-5, atol=1e-9)
    # The gains that are at work at all in two seconds.
    assert np.count_nonzero(np.abs(gradient) > 1e-6) >= 5


@pytest.mark.nightly(by="test_is_the_gradient_by_finite_differences")
def test_is_the_gradient_of_mjx(costs, deviation):
    with jax.enable_x64(True):
        functions, gains = costs
        (ours, gradient), (theirs, other) = functions["fused"](gains), functions["mjx"](gains)
    # Equal equations: rounding only, grown by forty steps back.
    deviation.close("gradient.cost", ours, theirs, rtol=1e-10)
    deviation.close("gradient.mjx", vector(gradient), vector(other), rtol=1e-7, atol=1e-12)
