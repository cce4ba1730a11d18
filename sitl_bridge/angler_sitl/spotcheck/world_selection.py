"""Which worlds of a run are flown again: drawn by a seed, and rare outcomes are there.

Stratified: the outcome that the fewest worlds hold has the first turn, then the next, and so on
around until there are enough. Whose turn it is draws one of the worlds left in which some robot
ended that way. So with as many worlds as outcomes each of them occurs, and common ones fill up.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pyarrow as pa

from angler_mjx.errors import ConfigError

type Stratify = Literal["outcome", "none"]


@dataclass(frozen=True, kw_only=True)
class WorldPick:
    """One world that was picked."""

    world: int
    """Global index."""
    why: str
    """The outcome that it stands for; ``any`` where nothing was asked for."""


def pick_worlds(
    episodes: pa.Table, count: int, *, seed: int = 0, stratify: Stratify = "outcome"
) -> tuple[WorldPick, ...]:
    """Draw worlds of a run.

    Args:
        episodes: rows of `angler_mjx.runs.storage.episode_columns.EPISODE_SCHEMA`.
        count: how many worlds.
        seed: of the draw.
        stratify: whether rare outcomes are drawn on purpose.

    Returns:
        Different worlds, in the order of their indices.

    Raises:
        ConfigError: there are fewer, or the number is below 1.
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
    """Worlds in which some robot ended in each way."""
    worlds_by_outcome: dict[str, set[int]] = {}
    rows = zip(episodes["world"].to_pylist(), episodes["outcome"].to_pylist(), strict=True)
    for world, outcome in rows:
        worlds_by_outcome.setdefault(outcome, set()).add(world)
    return worlds_by_outcome


def _sort_picks(picks: list[WorldPick]) -> tuple[WorldPick, ...]:
    return tuple(sorted(picks, key=lambda pick: pick.world))
