"""Examples of worlds that are sampled and planned on the device."""

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from angler_experiments.learned_planner.train import examples as made_of
from angler_experiments.learned_planner.train.examples import Examples
from angler_mjx.runs.simulator.simulator import Simulator

EXPERT = "priority"
TRAINING_SEED = 1_000_003
"""Seed of training worlds: no other seed has any of them."""


@dataclass(frozen=True, kw_only=True)
class Source:
    """Worlds of one kind."""

    worlds: int
    preset: str = "reef"
    robots: int = 8
    still: bool = True
    tile: int = 256


def sample_sources(sources: Sequence[Source], worlds: int | None = None) -> Iterator[Examples]:
    """Yield examples sampled and planned on the device, a tile at a time.

    Args:
        sources: sources of the examples.
        worlds: number of all worlds, in the fractions of the sources; theirs if left out.
    """
    total = sum(source.worlds for source in sources)
    fraction = 1.0 if worlds is None else worlds / total
    remaining = [
        _sample_source(source, max(1, math.ceil(fraction * source.worlds))) for source in sources
    ]
    # In turn, so that an early end leaves some of all sources; and their programs compile in
    # parallel.
    with ThreadPoolExecutor(len(remaining)) as threads:
        while remaining:
            tiles = list(threads.map(_next_or_none, remaining))
            remaining = [
                part for part, tile in zip(remaining, tiles, strict=True) if tile is not None
            ]
            yield from (tile for tile in tiles if tile is not None)


def _sample_source(source: Source, count: int) -> Iterator[Examples]:
    scenario = made_of.build_scenario(
        preset=source.preset,
        robots=source.robots,
        still=source.still,
        worlds=min(source.tile, count),
        planner={"name": EXPERT},
        seed=TRAINING_SEED,
    )
    yield from made_of.sample_examples(Simulator(scenario), count)


def _next_or_none(part: Iterator[Examples]) -> Examples | None:
    return next(part, None)
