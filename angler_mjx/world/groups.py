"""Computations on many items in small groups: each item once, then the unfinished items again.

Under ``vmap`` a loop would repeat for all items the iterations that only a few need. Here one loop
body works on a group at a time, and is compiled once.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class WorldGroup:
    """Indices of a group of n items."""

    index: jax.Array
    """int32 [size]; n or more for an empty slot: not written."""
    read: jax.Array
    """int32 [size]; a valid index to read for empty slots."""


def choose_group(turn: jax.Array, left: jax.Array, size: int) -> WorldGroup:
    """Return the group of a turn: neighbours until all items had one, then unfinished items.

    Args:
        turn: [] index of the turn, from 0.
        left: bool [n] unfinished items.
        size: size of a group; static.
    """
    n = left.shape[0]
    items = jnp.arange(n, dtype=jnp.int32)
    slot = jnp.where(left, jnp.cumsum(left, dtype=jnp.int32) - 1, size)
    again = jnp.full(size, n, jnp.int32).at[slot].set(items, mode="drop")
    index = jnp.where(all_had_turn(turn, n, size), again, turn * size + jnp.arange(size))
    return WorldGroup(index=index, read=jnp.minimum(index, n - 1))


def all_had_turn(turn: jax.Array, n: int, size: int) -> jax.Array:
    """Return whether all of n items had a turn before this one, bool []."""
    return turn >= -(-n // size)
