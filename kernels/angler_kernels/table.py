"""Rows of a table and indices in a sorted one, for one table and one value.

No function reads a whole table: a search touches as many entries as the binary digits of its
length, so tables may stay in memory while everything else is in registers.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

type Predicate = Callable[[jax.Array], jax.Array]


def take_row(table: jax.Array | np.ndarray, i: jax.Array) -> jax.Array:
    """Return row ``i`` [] of ``table`` [n, ...]; i must lie within [0, n)."""
    row: jax.Array = jax.lax.dynamic_index_in_dim(table, i, keepdims=False)
    return row


def count_below(table: jax.Array, value: jax.Array) -> jax.Array:
    """Count the entries (int32 []) of a non-decreasing ``table`` [n] less than ``value`` []."""
    return _count_prefix(table, lambda entry: entry < value)


def count_not_above(table: jax.Array, value: jax.Array) -> jax.Array:
    """Count the entries (int32 []) of a non-decreasing ``table`` [n] not above ``value`` []."""
    return _count_prefix(table, lambda entry: entry <= value)


def last_not_above(table: jax.Array, value: jax.Array, start_index: jax.Array) -> jax.Array:
    """Return the index of the last entry that is at most ``value``, searched from a start index.

    A search from the last result costs two reads where the value has moved on by no entry or by
    one; from an index behind the value it begins at the first entry.

    Args:
        table: [n] non-decreasing.
        value: [] value to search; no derivative is taken of it.
        start_index: int32 [] index in [0, n) to begin at.

    Returns:
        int32 [], independent of the start; 0 where no entry is.
    """
    last = table.shape[0] - 1
    begin = jnp.where(take_row(table, start_index) <= value, start_index, 0)

    def is_next(k: jax.Array) -> jax.Array:
        return (k < last) & (take_row(table, jnp.minimum(k + 1, last)) <= value)

    return jax.lax.while_loop(is_next, lambda k: k + 1, begin)


def _count_prefix(table: jax.Array, holds: Predicate) -> jax.Array:
    """Return the length of the prefix of ``table`` [n] for which ``holds``, bit by bit."""
    n = table.shape[0]
    digits = n.bit_length()

    def extend_prefix(digit: jax.Array, count: jax.Array) -> jax.Array:
        longer = count + (jnp.int32(1) << (digits - 1 - digit))
        inside = longer <= n
        entry = take_row(table, jnp.minimum(longer, n) - 1)
        return jnp.where(inside & holds(entry), longer, count)

    length: jax.Array = jax.lax.fori_loop(0, digits, extend_prefix, jnp.zeros((), jnp.int32))
    return length
