"""Look-ups by bisection against numpy's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import table

from ..angler_mjx.compiling import quickly


@pytest.mark.parametrize("n", [1, 2, 3, 16, 17, 201])
def test_counts_are_those_of_searchsorted(n):
    rng = np.random.default_rng(n)
    # Whole numbers: many ties among the entries, and most values are entries.
    entries = np.sort(rng.integers(0, max(2, n // 2), n)).astype(np.float32)
    values = np.concatenate([entries, entries + 0.5, [-1.0, 1e6, -np.inf, np.inf]])
    below, not_above = quickly(
        jax.vmap(lambda v: (table.count_below(entries, v), table.count_not_above(entries, v)))
    )(jnp.asarray(values, jnp.float32))
    np.testing.assert_array_equal(below, np.searchsorted(entries, values, "left"))
    np.testing.assert_array_equal(not_above, np.searchsorted(entries, values, "right"))
    assert below.dtype == not_above.dtype == jnp.int32


@pytest.mark.parametrize("n", [1, 2, 17, 201])
def test_the_last_not_above_is_found_from_any_place(n):
    rng = np.random.default_rng(n)
    entries = np.sort(rng.integers(0, max(2, n // 2), n)).astype(np.float32)
    values = np.concatenate([entries, entries + 0.5, [-1.0, 1e6, np.nan]])
    near = rng.integers(0, n, values.size)
    found = quickly(jax.vmap(table.last_not_above, (None, 0, 0)))(
        jnp.asarray(entries), jnp.asarray(values, jnp.float32), jnp.asarray(near, jnp.int32)
    )
    expected = np.maximum(np.searchsorted(entries, values, "right") - 1, 0)
    expected[np.isnan(values)] = 0
    np.testing.assert_array_equal(found, expected)
    assert found.dtype == jnp.int32


def test_nothing_is_below_nan():
    entries = jnp.arange(5.0)
    assert table.count_below(entries, jnp.nan) == 0
    assert table.count_not_above(entries, jnp.nan) == 0


def test_takes_rows_of_any_shape():
    rows = np.random.default_rng(0).normal(size=(7, 2, 3)).astype(np.float32)
    for i in range(7):
        np.testing.assert_array_equal(table.take_row(jnp.asarray(rows), jnp.int32(i)), rows[i])
