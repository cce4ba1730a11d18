"""Loops that end together: the only dependence of a world on the others of its batch.

Under vmap a loop whose end differs between worlds makes every world's whole state wait, row by row,
behind a select. A loop that ends for the batch as a whole does not. Only the number of rounds
without effect may depend on the batch, never a result.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp


@jax.custom_batching.custom_vmap
def min_of_batch(x: jax.Array) -> jax.Array:
    """Return the least ``x`` [] of all worlds under vmap; ``x`` itself without."""
    return x


@min_of_batch.def_vmap
def _min_of_batch_vmap(_: int, in_batched: Sequence[bool], x: jax.Array) -> tuple[jax.Array, bool]:
    return min_of_batch(jnp.min(x, axis=0) if in_batched[0] else x), False
