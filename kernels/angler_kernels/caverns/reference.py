"""Free caverns of a regular 3-D grid: cells connected through faces (6-neighbourhood).

Labels spread by minimum over neighbours, and every cell also takes over the label of the cell that
its label names (pointer jumping), which shortens long ways by doubling. A bounded loop replaces
recursion, so no grid can overflow a stack.
"""

import math

import jax
import jax.numpy as jnp


def component_labels(free: jax.Array) -> jax.Array:
    """Label each free cell with the smallest flat index of its cavern.

    Args:
        free: bool [nx, ny, nz].

    Returns:
        int32 [nx, ny, nz]; flat index (row-major) of the first cell of the cavern; the number of
        cells of the grid where the cell is not free.
    """
    n = math.prod(free.shape)
    index = jnp.arange(n, dtype=jnp.int32).reshape(free.shape)
    start = jnp.where(free, index, n)

    def unfinished(carry: tuple[jax.Array, jax.Array, jax.Array]) -> jax.Array:
        _, changed, sweep = carry
        # Each sweep moves a label at least one cell, so n sweeps always suffice.
        return changed & (sweep < n)

    def spread(
        carry: tuple[jax.Array, jax.Array, jax.Array],
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        label, _, sweep = carry
        low = jnp.where(free, _neighbour_minimum(label, n), n)
        # Label n names one cell more, which says n: cheaper than asking for each label.
        jumped = jnp.append(low.ravel(), n)[low]
        return jumped, jnp.any(jumped != label), sweep + 1

    label, _, _ = jax.lax.while_loop(unfinished, spread, (start, jnp.array(True), jnp.int32(0)))
    return label


def largest_cavern(free: jax.Array) -> jax.Array:
    """Cells of the largest cavern; of equally large ones, that with the first cell in flat order.

    Args:
        free: bool [nx, ny, nz].

    Returns:
        bool [nx, ny, nz]; all False where nothing is free.
    """
    label = component_labels(free)
    n = math.prod(free.shape)
    size = jnp.zeros(n, jnp.int32).at[label.ravel()].add(1, mode="drop")
    return free & (label == jnp.argmax(size))


def _neighbour_minimum(label: jax.Array, outside: int) -> jax.Array:
    """Minimum of each cell and its six neighbours."""
    low = label
    for axis in range(3):
        pad = [(1, 1) if other == axis else (0, 0) for other in range(3)]
        padded = jnp.pad(label, pad, constant_values=outside)
        n = label.shape[axis]
        for shift in (0, 2):
            low = jnp.minimum(low, jax.lax.slice_in_dim(padded, shift, shift + n, axis=axis))
    return low
