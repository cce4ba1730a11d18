"""Packed grids against boolean ones."""

import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels.bit_grid import count_cells, full_grid, pack_grid, shift_grid, unpack_grid

# Columns of part of a word, of just one, of one and a bit, and of two.
HEIGHTS = (5, 32, 33, 64)


@pytest.fixture(params=HEIGHTS)
def cells(request):
    return np.random.default_rng(request.param).random((4, 3, request.param, 2)) < 0.5


def test_a_packed_grid_holds_the_same_cells(cells):
    nz = cells.shape[2]
    grid = pack_grid(jnp.asarray(cells))
    assert grid.shape == (4, 3, -(-nz // 32), 2)
    np.testing.assert_array_equal(unpack_grid(grid, nz), cells)
    np.testing.assert_array_equal(count_cells(grid), cells.sum(axis=(0, 1, 2)))
    assert count_cells(full_grid(cells.shape[:3])) == cells[..., 0].size


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("step", [1, -1])
def test_a_shift_moves_every_cell_by_one_and_brings_in_nothing(cells, axis, step):
    nz = cells.shape[2]
    expected = np.roll(cells, step, axis)
    came_in = [slice(None)] * 3
    came_in[axis] = 0 if step == 1 else -1
    expected[tuple(came_in)] = False
    moved = shift_grid(pack_grid(jnp.asarray(cells)), axis, step, nz)
    # Packed grids are equal only if no bit is left above the grid.
    np.testing.assert_array_equal(moved, pack_grid(jnp.asarray(expected)))
