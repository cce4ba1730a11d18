"""The GPU's program for lengths of ways, interpreted, against Dijkstra's algorithm by scipy."""

import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels.bit_grid import pack_grid
from angler_mjx.world.difficulty import by_kernel, in_cells

from ..lattice import least_costs

SHAPE = (7, 5, 9)
N_WORLD, N_PAIR = 6, 4


@pytest.fixture(scope="module")
def worlds():
    """From few walls to so many that some goals cannot be reached; and pairs of cells."""
    random = np.random.default_rng(11)
    free = random.random((*SHAPE, N_WORLD)) > np.linspace(0.05, 0.5, N_WORLD)
    ends = [[random.integers(0, n, (N_PAIR, N_WORLD)) for n in SHAPE] for _ in range(2)]
    return free, *(np.stack(end).astype(np.int32) for end in ends)


def test_lengths_are_those_of_dijkstra(worlds, block_form):
    free, start, goal = worlds
    length = block_form(by_kernel)(pack_grid(jnp.array(free)), SHAPE[2], start, goal)
    cells = np.asarray(in_cells(length))
    expected = np.empty((N_PAIR, N_WORLD))
    for pair, world in np.ndindex(N_PAIR, N_WORLD):
        costs = least_costs(free[..., world], tuple(goal[:, pair, world]))
        expected[pair, world] = costs[tuple(start[:, pair, world])]
    assert 0 < np.isinf(expected).sum() < expected.size / 2
    np.testing.assert_allclose(cells, expected, rtol=2e-6)


def test_lowers_for_cuda(worlds, lower_for_gpu):
    free, start, goal = worlds
    lower_for_gpu(
        lambda *given: by_kernel(given[0], SHAPE[2], *given[1:]),
        pack_grid(jnp.array(free)),
        start,
        goal,
    )
