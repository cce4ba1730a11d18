"""The map of a grid's cells that balls are swept among: made once for each problem, compiled."""

import numpy as np

from angler_mjx.planning.host.compiled.compiling import compiled

_STEPS = np.array([(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)], np.int64)
"""[27, 3] of the neighbour whose bit is the row's number, as in `cells`."""
_PLACE = np.full(37, -1, np.int64)
"""Which bit a word of one bit has set, by its remainder."""
_PLACE[[(1 << bit) % 37 for bit in range(27)]] = np.arange(27)
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

NOWHERE = 1 << 20
"""Rings around a cell of a grid without rock."""


@compiled
def words(occupied: np.ndarray) -> np.ndarray:
    """What stands around each cell of a grid, for the functions of `cells`.

    Args:
        occupied: bool [nx, ny, nz].

    Returns:
        int32 [2, nx, ny, nz]: the word of neighbours, and in how many rings around the cell, or
        more, no rock is met, the cell itself being the first: 0 or 1, until `measure` is called.
    """
    nx, ny, nz = occupied.shape
    found = np.zeros((2, nx, ny, nz), np.int32)
    word, rings = found[0], found[1]
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if occupied[i, j, k]:
                    _tell(word, i, j, k)
                else:
                    rings[i, j, k] = 1
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if word[i, j, k] != 0:
                    word[i, j, k] = _first_met(word[i, j, k])
    return found


@compiled
def measure(cells: np.ndarray) -> None:
    """Counts all rings of what `words` gave, in place: what looks far around is quicker then."""
    rings = cells[1]
    nx, ny, nz = rings.shape
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if rings[i, j, k] != 0:
                    rings[i, j, k] = NOWHERE
    line = np.empty(nz, np.int32)
    for i in range(nx):
        for j in range(ny):
            _spread(rings, line, i, j, -1)
    for i in range(nx - 1, -1, -1):
        for j in range(ny - 1, -1, -1):
            _spread(rings, line, i, j, 1)


@compiled
def _tell(word: np.ndarray, i: int, j: int, k: int) -> None:
    """Sets, in all cells around a cell of rock, the bit that it has from there."""
    nx, ny, nz = word.shape
    for u in range(max(i - 1, 0), min(i + 2, nx)):
        for v in range(max(j - 1, 0), min(j + 2, ny)):
            for w in range(max(k - 1, 0), min(k + 2, nz)):
                word[u, v, w] |= 1 << (9 * (i - u + 1) + 3 * (j - v + 1) + (k - w + 1))


@compiled
def _first_met(word: int) -> int:
    """A word without the bits of what stands behind others."""
    kept, left = word, word
    while left != 0:
        bit = _PLACE[(left & -left) % 37]
        if word & _HIDERS[bit]:
            kept &= ~(1 << bit)
        left &= left - 1
    return kept


@compiled
def _spread(rings: np.ndarray, line: np.ndarray, i: int, j: int, step: int) -> None:
    """Brings a line of cells up to date with those before it in a pass over the grid."""
    nx, ny, nz = rings.shape
    own = rings[i, j]
    line[:] = NOWHERE
    if 0 <= i + step < nx:
        for v in range(max(j - 1, 0), min(j + 2, ny)):
            beside = rings[i + step, v]
            for k in range(nz):
                line[k] = min(line[k], beside[k])
    if 0 <= j + step < ny:
        beside = rings[i, j + step]
        for k in range(nz):
            line[k] = min(line[k], beside[k])
    for k in range(nz):
        near = line[k]
        if k > 0:
            near = min(near, line[k - 1])
        if k + 1 < nz:
            near = min(near, line[k + 1])
        own[k] = min(own[k], near + 1)
    if step < 0:
        for k in range(1, nz):
            own[k] = min(own[k], own[k - 1] + 1)
    else:
        for k in range(nz - 2, -1, -1):
            own[k] = min(own[k], own[k + 1] + 1)
