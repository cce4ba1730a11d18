"""Currents of worlds for programs: padded where a scenario needs it, and kept from call to call."""

from dataclasses import dataclass
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.runs.simulator.current_padding import CurrentPadding
from angler_mjx.runs.simulator.devices import build_mesh
from angler_mjx.world import currents
from angler_mjx.world.currents import GaussMarkov, GaussMarkovConfig, UniformConfig

KNOTS, PADDED = 13, 32


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Sea:
    current: currents.Current


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Worlds:
    environment: Sea


def build_padding(*configs):
    """Return the conversion for worlds with currents of these configs."""
    true = currents.build_samplers(configs, 60.0)
    numbers = [
        SimpleNamespace(world=SimpleNamespace(currents=samplers))
        for samplers in (true, currents.pad_samplers(true))
    ]
    return CurrentPadding(*numbers, build_mesh(1))


@pytest.fixture
def padding():
    """Conversion of currents with 13 knots, which programs take as 32."""
    return build_padding(GaussMarkovConfig(max_speed_mps=0.3, knot_dt_s=5.0))


def build_worlds(knots=KNOTS):
    """Return two worlds whose knots [2, knots, 3] differ."""
    knots_mps = jnp.arange(2.0 * knots * 3).reshape(2, knots, 3)
    return Worlds(Sea((GaussMarkov(knots_mps=knots_mps, knot_dt_s=jnp.full(2, 5.0)),)))


def read_knots(worlds):
    return worlds.environment.current[0].knots_mps


def test_currents_are_padded_and_cut(padding):
    worlds = build_worlds()
    padded = padding.pad(worlds)
    np.testing.assert_array_equal(read_knots(padded)[:, :KNOTS], read_knots(worlds))
    assert read_knots(padded).shape == (2, PADDED, 3)
    np.testing.assert_array_equal(read_knots(padding.cut(padded)), read_knots(worlds))


def test_currents_of_the_call_before_are_kept(padding):
    worlds, others = build_worlds(), build_worlds()
    first = padding.pad(worlds)
    assert read_knots(padding.pad(worlds)) is read_knots(first)
    assert read_knots(padding.pad(others)) is not read_knots(first)


def test_traced_currents_are_not_kept(padding):
    worlds = build_worlds()
    first = padding.pad(worlds)
    traced = jax.jit(padding.pad)(worlds)
    np.testing.assert_array_equal(read_knots(traced), read_knots(first))
    assert read_knots(padding.pad(worlds)) is read_knots(first)


def test_worlds_without_padding_are_returned_as_they_are():
    padding, worlds = build_padding(UniformConfig(velocity_mps=(0.1, 0.0, 0.0))), build_worlds()
    assert padding.pad(worlds) is worlds
    assert padding.cut(worlds) is worlds
