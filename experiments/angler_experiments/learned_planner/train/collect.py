"""Collection of parts of examples."""

import time
from collections.abc import Callable, Iterable

import jax
import numpy as np

from angler_experiments.learned_planner.train import examples as made_of
from angler_experiments.learned_planner.train.examples import Examples


def collect_examples(
    parts: Iterable[Examples],
    worlds: int | None,
    report: Callable[[str], None],
    seconds: float | None = None,
) -> Examples:
    """Return all examples on the device, in an order that mixes their sources.

    Args:
        parts: parts of examples.
        worlds: maximum number of worlds; all if left out.
        report: receives progress.
        seconds: time after which no more parts are requested.
    """
    collected: list[Examples] = []
    start_s = time.perf_counter()
    for part in parts:
        collected.append(part)
        count = sum(examples.count for examples in collected)
        elapsed_s = time.perf_counter() - start_s
        if len(collected) % 4 == 0:
            report(f"{count} worlds")
        if (worlds is not None and count >= worlds) or (
            seconds is not None and elapsed_s > seconds
        ):
            break
    joined = made_of.join_examples(collected)
    order = np.random.default_rng(0).permutation(joined.count)[:worlds]
    mixed: Examples = jax.tree.map(lambda leaf: leaf[order], joined)
    return mixed
