"""NumPy arrays as leaves of pytrees whose fields are declared as JAX's."""

from typing import cast

import jax
import numpy as np


def as_leaf(array: np.ndarray | np.generic) -> jax.Array:
    """Return the same NumPy array, typed as a leaf of a pytree.

    JAX takes both kinds of arrays. On the host the array stays NumPy's, and nothing is compiled.
    """
    return cast(jax.Array, array)
