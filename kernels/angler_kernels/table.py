"""Rows of a table and places in a sorted one, for one table and one value.

Nothing here reads a whole table: a search touches as many entries as the binary digits of its
length, so tables may stay in memory while everything else is in registers.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp

type Predicate = Callable[[jax.Array], jax.Array]


def take(table: jax.Array, i: jax.Array) -> jax.Array:
    """Row ``i`` [] of ``table`` [n, ...]; i must lie within [0, n)."""
    row: jax.Array = jax.lax.dynamic_index_in_dim(table, i, keepdims=False)
    return row


def count_below(table: jax.Array, value: jax.Array) -> jax.Array:
    """How many entries (int32 []) of a non-decreasing ``table`` [n] are less than ``value`` []."""
    return _count(table, lambda entry: entry < value)


def count_not_above(table: jax.Array, value: jax.Array) -> jax.Array:
    """How many entries (int32 []) of a non-decreasing ``table`` [n] are at most ``value`` []."""
    return _count(table, lambda entry: entry <= value)


def _count(table: jax.Array, holds: Predicate) -> jax.Array:
    """Length of the stretch at the beginning of ``table`` [n] for which ``holds``, bit by bit."""
    n = table.shape[0]
    digits = n.bit_length()

    def one(digit: jax.Array, count: jax.Array) -> jax.Array:
        longer = count + (jnp.int32(1) << (digits - 1 - digit))
        inside = longer <= n
        entry = take(table, jnp.minimum(longer, n) - 1)
        return jnp.where(inside & holds(entry), longer, count)

    found: jax.Array = jax.lax.fori_loop(0, digits, one, jnp.zeros((), jnp.int32))
    return found
