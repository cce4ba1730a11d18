"""Shortest ways against Dijkstra's algorithm, straight lines against dense sampling."""

import numpy as np
import pytest

from angler_kernels.bit_grid import pack_grid
from angler_mjx.world.difficulty import line_is_free, open_path_lengths, shortest_paths

from ..compiling import quickly
from ..lattice import least_costs

SHAPE = (9, 9, 9)
N_RANDOM, N_GATES, N_PAIR = 40, 3, 3
N_WORLD = N_RANDOM + N_GATES
lines = quickly(line_is_free)


def gates(axis):
    """Walls with gates at opposite ends along an axis: most rounds of the search."""
    free = np.ones(SHAPE, bool)
    for i in range(1, 9, 2):
        wall = np.zeros((9, 9), bool)
        wall[(0, 0) if i % 4 == 1 else (8, 8)] = True
        free[i] = wall
    return np.moveaxis(free, 0, axis)


@pytest.fixture(scope="module")
def found():
    """Passable cells, starts, goals and what was found; the worlds with gates are the last."""
    rng = np.random.default_rng(8)
    random = rng.random((*SHAPE, N_RANDOM)) > rng.uniform(0, 0.6, N_RANDOM)
    passable = np.concatenate([random, np.stack([gates(k) for k in range(3)], axis=-1)], axis=-1)
    start, goal = rng.integers(0, 9, (2, 3, N_PAIR, N_WORLD))
    start[..., N_RANDOM:], goal[..., N_RANDOM:] = 0, 8

    @quickly
    def find(passable, *ends):
        return shortest_paths(pack_grid(passable), SHAPE[2], *ends)

    return passable, start, goal, np.asarray(find(passable, start, goal))


def expected(passable, start, goal, pair, world):
    length = least_costs(passable[..., world], tuple(goal[:, pair, world]))
    return length[tuple(start[:, pair, world])]


def test_ways_are_as_long_as_dijkstras(found):
    *worlds, length = found
    for world in range(N_RANDOM):
        for pair in range(N_PAIR):
            # In units of 2^-18 the root of 2 is 370,727.6: it is rounded up by 1.08e-6 of itself;
            # and float32.
            assert length[pair, world] == pytest.approx(expected(*worlds, pair, world), rel=1.2e-6)
    assert np.isfinite(length).any()
    assert np.isinf(length).any()


def test_a_way_that_turns_back_again_and_again_is_found(found):
    *worlds, length = found
    for world in range(N_RANDOM, N_WORLD):
        shortest = expected(*worlds, 0, world)
        assert 3 * 8 < shortest < np.inf
        assert length[0, world] == pytest.approx(shortest, rel=1e-6)


def test_ways_through_open_water_are_dijkstras_too():
    """Where the passable cells are a box, which an edge of the grid or the floor makes smaller."""
    rng = np.random.default_rng(3)
    passable = np.zeros((*SHAPE, 4), bool)
    for world, (low, high) in enumerate(
        [
            ((0, 0, 0), (9, 9, 9)),
            ((1, 1, 1), (8, 8, 8)),
            ((0, 0, 3), (9, 9, 9)),
            ((4, 0, 0), (5, 9, 9)),
        ]
    ):
        passable[(*(slice(a, b) for a, b in zip(low, high, strict=True)), world)] = True
    start, goal = rng.integers(0, 9, (2, 3, 30, 4))
    find = quickly(lambda passable, *ends: open_path_lengths(pack_grid(passable), SHAPE[2], *ends))
    length = np.asarray(find(passable, start, goal))
    for world in range(4):
        costs = [least_costs(passable[..., world], tuple(cell)) for cell in goal[..., world].T]
        right = [cost[tuple(c)] for cost, c in zip(costs, start[..., world].T, strict=True)]
        np.testing.assert_allclose(length[:, world], right, rtol=1.2e-6)
    assert np.isinf(length).any()


def test_line_of_sight_equals_dense_sampling():
    rng = np.random.default_rng(2)
    occupied = rng.random((N_WORLD, *SHAPE)) < 0.08
    ends = rng.uniform(0, SHAPE, (2, N_WORLD, 3))
    last = np.moveaxis(occupied, 0, -1), *np.moveaxis(ends, 1, -1)
    free = np.asarray(lines(*last))
    share = np.linspace(0, 1, 20001)[:, None]
    for world, start, goal, found in zip(occupied, *ends, free, strict=True):
        cells = np.minimum(np.floor(start + share * (goal - start)), np.array(SHAPE) - 1)
        assert found == (not world[tuple(cells.astype(int).T)].any())
    assert 0 < free.sum() < N_WORLD


def test_lines_along_an_axis_and_through_edges():
    occupied = np.zeros((*SHAPE, N_WORLD), bool)
    occupied[2, 1, 1] = True
    start = np.full((3, N_WORLD), 1.5)
    # Along each axis; and a diagonal between two cells that touches the occupied one in an edge.
    way = np.zeros((3, N_WORLD))
    way[:, :4] = np.array([[2, 0, 0], [0, 2, 0], [0, 0, 2], [1, 1, 0]]).T
    free = np.asarray(lines(occupied, start, start + way))
    np.testing.assert_array_equal(free[:4], [False, True, True, True])
