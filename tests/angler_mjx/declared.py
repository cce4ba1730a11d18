"""Whether samples of an engine have the shapes and types that are declared of them."""

import jax
import jax.numpy as jnp

from angler_mjx.sim import record


def check(sample, lead, sizes, *, told=False, also=(), dtype=jnp.float64):
    """Assert it for all declared fields.

    Args:
        sample: of an engine, or its shapes.
        lead: sizes of the axes before those of a world.
        sizes: how many robots, thrusters and obstacles there are.
        told: whether robots were told of themselves otherwise than by the truth.
        also: what was asked for.
        dtype: of the simulation.
    """
    assert record.sizes_of(sample, lead=len(lead)) == sizes
    for one in record.FIELDS:
        value = one.of(sample)
        of_belief = told and one.about.phase == "sense"
        there = one.is_recorded(also) if one.about.option else of_belief or not one.is_optional
        assert (value is not None) == there, one.path
        if value is not None:
            assert value.shape == (*lead, *one.shape(sizes)), one.path
            assert value.dtype == (jnp.int32 if one.about.whole else dtype), one.path
    assert jax.tree.leaves(sample)
