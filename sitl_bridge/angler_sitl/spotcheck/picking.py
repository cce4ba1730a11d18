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
class Pick:
    """One world that was picked."""

    world: int
    """Global index."""
    why: str
    """The outcome that it stands for; ``any`` where nothing was asked for."""


def pick(
    episodes: pa.Table, count: int, *, seed: int = 0, stratify: Stratify = "outcome"
) -> tuple[Pick, ...]:
    """Draw worlds of a run.

    Args:
        episodes: rows of `angler_mjx.runs.storage.columns.EPISODE_SCHEMA`.
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
    draw = np.random.default_rng(seed)
    left = draw.permutation(worlds).tolist()
    if stratify == "none":
        return _ordered([Pick(world=world, why="any") for world in left[:count]])
    held = _worlds_by_outcome(episodes)
    turns = sorted(held, key=lambda outcome: (len(held[outcome]), outcome))
    picks: list[Pick] = []
    while len(picks) < count:
        for outcome in turns:
            world = next((w for w in left if w in held[outcome]), None)
            if world is not None and len(picks) < count:
                left.remove(world)
                picks.append(Pick(world=world, why=outcome))
    return _ordered(picks)


def _worlds_by_outcome(episodes: pa.Table) -> dict[str, set[int]]:
    """Worlds in which some robot ended in each way."""
    held: dict[str, set[int]] = {}
    rows = zip(episodes["world"].to_pylist(), episodes["outcome"].to_pylist(), strict=True)
    for world, outcome in rows:
        held.setdefault(outcome, set()).add(world)
    return held


def _ordered(picks: list[Pick]) -> tuple[Pick, ...]:
    return tuple(sorted(picks, key=lambda one: one.world))
