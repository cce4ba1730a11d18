"""The map of a grid's cells that balls are swept among: made once for each problem, compiled."""

import numpy as np

from angler_mjx.planning.host.compiled.compiling import compile_function

_STEPS = np.array([(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)], np.int64)
"""[27, 3] of the neighbour whose bit is the row's number, as in `cells`."""
_BIT_OF_REMAINDER = np.full(37, -1, np.int64)
"""Which bit a word of one bit has set, by its remainder."""
_BIT_OF_REMAINDER[[(1 << bit) % 37 for bit in range(27)]] = np.arange(27)
_HIDERS = np.array(
    [
        sum(
            1 << other
            for other, near in enumerate(_STEPS)
            if other != bit and np.all((near == 0) | (near == step))
        )
        for bit, step in enumerate(_STEPS)
    ],
    np.int64,
)
"""Of each bit, those that stand before it."""

NO_ROCK = 1 << 20
"""Rings around a cell of a grid without rock."""


@compile_function
def build_cell_map(occupied: np.ndarray) -> np.ndarray:
    """Return the neighbourhood of each cell of a grid, for the functions of `cells`.

    Args:
        occupied: bool [nx, ny, nz].

    Returns:
        int32 [2, nx, ny, nz]: the word of neighbours, and in how many rings around the cell, or
        more, no rock is met, the cell itself being the first: 0 or 1, until `measure_rings` is
        called.
    """
    nx, ny, nz = occupied.shape
    cell_map = np.zeros((2, nx, ny, nz), np.int32)
    word, rings = cell_map[0], cell_map[1]
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if occupied[i, j, k]:
                    _mark_neighbours(word, i, j, k)
                else:
                    rings[i, j, k] = 1
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if word[i, j, k] != 0:
                    word[i, j, k] = _visible_bits(word[i, j, k])
    return cell_map


@compile_function
def measure_rings(cells: np.ndarray) -> None:
    """Count all rings of a map of `build_cell_map` in place, for queries of large radii."""
    rings = cells[1]
    nx, ny, nz = rings.shape
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if rings[i, j, k] != 0:
                    rings[i, j, k] = NO_ROCK
    line = np.empty(nz, np.int32)
    for i in range(nx):
        for j in range(ny):
            _relax_line(rings, line, i, j, -1)
    for i in range(nx - 1, -1, -1):
        for j in range(ny - 1, -1, -1):
            _relax_line(rings, line, i, j, 1)


@compile_function
def _mark_neighbours(word: np.ndarray, i: int, j: int, k: int) -> None:
    """Set the bit of a cell of rock in all cells around it."""
    nx, ny, nz = word.shape
    for u in range(max(i - 1, 0), min(i + 2, nx)):
        for v in range(max(j - 1, 0), min(j + 2, ny)):
            for w in range(max(k - 1, 0), min(k + 2, nz)):
                word[u, v, w] |= 1 << (9 * (i - u + 1) + 3 * (j - v + 1) + (k - w + 1))


@compile_function
def _visible_bits(word: int) -> int:
    """Return a word without the bits of cells that stand behind others."""
    kept, remaining = word, word
    while remaining != 0:
        bit = _BIT_OF_REMAINDER[(remaining & -remaining) % 37]
        if word & _HIDERS[bit]:
            kept &= ~(1 << bit)
        remaining &= remaining - 1
    return kept


@compile_function
def _relax_line(rings: np.ndarray, line: np.ndarray, i: int, j: int, step: int) -> None:
    """Update a line of cells from those before it in a pass over the grid."""
    nx, ny, nz = rings.shape
    ring_line = rings[i, j]
    line[:] = NO_ROCK
    if 0 <= i + step < nx:
        for v in range(max(j - 1, 0), min(j + 2, ny)):
            neighbours = rings[i + step, v]
            for k in range(nz):
                line[k] = min(line[k], neighbours[k])
    if 0 <= j + step < ny:
        neighbours = rings[i, j + step]
        for k in range(nz):
            line[k] = min(line[k], neighbours[k])
    for k in range(nz):
        nearest = line[k]
        if k > 0:
            nearest = min(nearest, line[k - 1])
        if k + 1 < nz:
            nearest = min(nearest, line[k + 1])
        ring_line[k] = min(ring_line[k], nearest + 1)
    if step < 0:
        for k in range(1, nz):
            ring_line[k] = min(ring_line[k], ring_line[k - 1] + 1)
    else:
        for k in range(nz - 2, -1, -1):
            ring_line[k] = min(ring_line[k], ring_line[k + 1] + 1)
