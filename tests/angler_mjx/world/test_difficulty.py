"""Shortest ways against Dijkstra's algorithm, straight lines against dense sampling."""

import jax
import numpy as np
import pytest

from angler_kernels.bit_grid import pack
from angler_mjx.world.difficulty import line_is_free, shortest_ways

SHAPE = (7, 6, 5)
N_WORLD, N_PAIR = 40, 3


@pytest.fixture(scope="module")
def worlds():
    rng = np.random.default_rng(8)
    passable = rng.random((*SHAPE, N_WORLD)) > rng.uniform(0, 0.6, N_WORLD)
    start, goal = np.stack([rng.integers(0, n, (2, N_PAIR, N_WORLD)) for n in SHAPE], axis=1)
    return passable, start, goal


def ways(passable, start, goal):
    find = jax.jit(lambda passable, *ends: shortest_ways(pack(passable), passable.shape[2], *ends))
    return np.asarray(find(passable, start, goal))


def test_ways_are_as_long_as_dijkstras(worlds, dijkstra):
    passable, start, goal = worlds
    found = ways(*worlds)
    for world in range(N_WORLD):
        for pair in range(N_PAIR):
            length = dijkstra(passable[..., world], tuple(goal[:, pair, world]))
            expected = length[tuple(start[:, pair, world])]
            # The lengths of diagonal moves are rounded by less than 8e-7 of themselves; float32.
            assert found[pair, world] == pytest.approx(expected, rel=1e-6)
    assert np.isfinite(found).any()
    assert np.isinf(found).any()


def test_a_way_that_turns_back_again_and_again_is_found(dijkstra):
    """Walls with gates at opposite ends, along each axis in turn: most rounds, fewest pairs."""
    for axis in range(3):
        free = np.ones((9, 9, 9), bool)
        for i in range(1, 9, 2):
            wall = np.zeros((9, 9), bool)
            wall[(0, 0) if i % 4 == 1 else (8, 8)] = True
            free[i] = wall
        free = np.moveaxis(free, 0, axis)
        ends = np.zeros((3, 1, 1), int), np.full((3, 1, 1), 8)
        expected = dijkstra(free, (8, 8, 8))[0, 0, 0]
        assert np.isfinite(expected)
        assert expected > 3 * 8
        assert ways(free[..., None], *ends)[0, 0] == pytest.approx(expected, rel=1e-6)


def test_line_of_sight_equals_dense_sampling():
    rng = np.random.default_rng(2)
    occupied = rng.random((N_WORLD, *SHAPE)) < 0.08
    ends = rng.uniform(0, SHAPE, (2, N_WORLD, 3))
    last = np.moveaxis(occupied, 0, -1), *np.moveaxis(ends, 1, -1)
    free = np.asarray(jax.jit(line_is_free)(*last))
    share = np.linspace(0, 1, 20001)[:, None]
    for world, start, goal, found in zip(occupied, *ends, free, strict=True):
        cells = np.minimum(np.floor(start + share * (goal - start)), np.array(SHAPE) - 1)
        assert found == (not world[tuple(cells.astype(int).T)].any())
    assert 0 < free.sum() < N_WORLD


@pytest.mark.parametrize(("axis", "meets"), [(0, True), (1, False), (2, False)])
def test_lines_along_an_axis_and_through_edges(axis, meets):
    occupied = np.zeros((4, 4, 4), bool)
    occupied[2, 1, 1] = True
    start = np.array([1.5, 1.5, 1.5], np.float32)
    assert (
        bool(line_is_free(occupied, start, start + 2 * np.eye(3, dtype=np.float32)[axis])) != meets
    )
    # A diagonal between two cells that touches the occupied one in an edge only.
    assert line_is_free(occupied, start, start + np.array([1, 1, 0], np.float32))
