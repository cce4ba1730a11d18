"""What is done in some control steps only."""

from collections.abc import Callable

import jax


def every_n_steps[T](
    period: int, number: jax.Array, do: Callable[[], T], otherwise: Callable[[], T], every: int = 1
) -> T:
    """One thing in every n-th control step, and another one in the rest.

    Args:
        period: n.
        number: int32 [] control steps taken.
        do: worked out in those whose number is a multiple of n.
        otherwise: in the others.
        every: what number is known to be a multiple of when the program is made: where n divides
            it, nothing has to be decided on the device.
    """
    if every % period == 0:
        return do()
    done: T = jax.lax.cond(number % period == 0, do, otherwise)
    return done
