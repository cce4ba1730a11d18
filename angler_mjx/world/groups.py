"""Work on many things in small groups: first each once, then again those that are not done.

Under ``vmap`` a loop would repeat for all what a few of them need. Here one loop body works on a
group at a time, and is written, and so compiled, once.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class WorldGroup:
    """Which of n things have their turn."""

    index: jax.Array
    """int32 [size]; n or more where a place is empty: to be written nowhere."""
    read: jax.Array
    """int32 [size]; where an empty place reads something that there is."""


def choose_group(turn: jax.Array, left: jax.Array, size: int) -> WorldGroup:
    """The group of a turn: neighbours until all had one, then the first that are left.

    Args:
        turn: [] counted from 0.
        left: bool [n] those that are not done.
        size: of a group; static.
    """
    n = left.shape[0]
    (again,) = jnp.nonzero(left, size=size, fill_value=n)
    index = jnp.where(all_had_turn(turn, n, size), again, turn * size + jnp.arange(size))
    return WorldGroup(index=index, read=jnp.minimum(index, n - 1))


def all_had_turn(turn: jax.Array, n: int, size: int) -> jax.Array:
    """Whether all of n things had a turn before this one, bool []."""
    return turn >= -(-n // size)
