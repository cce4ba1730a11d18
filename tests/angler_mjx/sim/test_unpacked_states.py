"""States of engines that keep them as they are."""

from dataclasses import replace
from types import SimpleNamespace

import jax.numpy as jnp
import pytest

from angler_mjx.sim.state import WorldState
from angler_mjx.sim.unpacked_states import UnpackedStates


class CountingEngine(UnpackedStates):
    """Engine whose control step only counts."""

    def control_step(
        self,
        spec,
        fleet,
        worlds,
        state,
        command,
        policy=None,
        rows=None,
        constants=(),
        steps=1,
        cells=None,
    ):
        return replace(state, step=state.step + steps), "sample"


def build_state(steps):
    """Return a state of worlds [W] of which only the steps [W] matter."""
    return WorldState(
        vehicles=None, carry=None, obstacles=None, tally=None, step=jnp.asarray(steps)
    )


def test_a_state_is_packed_as_it_is():
    engine, state = CountingEngine(), build_state([1, 2])
    assert engine.unpack_state(engine.pack_state(state)) is state


def test_advancing_returns_the_state_without_a_sample():
    advanced = CountingEngine().advance(
        None, None, None, build_state([1, 2]), None, jnp.arange(2), (), 3
    )
    assert advanced.step.tolist() == [4, 5]


def test_worlds_are_selected_and_replaced():
    engine, state, initial = CountingEngine(), build_state([1, 2, 3]), build_state([10, 20])
    assert engine.select_states(state, jnp.array([2, 0])).step.tolist() == [3, 1]
    ended, rows = jnp.array([True, False, True]), jnp.array([1, 0, 0])
    assert engine.replace_states(state, ended, initial, rows).step.tolist() == [20, 2, 10]


def test_a_state_of_another_engine_is_refused():
    with pytest.raises(TypeError, match="SimpleNamespace is no WorldState"):
        CountingEngine().unpack_state(SimpleNamespace())
