"""Padded currents: the flow of those without padding, and the same samples."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.world import currents
from angler_mjx.world.currents import GaussMarkovConfig, UniformConfig, VorticesConfig

CONFIGS = (
    UniformConfig(velocity_mps=(0.1, 0.0, 0.0)),
    GaussMarkovConfig(max_speed_mps=0.3, knot_dt_s=5.0),
    VorticesConfig(count=3, peak_speed_mps=(0.2, 0.5)),
)
HORIZON_S = 60.0
SIZES = (None, 13, 3)


@pytest.fixture(scope="module")
def sampled():
    """Currents [4] without padding, sampled with it, and padded afterwards."""
    samplers = currents.build_samplers(CONFIGS, HORIZON_S)
    lo, hi = jnp.array([-5.0, -5.0, -8.0]), jnp.array([5.0, 5.0, 0.0])
    keys = jax.random.split(jax.random.key(3), 4)

    def sample(samplers):
        return jax.vmap(lambda key: currents.sample_current(samplers, key, lo, hi))(keys)

    true = sample(samplers)
    return true, sample(currents.pad_samplers(samplers)), currents.pad_knots(true)


def test_sizes_are_those_of_the_config():
    samplers = currents.build_samplers(CONFIGS, HORIZON_S)
    assert currents.component_sizes(samplers) == SIZES
    assert currents.flight_sizes(samplers) == (None, 32, 3)
    assert currents.component_sizes(currents.pad_samplers(samplers)) == (None, 32, 4)


def test_what_is_sampled_with_padding_begins_with_what_is_sampled_without(sampled):
    true, padded, flown = sampled
    close = partial(np.testing.assert_allclose, rtol=1e-6, atol=1e-7)
    jax.tree.map(close, currents.cut_current(padded, SIZES), true)
    jax.tree.map(close, currents.cut_current(padded, (None, 32, 3)), flown)
    np.testing.assert_array_equal(padded[2].circulation_m2ps[:, 3], 0.0)
    jax.tree.map(np.testing.assert_array_equal, currents.cut_current(flown, SIZES), true)


def test_padding_again_changes_nothing(sampled):
    _, _, flown = sampled
    jax.tree.map(np.testing.assert_array_equal, currents.pad_knots(flown), flown)


def test_the_water_flows_as_without_padding(sampled):
    true, padded, flown = sampled
    p = jax.random.uniform(jax.random.key(5), (200, 3), minval=-8.0, maxval=8.0)
    t = jnp.linspace(0.0, HORIZON_S, 200, endpoint=False)
    flow = jax.jit(jax.vmap(jax.vmap(currents.evaluate_current, (None, 0, 0)), (0, None, None)))
    for current in (padded, flown):
        for a, b in zip(flow(true, p, t), flow(current, p, t), strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-6)
