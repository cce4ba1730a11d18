"""Caverns against a plain breadth-first search."""

from collections import deque

import jax
import numpy as np
import pytest

from angler_kernels.bit_grid import pack_grid, unpack_grid
from angler_kernels.caverns import largest_cavern

SHAPE = (9, 8, 7)


def largest(free):
    """Largest caverns of boolean grids [nx, ny, nz, ...]."""
    find = jax.jit(lambda free: largest_cavern(pack_grid(free), free.shape[2]))
    return np.asarray(unpack_grid(find(free), free.shape[2]))


def labels_by_search(free):
    """Smallest flat index of each free cell's cavern; the number of cells elsewhere."""
    label = np.full(free.shape, free.size)
    for seed in zip(*np.nonzero(free), strict=True):
        if label[seed] < free.size:
            continue
        name = np.ravel_multi_index(seed, free.shape)
        label[seed] = name
        queue = deque([seed])
        while queue:
            cell = queue.popleft()
            for axis in range(3):
                for side in (-1, 1):
                    other = list(cell)
                    other[axis] += side
                    if not 0 <= other[axis] < free.shape[axis]:
                        continue
                    beside = tuple(other)
                    if free[beside] and label[beside] == free.size:
                        label[beside] = name
                        queue.append(beside)
    return label


@pytest.fixture(scope="module")
def worlds():
    """1,000 grids from nearly empty to nearly full."""
    rng = np.random.default_rng(11)
    return rng.random((1000, *SHAPE)) > rng.uniform(0.02, 0.95, (1000, 1, 1, 1))


@pytest.fixture(scope="module")
def searched(worlds):
    return np.stack([labels_by_search(free) for free in worlds])


def test_largest_cavern_equals_a_breadth_first_search_on_1000_seeds(worlds, searched):
    found = np.moveaxis(largest(np.moveaxis(worlds, 0, -1)), -1, 0)
    for free, label, kept in zip(worlds, searched, found, strict=True):
        sizes = np.bincount(label[free], minlength=free.size)
        # argmax takes the first of equals, which is the tie rule.
        np.testing.assert_array_equal(kept, free & (label == sizes.argmax()))


def test_of_equal_caverns_the_first_is_kept():
    free = np.zeros((2, 3, 5), bool)
    free[1, 1, :2] = free[1, 1, 3:] = True
    kept = largest(free)
    assert kept[1, 1].tolist() == [True, True, False, False, False]
    assert kept.sum() == 2


@pytest.mark.parametrize("some", [False, True])
def test_grids_without_choice(some):
    free = np.full((3, 4, 2), some)
    np.testing.assert_array_equal(largest(free), free)


def test_a_winding_tunnel_is_one_cavern():
    """Its columns are 41 cells high: more than a word."""
    n = 41
    free = np.zeros((15, 15, n), bool)
    free[::2, ::2, :] = True
    for layer in range(0, 15, 2):
        for row in range(1, 15, 2):
            free[layer, row, -1 if row % 4 == 1 else 0] = True
        if layer < 14:
            end = 0 if (layer // 2) % 2 else 14
            free[layer + 1, end, n - 1 if end == 0 else 0] = True
    assert set(np.unique(labels_by_search(free))) == {0, free.size}
    np.testing.assert_array_equal(largest(free), free)
    cut = free.copy()
    cut[6, 6, 20] = False
    sizes = np.bincount(labels_by_search(cut)[cut])
    assert largest(cut).sum() == sizes.max() < free.sum() - 1
