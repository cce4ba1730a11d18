"""Cellular automaton on a regular 3-D grid of walls (True) and free cells (False).

The neighbourhood is Moore's: the 26 cells of the surrounding 3x3x3 block. Everything outside the
grid counts as free, so walls thin out at the faces.
"""

import jax
import jax.numpy as jnp


def neighbour_count(wall: jax.Array) -> jax.Array:
    """Number of walls among the 26 neighbours of each cell.

    The 3x3x3 box sum is separable: three sums of three along the axes, minus the cell itself.

    Args:
        wall: bool [nx, ny, nz].

    Returns:
        int32 [nx, ny, nz], 0 to 26.
    """
    total = wall.astype(jnp.int32)
    for axis in range(3):
        pad = [(1, 1) if other == axis else (0, 0) for other in range(3)]
        padded = jnp.pad(total, pad)
        n = total.shape[axis]
        total = sum(
            (jax.lax.slice_in_dim(padded, shift, shift + n, axis=axis) for shift in (1, 2)),
            start=jax.lax.slice_in_dim(padded, 0, n, axis=axis),
        )
    return total - wall


def step(wall: jax.Array, die_below: int, born_above: int) -> jax.Array:
    """Apply the rule once to all cells at the same time.

    A wall with fewer than ``die_below`` neighbouring walls becomes free; a free cell with more
    than ``born_above`` becomes a wall. [A. Agrawal's generator of 2024 uses 2 and 12.]

    Args:
        wall: bool [nx, ny, nz].
        die_below: 0 to 27; 0 lets no wall die.
        born_above: -1 to 26; 26 lets none be born.

    Returns:
        bool [nx, ny, nz].
    """
    count = neighbour_count(wall)
    return jnp.where(wall, count >= die_below, count > born_above)
