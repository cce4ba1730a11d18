"""Shortest ways over the cells of a grid, by scipy: several tests compare with them."""

import itertools

import numpy as np
from scipy.sparse import coo_array, csgraph

MOVES = [move for move in itertools.product((-1, 0, 1), repeat=3) if any(move)]
STRAIGHT = (1.0, 2.0**0.5, 3.0**0.5)


def least_costs(passable, start, cost=STRAIGHT):
    """Least cost from a cell to every cell; 26 moves, none of them past a blocked corner.

    Args:
        passable: bool [nx, ny, nz].
        start: cell.
        cost: of a move along one, two and three axes.
    """
    number = np.arange(passable.size).reshape(passable.shape)
    edges = []
    for move in MOVES:
        # Cells from which this move stays inside, and all cells of the block that it goes through.
        here = [slice(max(0, -m), n - max(0, m)) for m, n in zip(move, passable.shape, strict=True)]
        free = np.ones(number[tuple(here)].shape, bool)
        for part in itertools.product(*({0, m} for m in move)):
            there = [slice(s.start + p, s.stop + p) for s, p in zip(here, part, strict=True)]
            free &= passable[tuple(there)]
        to = [slice(s.start + m, s.stop + m) for s, m in zip(here, move, strict=True)]
        ends = number[tuple(here)][free], number[tuple(to)][free]
        edges.append((np.full(free.sum(), cost[sum(map(abs, move)) - 1]), *ends))
    length, begin, end = map(np.concatenate, zip(*edges, strict=True))
    graph = coo_array((length, (begin, end)), (passable.size,) * 2).tocsr()
    found = csgraph.dijkstra(graph, indices=number[tuple(start)]).reshape(passable.shape)
    return found if passable[tuple(start)] else np.full(passable.shape, np.inf)
