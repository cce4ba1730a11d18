"""Shortest ways against Dijkstra's algorithm, straight lines against dense sampling."""

import jax
import numpy as np
import pytest

from angler_mjx.world.difficulty import line_is_free, shortest_ways

SHAPE = (7, 6, 5)
N_WORLD, N_PAIR = 40, 3


@pytest.fixture(scope="module")
def worlds():
    rng = np.random.default_rng(8)
    passable = rng.random((N_WORLD, *SHAPE)) > rng.uniform(0, 0.6, (N_WORLD, 1, 1, 1))
    start, goal = rng.integers(0, SHAPE, (2, N_WORLD, N_PAIR, 3))
    return passable, start, goal


def test_ways_are_as_long_as_dijkstras(worlds, dijkstra):
    ways = np.asarray(jax.jit(jax.vmap(shortest_ways))(*worlds))
    for passable, start, goal, found in zip(*worlds, ways, strict=True):
        expected = [
            dijkstra(passable, tuple(g))[tuple(s)] for s, g in zip(start, goal, strict=True)
        ]
        # Sums of at most 50 float32 terms: relative rounding below 50 * 6e-8.
        np.testing.assert_allclose(found, expected, rtol=3e-6)
    assert np.isfinite(ways).any()
    assert np.isinf(ways).any()


def test_line_of_sight_equals_dense_sampling():
    rng = np.random.default_rng(2)
    occupied = rng.random((N_WORLD, *SHAPE)) < 0.08
    ends = rng.uniform(0, SHAPE, (2, N_WORLD, 3))
    free = np.asarray(jax.jit(jax.vmap(line_is_free))(occupied, *ends))
    share = np.linspace(0, 1, 20001)[:, None]
    for world, start, goal, found in zip(occupied, *ends, free, strict=True):
        cells = np.minimum(np.floor(start + share * (goal - start)), np.array(SHAPE) - 1)
        assert found == (not world[tuple(cells.astype(int).T)].any())
    assert 0 < free.sum() < N_WORLD


@pytest.mark.parametrize(("axis", "meets"), [(0, True), (1, False), (2, False)])
def test_lines_along_an_axis_and_through_edges(axis, meets):
    occupied = np.zeros((4, 4, 4), bool)
    occupied[2, 1, 1] = True
    start = np.array([1.5, 1.5, 1.5])
    assert bool(line_is_free(occupied, start, start + 2 * np.eye(3)[axis])) != meets
    # A diagonal between two cells that touches the occupied one in an edge only.
    assert line_is_free(occupied, start, start + np.array([1.0, 1.0, 0.0]))
