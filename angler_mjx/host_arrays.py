"""NumPy arrays as leaves of pytrees whose fields are declared as JAX's."""

from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike


def as_leaf(array: np.ndarray | np.generic) -> jax.Array:
    """Return the same NumPy array, typed as a leaf of a pytree.

    JAX takes both kinds of arrays. On the host the array stays NumPy's, and nothing is compiled.
    """
    return cast(jax.Array, array)


def as_numbers(values: ArrayLike) -> jax.Array:
    """Return numbers as a leaf of a pytree, in JAX's default type of floating-point numbers.

    Programs that take the leaf as an argument do not depend on its values.
    """
    return as_leaf(np.asarray(values, jnp.result_type(float)))
