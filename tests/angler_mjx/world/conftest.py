"""Independent searches that several tests of the world compare with."""

import heapq
import itertools

import numpy as np
import pytest

MOVES = [move for move in itertools.product((-1, 0, 1), repeat=3) if any(move)]


def _dijkstra(passable, start):
    """Length from a cell to every cell; 26 moves, none of them past a blocked corner."""
    length = np.full(passable.shape, np.inf)
    if not passable[start]:
        return length
    length[start] = 0.0
    heap = [(0.0, start)]
    while heap:
        so_far, cell = heapq.heappop(heap)
        if so_far > length[cell]:
            continue
        for move in MOVES:
            to = tuple(np.add(cell, move))
            if min(to) < 0 or any(c >= n for c, n in zip(to, passable.shape, strict=True)):
                continue
            block = tuple(slice(min(c, t), max(c, t) + 1) for c, t in zip(cell, to, strict=True))
            new = so_far + np.linalg.norm(move)
            if passable[block].all() and new < length[to]:
                length[to] = new
                heapq.heappush(heap, (new, to))
    return length


@pytest.fixture(scope="session")
def dijkstra():
    return _dijkstra
