"""Parts of examples put together."""

import time
from collections.abc import Callable, Iterable

import jax
import numpy as np

from angler_experiments.learned_planner.training import examples as made_of
from angler_experiments.learned_planner.training.examples import Examples


def gathered(
    parts: Iterable[Examples],
    worlds: int | None,
    tell: Callable[[str], None],
    seconds: float | None = None,
) -> Examples:
    """All examples on the device, in an order that mixes their sources.

    Args:
        parts: of them.
        worlds: the most that are taken; all if left out.
        tell: progress.
        seconds: after which no more parts are asked for.
    """
    kept: list[Examples] = []
    begun = time.perf_counter()
    for part in parts:
        kept.append(part)
        count = sum(one.count for one in kept)
        took = time.perf_counter() - begun
        if len(kept) % 4 == 0:
            tell(f"{count} worlds")
        if (worlds is not None and count >= worlds) or (seconds is not None and took > seconds):
            break
    whole = made_of.joined(kept)
    order = np.random.default_rng(0).permutation(whole.count)[:worlds]
    mixed: Examples = jax.tree.map(lambda leaf: leaf[order], whole)
    return mixed
