"""Selection of the worlds of a run to repeat: sampled by a seed, with rare outcomes included.

Stratified: the outcome held by the fewest worlds has the first turn, then the next, and so on
around until there are enough. In each turn one of the worlds left with that outcome of some robot
is sampled. So with as many worlds as outcomes each outcome occurs, and common ones fill up.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pyarrow as pa

from angler_mjx.errors import ConfigError

type Stratify = Literal["outcome", "none"]


@dataclass(frozen=True, kw_only=True)
class WorldPick:
    """One picked world."""

    world: int
    """Global index."""
    why: str
    """The outcome that it represents; ``any`` without stratification."""


def pick_worlds(
    episodes: pa.Table, count: int, *, seed: int = 0, stratify: Stratify = "outcome"
) -> tuple[WorldPick, ...]:
    """Sample worlds of a run.

    Args:
        episodes: rows of `angler_mjx.runs.storage.episode_columns.EPISODE_SCHEMA`.
        count: number of worlds.
        seed: of the sampling.
        stratify: whether rare outcomes are sampled on purpose.

    Returns:
        Different worlds, in the order of their indices.

    Raises:
        ConfigError: the run has fewer worlds, or the number is below 1.
    """
    worlds = np.unique(episodes["world"].to_numpy())
    if count < 1:
        raise ConfigError(f"--episodes {count}: give 1 or more")
    if count > worlds.size:
        raise ConfigError(
            f"--episodes {count}: the run has {worlds.size} worlds; ask for fewer, or run more"
        )
    rng = np.random.default_rng(seed)
    remaining = rng.permutation(worlds).tolist()
    if stratify == "none":
        return _sort_picks([WorldPick(world=world, why="any") for world in remaining[:count]])
    worlds_by_outcome = _worlds_by_outcome(episodes)
    turns = sorted(
        worlds_by_outcome, key=lambda outcome: (len(worlds_by_outcome[outcome]), outcome)
    )
    picks: list[WorldPick] = []
    while len(picks) < count:
        for outcome in turns:
            world = next((w for w in remaining if w in worlds_by_outcome[outcome]), None)
            if world is not None and len(picks) < count:
                remaining.remove(world)
                picks.append(WorldPick(world=world, why=outcome))
    return _sort_picks(picks)


def _worlds_by_outcome(episodes: pa.Table) -> dict[str, set[int]]:
    """Return the worlds with each outcome of some robot."""
    worlds_by_outcome: dict[str, set[int]] = {}
    rows = zip(episodes["world"].to_pylist(), episodes["outcome"].to_pylist(), strict=True)
    for world, outcome in rows:
        worlds_by_outcome.setdefault(outcome, set()).add(world)
    return worlds_by_outcome


def _sort_picks(picks: list[WorldPick]) -> tuple[WorldPick, ...]:
    return tuple(sorted(picks, key=lambda pick: pick.world))
