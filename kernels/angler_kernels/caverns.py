"""Free caverns of a regular 3-D grid: cells connected through faces (6-neighbourhood).

A cavern is filled from its first cell, 32 cells to a word; then the next cavern, until the
remaining cells cannot hold a larger one. One bounded loop does both for all worlds of a batch, each
at its own pace, so no grid can overflow a stack and a world seldom waits.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from angler_kernels.bit_grid import count_cells, shift_grid

_SPREADS = 4
"""Cells that water spreads by between two tests whether it still rises. A test costs more than a
spread; one to three spreads in vain cost less than a test each time."""


class _CavernSearch(NamedTuple):
    """Search state: packed grids, and counts of cells."""

    unfilled: jax.Array
    """Cells of no filled cavern; the cavern being filled is still among them."""
    water: jax.Array
    """Filled cells of the present cavern."""
    best: jax.Array
    """Largest cavern so far."""
    best_size: jax.Array


def largest_cavern(free: jax.Array, nz: int) -> jax.Array:
    """Return cells of the largest cavern; of equal ones, the one with the first cell in flat order.

    Args:
        free: packed, [nx, ny, words, ...] (see `angler_kernels.bit_grid`).
        nz: cells along z.

    Returns:
        As ``free``; empty where nothing is free.
    """

    def is_unfinished(search: _CavernSearch) -> jax.Array:
        return jnp.any(search.best_size < count_cells(search.unfilled))

    def advance(search: _CavernSearch) -> _CavernSearch:
        water = search.water
        for _ in range(_SPREADS):
            water = _spread_water(water, free, nz)
        is_full = jnp.all(water == search.water, axis=(0, 1, 2))
        size = count_cells(water)
        is_larger = is_full & (size > search.best_size)
        unfilled = jnp.where(is_full, search.unfilled & ~water, search.unfilled)
        return _CavernSearch(
            unfilled=unfilled,
            water=jnp.where(is_full, _first_cell(unfilled), water),
            best=jnp.where(is_larger, water, search.best),
            best_size=jnp.where(is_larger, size, search.best_size),
        )

    empty = jnp.zeros_like(free)
    start = _CavernSearch(
        unfilled=free, water=_first_cell(free), best=empty, best_size=count_cells(empty)
    )
    return jax.lax.while_loop(is_unfinished, advance, start).best


def _spread_water(water: jax.Array, free: jax.Array, nz: int) -> jax.Array:
    """Return water and the free cells that share a face with it."""
    wet = water
    for axis in range(3):
        for step in (1, -1):
            wet = wet | shift_grid(water, axis, step, nz)
    # Without the barrier, XLA would fuse spreads and evaluate each seven times for the next.
    spread: jax.Array = jax.lax.optimization_barrier(wet & free)
    return spread


def _first_cell(grid: jax.Array) -> jax.Array:
    """Return the grid with only its first set cell in flat order; empty if the grid is."""
    nx, ny, n_words = grid.shape[:3]
    n = nx * ny * n_words
    flat = jnp.arange(n, dtype=jnp.int32).reshape(nx, ny, n_words, *[1] * (grid.ndim - 3))
    first = jnp.min(jnp.where(grid != 0, flat, n), axis=(0, 1, 2))
    # x & -x is the lowest bit of x.
    return jnp.where(flat == first, grid & -grid, 0)
