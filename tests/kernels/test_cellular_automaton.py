"""The automaton's rule, cell by cell, against an independent reading of it."""

import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels.bit_grid import pack_grid, unpack_grid
from angler_kernels.cellular_automaton import apply_rule, block_count

from ..angler_mjx.compiling import quickly

# Columns of 34 cells take a word and two bits of the next.
SHAPE = (5, 7, 34)
N_WORLD = 20


def count_by_hand(wall):
    count = np.zeros(wall.shape, int)
    for i, j, k in np.ndindex(SHAPE):
        block = wall[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2, max(k - 1, 0) : k + 2]
        count[i, j, k] = block.sum(axis=(0, 1, 2)) - wall[i, j, k]
    return count


@pytest.fixture(scope="module")
def walls():
    rng = np.random.default_rng(3)
    return rng.random((*SHAPE, N_WORLD)) < np.linspace(0.02, 0.9, N_WORLD)


def test_count_is_that_of_the_surrounding_block(walls):
    digits = quickly(lambda wall: block_count(pack_grid(wall), SHAPE[2]))(walls)
    count = sum(np.asarray(unpack_grid(d, SHAPE[2])) << i for i, d in enumerate(digits))
    np.testing.assert_array_equal(count - walls, count_by_hand(walls))
    # A block without a wall and a full one are both among the cases.
    assert set(np.unique(count)) >= {0, 27}


@pytest.mark.parametrize(("die_below", "born_above"), [(2, 12), (6, 8), (0, 26), (27, -1)])
def test_rule_is_applied_to_all_cells_at_once(walls, die_below, born_above):
    after = quickly(lambda wall: apply_rule(pack_grid(wall), die_below, born_above, SHAPE[2]))(
        walls
    )
    count = count_by_hand(walls)
    expected = np.where(walls, ~(count < die_below), count > born_above)
    np.testing.assert_array_equal(unpack_grid(after, SHAPE[2]), expected)
    # Nothing is born above the grid's upper face, in the unused bits of the last word.
    np.testing.assert_array_equal(after, pack_grid(jnp.asarray(expected)))


def test_outside_counts_as_free():
    digits = block_count(pack_grid(jnp.ones((3, 3, 3), bool)), 3)
    count = sum(np.asarray(unpack_grid(d, 3)) << i for i, d in enumerate(digits))
    assert count[0, 0, 0] == 8
