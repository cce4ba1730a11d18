"""The automaton's rule, cell by cell, against an independent reading of it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels.cellular_automaton import neighbour_count, step

SHAPE = (5, 7, 6)


def count_by_hand(wall):
    count = np.zeros(wall.shape, int)
    for i, j, k in np.ndindex(wall.shape):
        block = wall[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2, max(k - 1, 0) : k + 2]
        count[i, j, k] = block.sum() - wall[i, j, k]
    return count


@pytest.fixture(scope="module")
def walls():
    rng = np.random.default_rng(3)
    return rng.random((20, *SHAPE)) < np.linspace(0.02, 0.9, 20)[:, None, None, None]


def test_count_is_that_of_the_surrounding_block(walls):
    count = jax.jit(jax.vmap(neighbour_count))(walls)
    np.testing.assert_array_equal(count, [count_by_hand(wall) for wall in walls])


@pytest.mark.parametrize(("die_below", "born_above"), [(2, 12), (6, 8), (0, 26)])
def test_rule_is_applied_to_all_cells_at_once(walls, die_below, born_above):
    after = jax.jit(jax.vmap(lambda wall: step(wall, die_below, born_above)))(walls)
    for wall, result in zip(walls, np.asarray(after), strict=True):
        count = count_by_hand(wall)
        expected = np.where(wall, ~(count < die_below), count > born_above)
        np.testing.assert_array_equal(result, expected)


def test_outside_counts_as_free():
    assert neighbour_count(jnp.ones((3, 3, 3), bool))[0, 0, 0] == 7
