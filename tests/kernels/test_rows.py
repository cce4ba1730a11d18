"""Rows written in batches against `numpy`."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels.rows import write_row

ROWS = np.arange(2 * 3 * 4 * 5, dtype=np.float32).reshape(2, 3, 4, 5)
NEW_ROW = -np.ones((2, 3, 5), np.float32)


@pytest.mark.parametrize("index", [0, 3])
def test_all_of_a_batch_write_the_same_row(index):
    expected = ROWS.copy()
    expected[:, :, index] = NEW_ROW
    write = jax.jit(jax.vmap(jax.vmap(write_row, (0, 0, None)), (0, 0, None)))
    np.testing.assert_array_equal(write(ROWS, NEW_ROW, index), expected)
    assert "scatter" not in write.lower(ROWS, NEW_ROW, index).as_text()


def test_each_of_a_batch_writes_a_row_of_its_own():
    index = np.array([1, 2])
    expected = ROWS[:, 0].copy()
    expected[np.arange(2), index] = NEW_ROW[:, 0]
    written = jax.vmap(write_row)(ROWS[:, 0], NEW_ROW[:, 0], index)
    np.testing.assert_array_equal(written, expected)


def test_rows_that_are_the_same_in_all_of_a_batch_are_written_too():
    rows = {"flag": jnp.zeros(3, bool), "position": jnp.zeros((3, 2))}

    def write(value):
        return write_row(rows, {"flag": jnp.array(True), "position": jnp.full(2, value)}, 2)

    written = jax.vmap(write)(jnp.arange(4.0))
    np.testing.assert_array_equal(written["flag"][:, 2], np.ones(4, bool))
    np.testing.assert_array_equal(written["position"][:, 2, 1], np.arange(4.0))
    np.testing.assert_array_equal(written["position"][:, :2], np.zeros((4, 2, 2)))
