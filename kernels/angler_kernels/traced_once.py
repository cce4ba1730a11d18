"""Functions of JAX that are traced once for all of their calls."""

from collections.abc import Callable

import jax


def trace_once[**P, R](function: Callable[P, R]) -> Callable[P, R]:
    """Wrap a function of arrays so that Python runs once for arguments of the same shapes.

    Programs that call it are the same as without: its operations are inlined. Within ``vmap`` they
    are batched once as well.
    """
    return jax.jit(function, inline=True)
