"""Search on one core: its lattice, its lengths by another search, and the factor of a machine."""

import heapq
import math

import pytest
from scipy.sparse.csgraph import dijkstra

from angler_mjx.errors import ConfigError
from angler_mjx.studies.speed.measured import graph_search


def search(first):
    """Return the lengths from a cell by a search over dictionaries, with rock by its formula."""
    size = graph_search.SIZE

    def is_free(cell):
        if all(x in (0, size - 1) for x in cell):
            return True
        i, j, k = cell
        return ((i * 73856093) ^ (j * 19349663) ^ (k * 83492791)) % 100 >= 6

    lengths, waiting = {}, [(0.0, first)]
    while waiting:
        length, cell = heapq.heappop(waiting)
        if cell in lengths:
            continue
        lengths[cell] = length
        for step in ((i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)):
            there = tuple(x + d for x, d in zip(cell, step, strict=True))
            if all(0 <= x < size for x in there) and there not in lengths and is_free(there):
                heapq.heappush(waiting, (length + math.hypot(*step), there))
    return lengths


def test_lengths_are_those_of_another_search():
    lattice, corners = graph_search.build_lattice()
    expected = search((0, 0, 0))
    found = dijkstra(lattice, indices=corners[0])
    assert corners[0] == 0
    for (i, j, k), length in expected.items():
        assert found[(i * 16 + j) * 16 + k] == pytest.approx(length)
    # About six percent are rock, which nothing reaches.
    assert math.isinf(found.max())
    assert 0.92 < len(expected) / 16**3 < 0.96


def test_a_row_has_the_factor_of_the_fastest_turn():
    row = graph_search.measure(repeats=10)
    assert row.unit == "searches/s"
    assert 0.0 < row.low <= row.median <= row.high
    expected = graph_search.REFERENCE_SEARCHES_PER_S / row.high
    assert row.extra["time_factor"] == pytest.approx(expected)


def test_the_factor_follows_the_processor_time_of_a_search(monkeypatch):
    """A clock that counts half a second for each turn of eight searches."""
    clock = iter(0.5 * i for i in range(10**6))
    monkeypatch.setattr(graph_search.time, "thread_time", lambda: next(clock))
    row = graph_search.measure(repeats=10)
    assert row.median == pytest.approx(16.0)
    assert row.extra["time_factor"] == pytest.approx(1700.0 / 16.0)


def test_fewer_than_ten_repeats_are_refused():
    with pytest.raises(ConfigError, match="at least 10"):
        graph_search.measure(repeats=3)
