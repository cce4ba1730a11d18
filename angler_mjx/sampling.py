"""Random numbers of several keys in one operation.

XLA compiles every sampling call to kernels of its own. With keys folded and numbers sampled
together there are fewer, and the program of a world compiles faster. Each key gives the same
numbers as alone.
"""

from dataclasses import dataclass
from typing import Self

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike

from angler_mjx.host_arrays import as_numbers


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


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class UniformRange:
    """Range of a uniformly sampled number; argument of programs."""

    low: jax.Array
    """[]."""
    width: jax.Array
    """[] difference of the ends, rounded once."""

    @classmethod
    def between(cls, low: float, high: float) -> Self:
        """Return the range from ``low`` to ``high`` (host side)."""
        return cls(low=as_numbers(low), width=as_numbers(high - low))

    def scale(self, fraction: jax.Array) -> jax.Array:
        """Scale fractions from 0 to 1 to the range, as `jax.random.uniform` does."""
        return jnp.maximum(self.low, fraction * self.width + self.low)
