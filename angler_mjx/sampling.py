"""Random numbers of several keys in one operation.

XLA compiles every sampling call to kernels of its own. With keys folded and numbers sampled
together there are fewer, and the program of a world compiles faster. Each key gives the same
numbers as alone.
"""

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike


def fold_keys(key: jax.Array, count: int) -> jax.Array:
    """Return keys [count] of a key: key i is ``jax.random.fold_in(key, i)``."""
    keys: jax.Array = jax.vmap(jax.random.fold_in, (None, 0))(
        key, jnp.arange(count, dtype=jnp.uint32)
    )
    return keys


def uniform_rows(keys: jax.Array, count: int, dtype: DTypeLike = float) -> jax.Array:
    """Sample uniform rows [n_key, count]; row i is ``jax.random.uniform(keys[i], (count,))``.

    The first numbers of a row do not depend on its length.
    """
    rows: jax.Array = jax.vmap(lambda key: jax.random.uniform(key, (count,), dtype))(keys)
    return rows


def scale_uniform(fraction: jax.Array, low: float, high: float) -> jax.Array:
    """Scale fractions from 0 to 1 to ``low`` to ``high``, as `jax.random.uniform` does."""
    return jnp.maximum(low, fraction * (high - low) + low)
