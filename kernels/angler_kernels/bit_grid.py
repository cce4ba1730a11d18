"""Boolean grids packed along z: bit k of word w of a column is the cell z = 32 w + k.

A packed grid is uint32 [nx, ny, words, ...]. Further axes, such as one of worlds, stand last: a
shift along the grid then moves whole runs of worlds, which both a CPU's vectors and a GPU's threads
read in one go. Bits above the grid's upper face are 0 in every result of `pack_grid` and
`shift_grid`.
"""

import jax
import jax.numpy as jnp
import numpy as np

WORD = 32
"""Cells in a word."""


def pack_grid(cells: jax.Array) -> jax.Array:
    """Return the packed grid, uint32 [nx, ny, words, ...], of a boolean grid [nx, ny, nz, ...]."""
    nx, ny, nz, *batch = cells.shape
    n_words = -(-nz // WORD)
    pad = [(0, 0), (0, 0), (0, n_words * WORD - nz)] + [(0, 0)] * len(batch)
    bits = jnp.pad(cells, pad).reshape(nx, ny, n_words, WORD, *batch)
    bit = np.arange(WORD, dtype=np.uint32).reshape(WORD, *[1] * len(batch))
    return jnp.sum(bits.astype(jnp.uint32) << bit, axis=3, dtype=jnp.uint32)


def unpack_grid(grid: jax.Array, nz: int) -> jax.Array:
    """Return the boolean grid [nx, ny, nz, ...] of a packed grid [nx, ny, words, ...]."""
    bit = (np.arange(nz) % WORD).astype(np.uint32).reshape(nz, *[1] * (grid.ndim - 3))
    return (jnp.repeat(grid, WORD, axis=2)[:, :, :nz] >> bit & 1).astype(bool)


def full_grid(shape: tuple[int, int, int]) -> jax.Array:
    """Return a packed grid [nx, ny, words] with every cell set."""
    nx, ny, nz = shape
    return jnp.asarray(np.broadcast_to(_full_words(nz), (nx, ny, -(-nz // WORD))))


def count_cells(grid: jax.Array) -> jax.Array:
    """Count the set cells, int32 [...], of a packed grid [nx, ny, words, ...]."""
    return jnp.sum(jax.lax.population_count(grid), axis=(0, 1, 2), dtype=jnp.int32)


def shift_grid(grid: jax.Array, axis: int, step: int, nz: int) -> jax.Array:
    """Move the grid by one cell; cells that enter from outside are free (0).

    Args:
        grid: packed, [nx, ny, words, ...].
        axis: 0, 1, 2 for x, y, z.
        step: 1 towards greater indices, -1 towards smaller ones: cell i takes the value of cell i -
            step.
        nz: cells along z; a bit moved past them is dropped.
    """
    if axis < 2:
        return _shift_axis(grid, axis, step)
    if step == -1:
        return grid >> 1 | _shift_axis(grid, 2, -1) << (WORD - 1)
    moved = grid << 1 | _shift_axis(grid, 2, 1) >> (WORD - 1)
    if nz % WORD == 0:
        return moved
    return moved & _full_words(nz).reshape(-1, *[1] * (grid.ndim - 3))


def _full_words(nz: int) -> np.ndarray:
    """Return the words of a full column, uint32 [words]."""
    bits = [min(WORD, nz - low) for low in range(0, nz, WORD)]
    return np.array([(1 << n) - 1 for n in bits], np.uint32)


def _shift_axis(grid: jax.Array, axis: int, step: int) -> jax.Array:
    """Move the array by one along an axis and fill with zeros."""
    n = grid.shape[axis]
    pad = [(0, 0)] * grid.ndim
    pad[axis] = (1, 0) if step == 1 else (0, 1)
    start = 0 if step == 1 else 1
    return jax.lax.slice_in_dim(jnp.pad(grid, pad), start, start + n, axis=axis)
