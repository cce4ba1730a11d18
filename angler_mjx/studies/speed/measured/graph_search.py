"""Speed of one processor core in graph search, the work of a planner on the host.

One search is Dijkstra's from a corner to every free cell of a fixed lattice with rock, in compiled
code of SciPy on one core. Its processor time is taken, so that other programs of the machine count
little. The time limits of ANGLER-1 are those of a core with the rate `REFERENCE_SEARCHES_PER_S`;
`time_factor` says how many times as long another core needs.
"""

import time

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from angler_mjx.errors import RunError
from angler_mjx.studies.speed.rows import (
    MIN_REPEATS,
    SpeedRow,
    check_repeats,
    iterate_turns,
    summarise_rates,
)

SIZE, ROCK_PERCENT = 16, 6
"""Cells along each edge, and rock among them, as in a reef."""
SEARCHES = 8
"""In one turn, from each corner."""
REFERENCE_SEARCHES_PER_S = 1700.0
"""Of the reference core, one of an Intel Xeon of a cloud server."""


def measure(*, repeats: int) -> SpeedRow:
    """Time searches on one core.

    Args:
        repeats: timed turns.

    Returns:
        Rates in searches/s of processor time; ``extra`` has ``time_factor``, by the fastest turn:
        the others shared caches and clock with other programs.

    Raises:
        ConfigError: too few repeats.
        RunError: a search does not come out as it must.
    """
    check_repeats(repeats)
    lattice, corners = build_lattice()
    rates = []
    for is_counted in iterate_turns(repeats):
        begin = time.thread_time()
        lengths = dijkstra(lattice, indices=corners)
        seconds = time.thread_time() - begin
        if is_counted:
            rates.append(SEARCHES / seconds)
    _require_symmetry(lengths[:, corners])
    rate = summarise_rates(rates)
    return SpeedRow(
        workload="search",
        inside="shortest paths from each corner of one lattice with rock, on one core",
        worlds=1,
        robots=1,
        unit="searches/s",
        **rate,
        compile_s=None,
        flops_from="searches compare and add; their operations are not counted",
        extra={"time_factor": REFERENCE_SEARCHES_PER_S / rate["high"]},
    )


def measure_time_factor() -> float:
    """Return how many times as long as the reference core a core of this machine needs.

    Raises:
        RunError: a search does not come out as it must.
    """
    return measure(repeats=20 * MIN_REPEATS).extra["time_factor"]


def build_lattice() -> tuple[csr_array, list[int]]:
    """Return the lattice, weights being lengths in cells, and its corners.

    Rock is chosen by a formula in whole numbers: it is the same with every library. Each free cell
    is joined with its up to 26 free neighbours.
    """
    cells = np.stack(np.meshgrid(*[np.arange(SIZE)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    mixed = (cells[:, 0] * 73856093) ^ (cells[:, 1] * 19349663) ^ (cells[:, 2] * 83492791)
    is_free = mixed % 100 >= ROCK_PERCENT
    is_corner = np.all((cells == 0) | (cells == SIZE - 1), axis=-1)
    is_free |= is_corner
    sources, targets, lengths = [], [], []
    for step in np.stack(np.meshgrid(*[(-1, 0, 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3):
        moved = cells + step
        is_inside = np.all((moved >= 0) & (moved < SIZE), axis=-1) & bool(step.any())
        first = np.flatnonzero(is_inside & is_free)
        second = np.ravel_multi_index(tuple(moved[first].T), (SIZE, SIZE, SIZE))
        is_joined = is_free[second]
        sources.append(first[is_joined])
        targets.append(second[is_joined])
        lengths.append(np.full(int(is_joined.sum()), np.linalg.norm(step)))
    edges = (np.concatenate(sources), np.concatenate(targets))
    lattice = csr_array((np.concatenate(lengths), edges), shape=(SIZE**3, SIZE**3))
    return lattice, [int(corner) for corner in np.flatnonzero(is_corner)]


def _require_symmetry(lengths: np.ndarray) -> None:
    """Require that ways between corners are finite and as long in both directions."""
    if not (np.all(np.isfinite(lengths)) and np.allclose(lengths, lengths.T, rtol=1e-9)):
        raise RunError("workload search: lengths of shortest paths are wrong")
