"""Cellular automaton on a regular 3-D grid of walls (1) and free cells (0), 32 cells at a time.

The neighbourhood is Moore's: the 26 cells of the surrounding 3x3x3 block. Everything outside the
grid counts as free, so walls thin out at the faces. Counts are kept bit by bit: one word holds the
units of 32 cells, the next their twos, and so on; full adders add them (carry-save addition).
"""

from functools import reduce

import jax
import jax.numpy as jnp

from angler_kernels.bit_grid import full_grid, shift_grid

type BinaryCount = list[jax.Array]
"""Binary digits of a number in each cell, the lowest first: one packed grid per digit."""


def block_count(wall: jax.Array, nz: int) -> BinaryCount:
    """Count the walls in the 3x3x3 block about each cell, itself included.

    The sum is separable: three sums of three along the axes.

    Args:
        wall: packed, [nx, ny, words, ...] (see `angler_kernels.bit_grid`).
        nz: cells along z.

    Returns:
        Five digits of 0 to 27.
    """
    count, max_count = [wall], 1
    for axis in (2, 1, 0):
        before, after = ([shift_grid(digit, axis, step, nz) for digit in count] for step in (1, -1))
        max_count *= 3
        count = _add_three(before, count, after)[: max_count.bit_length()]
    return count


def apply_rule(wall: jax.Array, die_below: int, born_above: int, nz: int) -> jax.Array:
    """Apply the rule once to all cells at the same time.

    A wall with fewer than ``die_below`` neighbouring walls becomes free; a free cell with more
    than ``born_above`` becomes a wall. [A. Agrawal's generator of 2024 uses 2 and 12.]

    Args:
        wall: packed, [nx, ny, words, ...].
        die_below: 0 to 27; 0 lets no wall die.
        born_above: -1 to 26; 26 lets none be born.
        nz: cells along z.

    Returns:
        As ``wall``.
    """
    count = block_count(wall, nz)
    full = full_grid((wall.shape[0], wall.shape[1], nz))
    inside = full.reshape(full.shape + (1,) * (wall.ndim - 3))
    # The block of a wall holds the wall itself, so one more than its neighbours.
    is_staying = _reaches_minimum(count, die_below + 1)
    is_born = _reaches_minimum(count, born_above + 1)
    return (wall & is_staying | ~wall & is_born) & inside


def _add_three(a: BinaryCount, b: BinaryCount, c: BinaryCount) -> BinaryCount:
    """Return the digits of a + b + c, numbers of as many digits."""
    ones, carries = zip(
        *(_full_adder(*digits) for digits in zip(a, b, c, strict=True)), strict=True
    )
    # The sum is that of `ones`, and of `carries` one place higher: added with ripple carry.
    total, carry = [ones[0]], jnp.zeros_like(ones[0])
    for unit, other in zip(ones[1:], carries[:-1], strict=True):
        digit, carry = _full_adder(unit, other, carry)
        total.append(digit)
    return [*total, carries[-1] ^ carry, carries[-1] & carry]


def _full_adder(a: jax.Array, b: jax.Array, c: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return digit and carry of a + b + c."""
    half = a ^ b
    return half ^ c, a & b | c & half


def _reaches_minimum(count: BinaryCount, minimum: int) -> jax.Array:
    """Return all bits set where the count is at least a number."""
    if minimum <= 0:
        return jnp.full_like(count[0], ~jnp.uint32(0))
    if minimum >= 1 << len(count):
        return jnp.zeros_like(count[0])
    # From the lowest digit up: a higher digit decides unless it is equal.
    equal = jnp.full_like(count[0], ~jnp.uint32(0))
    digits = enumerate(count)
    return reduce(
        lambda reached, d: d[1] & reached if minimum >> d[0] & 1 else d[1] | reached, digits, equal
    )
