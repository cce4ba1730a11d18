"""Packed states of worlds that do not fill their blocks."""

from dataclasses import fields, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.sim.engines.cuda.packed_state import PackedState
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.state import Tally, WorldState
from angler_mjx.world.obstacles.types import ObstacleState

WORLDS, ROBOTS, BLOCK = 4, 2, 3
FILLED = 6


def build_state(seed):
    """Return a random state of worlds [W] with two robots and one obstacle each."""
    random = np.random.default_rng(seed)

    def sample(*shape):
        return jnp.asarray(random.normal(size=(WORLDS, *shape)), jnp.float32)

    sizes = {"p": (3,), "q": (4,), "nu": (6,), "nu_dot": (6,), "force_before": (6,), "thrust": (8,)}
    tally = {field.name: sample(ROBOTS) for field in fields(Tally)}
    whole = {"outcome": jnp.int32, "touched": jnp.int32, "touched_index": jnp.int32}
    return WorldState(
        vehicles=VehicleState(
            **{name: sample(ROBOTS, *sizes[name]) for name in ("p", "q", "nu")},
            force_before=sample(ROBOTS, 6),
            thrust=sample(ROBOTS, 8),
        ),
        carry={"integral": sample(ROBOTS, 3)},
        obstacles=ObstacleState(
            **{x.name: sample(1, *sizes[x.name]) for x in fields(ObstacleState)}
        ),
        tally=Tally(**tally | {name: tally[name].astype(dtype) for name, dtype in whole.items()}),
        step=jnp.arange(WORLDS, dtype=jnp.int32) + 10 * seed,
        policy=sample(5),
    )


@pytest.fixture(scope="module")
def states():
    """Two states, and the first one packed."""
    first = build_state(1)
    return first, build_state(2), PackedState.of(first, BLOCK, None)


def assert_equal(ours, theirs):
    jax.tree.map(np.testing.assert_array_equal, ours, theirs)


def test_blocks_are_filled_by_repeating_the_last_world(states):
    state, _, packed = states
    assert (packed.worlds, packed.filled) == (WORLDS, FILLED)
    assert_equal(packed.unpack(), state)
    filled = packed.unpack_filled()
    assert filled.step.tolist() == [10, 11, 12, 13, 13, 13]
    assert_equal(filled.vehicles.p[WORLDS:], jnp.stack([state.vehicles.p[-1]] * 2))


def test_worlds_are_selected_and_replaced(states):
    state, other, packed = states
    rows = jnp.array([2, 0, 3])
    assert_equal(packed.select(rows).unpack(), jax.tree.map(lambda leaf: leaf[rows], state))
    ended, rows = jnp.array([False, True, False, True]), jnp.array([0, 3, 1, 2])
    replaced = packed.replace_worlds(ended, PackedState.of(other, BLOCK, None), rows).unpack()
    source = [state, other, state, other]
    for world, row in enumerate([0, 3, 2, 2]):
        assert_equal(
            jax.tree.map(lambda leaf, world=world: leaf[world], replaced),
            jax.tree.map(lambda leaf, row=row: leaf[row], source[world]),
        )


def test_energies_are_replaced_alone(states):
    state, _, packed = states
    energy_j = jnp.arange(8.0).reshape(WORLDS, ROBOTS)
    expected = replace(state, tally=replace(state.tally, energy_j=energy_j))
    assert_equal(packed.replace_energy(energy_j).unpack(), expected)
