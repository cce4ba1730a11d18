"""Computations in every n-th control step."""

from collections.abc import Callable

import jax


def every_n_steps[T](
    period: int, number: jax.Array, do: Callable[[], T], otherwise: Callable[[], T], every: int = 1
) -> T:
    """Return ``do()`` in every n-th control step, and ``otherwise()`` in the others.

    Args:
        period: n.
        number: int32 [] number of control steps taken.
        do: computed in steps whose number is a multiple of n.
        otherwise: computed in the others.
        every: known divisor of number at compile time: where n divides it, the device needs no
            branch.
    """
    if every % period == 0:
        return do()
    done: T = jax.lax.cond(number % period == 0, do, otherwise)
    return done
