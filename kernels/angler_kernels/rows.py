"""Writing a row of arrays: one kernel under ``vmap`` too, where all of a batch write the same row.

JAX batches an update at an index as a scatter, which XLA compiles to three to five kernels: for
indices, their test, and the update.
"""

from collections.abc import Sequence
from functools import lru_cache

import jax
import jax.numpy as jnp


def write_row[T](rows: T, new_row: T, index: int | jax.Array) -> T:
    """Return rows [n] with another row [index], leaf by leaf.

    Args:
        rows: [n] leading.
        new_row: the same without this axis.
        index: int [], from 0 to n - 1.
    """
    at = jnp.asarray(index, jnp.int32)
    written: T = jax.tree.map(lambda leaf, row: _writer(0)(leaf, row, at), rows, new_row)
    return written


@lru_cache
def _writer(axis: int) -> jax.custom_batching.custom_vmap:
    """Return the function that writes along an axis; a batch adds one before it."""

    def write(leaf: jax.Array, row: jax.Array, index: jax.Array) -> jax.Array:
        written: jax.Array = jax.lax.dynamic_update_index_in_dim(leaf, row, index, axis)
        return written

    def write_batch(
        size: int, batched: Sequence[bool], leaf: jax.Array, row: jax.Array, index: jax.Array
    ) -> tuple[jax.Array, bool]:
        leaf, row = (
            part if is_one else jnp.broadcast_to(part, (size, *jnp.shape(part)))
            for part, is_one in zip((leaf, row), batched[:2], strict=True)
        )
        if batched[2]:
            return jax.vmap(write)(leaf, row, index), True
        written: jax.Array = _writer(axis + 1)(leaf, row, index)
        return written, True

    writer = jax.custom_batching.custom_vmap(write)
    writer.def_vmap(write_batch)
    return writer
