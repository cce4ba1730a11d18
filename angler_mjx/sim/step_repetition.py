"""Several control steps with one command, for engines that have no faster way to make them."""

from collections.abc import Callable

import jax

from angler_mjx.sim.record import Sample
from angler_mjx.sim.state import WorldState


def repeat_steps(
    step: Callable[[WorldState], tuple[WorldState, Sample]], state: WorldState, times: int
) -> tuple[WorldState, Sample]:
    """The state after some control steps, and the sample of the last one.

    Args:
        step: one control step.
        state: before them.
        times: how many, at least 1.
    """
    if times == 1:
        return step(state)
    after, samples = jax.lax.scan(lambda now, _: step(now), state, length=times)
    last: Sample = jax.tree.map(lambda leaf: leaf[-1], samples)
    return after, last
