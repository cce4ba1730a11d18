"""Where training takes its examples from: worlds drawn for it, or folders of runs."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np

from angler_experiments.learned_planner import examples as made_of
from angler_experiments.learned_planner.examples import Examples
from angler_mjx.simulator.simulator import Simulator

EXPERT = "priority"
TRAINING_SEED = 1_000_003
"""Of worlds to learn from: no other seed has any of them."""


@dataclass(frozen=True, kw_only=True)
class Source:
    """Worlds of one kind."""

    worlds: int
    preset: str = "reef"
    robots: int = 8
    still: bool = True
    tile: int = 256


def of_sources(sources: Sequence[Source], worlds: int | None = None) -> Iterator[Examples]:
    """Examples drawn and planned on the device, a tile at a time.

    Args:
        sources: of them.
        worlds: in all, in the shares of the sources; theirs if left out.
    """
    total = sum(source.worlds for source in sources)
    for source in sources:
        count = source.worlds if worlds is None else max(1, worlds * source.worlds // total)
        scenario = made_of.scenario(
            preset=source.preset,
            robots=source.robots,
            still=source.still,
            worlds=min(source.tile, count),
            planner={"name": EXPERT},
            seed=TRAINING_SEED,
        )
        yield from made_of.drawn(Simulator(scenario), count)


def of_folders(folders: Iterable[Path]) -> Iterator[Examples]:
    """Examples of run folders, one after the other."""
    for folder in folders:
        yield from made_of.of_run(folder)


def gathered(
    parts: Iterable[Examples], worlds: int | None, tell: Callable[[str], None]
) -> Examples:
    """All examples on the device, in an order that mixes their sources.

    Args:
        parts: of them.
        worlds: the most that are taken; all if left out.
        tell: progress.
    """
    kept: list[Examples] = []
    for part in parts:
        kept.append(part)
        count = sum(one.count for one in kept)
        if len(kept) % 8 == 0:
            tell(f"{count} worlds")
        if worlds is not None and count >= worlds:
            break
    whole = made_of.joined(kept)
    order = np.random.default_rng(0).permutation(whole.count)[:worlds]
    mixed: Examples = jax.tree.map(lambda leaf: leaf[order], whole)
    return mixed
