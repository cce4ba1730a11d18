"""Choice of a dataset's episodes so that its fractions match the requested ones.

All flown episodes are kept. Of train, val and test each, surplus episodes are thinned until every
fraction holds: whole kinds of episodes in proportion, and of a kind those of the highest ticket, a
number that is derived from the part's seed and the world's index alone.
"""

from collections.abc import Mapping, Sequence
from typing import Literal, Self, get_args

import numpy as np
import pyarrow as pa
from pydantic import Field, model_validator

from angler_mjx.files import FileModel

type Kind = Literal["trivial", "crossing", "blocked", "both", "failed"]
"""Values of the index's ``difficulty``; ``failed``: not all of the team arrived."""

DIFFICULTIES: tuple[Kind, ...] = ("trivial", "crossing", "blocked", "both")
"""Difficulties; each episode has one of them."""
CROSSED: tuple[Kind, ...] = ("crossing", "both")
"""Difficulties with crossing straight lines of robots."""
FAILED: Kind = "failed"


class SampleConfig(FileModel):
    """Lower and upper bounds of the fraction of each kind among the chosen episodes.

    They hold in each of train, val and test, not in shifted scenes.
    """

    at_least: dict[Kind, float] = Field(default_factory=dict)
    """Min fraction of each kind, 0 to 1; failed: not all of the team arrived. Those of the others
    sum to at most 1."""
    at_most: dict[Kind, float] = Field(default_factory=dict)
    """Max fraction of each kind, 0 to 1, at least that of `at_least`. Those of all but failed sum
    to at least 1, with 1 for a kind that is left out."""

    @model_validator(mode="after")
    def _check_feasible(self) -> Self:
        for key, fractions in (("at_least", self.at_least), ("at_most", self.at_most)):
            for kind, fraction in fractions.items():
                if not 0.0 <= fraction <= 1.0:
                    raise ValueError(f"{key}.{kind} = {fraction:g}: must be from 0 to 1")
        for kind in self.at_least.keys() & self.at_most.keys():
            if self.at_least[kind] > self.at_most[kind]:
                raise ValueError(
                    f"at_least.{kind} = {self.at_least[kind]:g} is more than at_most.{kind} = "
                    f"{self.at_most[kind]:g}; no dataset satisfies both"
                )
        min_total = sum(self.at_least.get(kind, 0.0) for kind in DIFFICULTIES)
        max_total = sum(self.at_most.get(kind, 1.0) for kind in DIFFICULTIES)
        if min_total > 1.0 + 1e-9:
            raise ValueError(
                f"at_least: {' + '.join(DIFFICULTIES)} = {min_total:g}: must be 1 or less, for an "
                "episode is one of them"
            )
        if max_total < 1.0 - 1e-9:
            raise ValueError(
                f"at_most: {' + '.join(DIFFICULTIES)} = {max_total:g}: must be 1 or more, for "
                "every "
                "episode is one of them"
            )
        return self

    @property
    def has_bounds(self) -> bool:
        """Return whether any fraction is bounded."""
        return bool(self.at_least or self.at_most)

    def format_bounds(self, kind: Kind) -> str:
        """Return the bounds of a kind in words."""
        bounds = (("at least", self.at_least), ("at most", self.at_most))
        texts = [
            f"{label} {100 * fractions[kind]:g} %"
            for label, fractions in bounds
            if kind in fractions
        ]
        return ", ".join(texts) or "any"

    def upper_bounds(self) -> list[tuple[np.ndarray, float]]:
        """Return every bound as cells of `CELL_MASKS` and their largest fraction."""
        bounds = [(CELL_MASKS[kind], fraction) for kind, fraction in self.at_most.items()]
        return bounds + [
            (~CELL_MASKS[kind], 1.0 - fraction) for kind, fraction in self.at_least.items()
        ]


CELL_MASKS: Mapping[Kind, np.ndarray] = {
    **{
        kind: np.repeat([one == kind for one in DIFFICULTIES], 2)
        for kind in get_args(Kind.__value__)
    },
    "failed": np.tile([False, True], len(DIFFICULTIES)),
}
"""Bool [8] by name: kinds of episodes, by difficulty and failure."""


def is_kind(table: pa.Table, kind: Kind) -> np.ndarray:
    """Return whether episodes of an index are of a kind; bool [episode]."""
    matches: np.ndarray
    if kind == FAILED:
        matches = ~table["success"].to_numpy(zero_copy_only=False)
    else:
        matches = np.asarray(table["difficulty"]) == kind
    return matches


def select_episodes(table: pa.Table, config: SampleConfig, thin: Sequence[str]) -> np.ndarray:
    """Choose episodes of an index; bool [episode].

    All episodes of other splits are chosen: shifted scenes are tested unchanged.

    Args:
        table: index with all its columns but the result.
        config: bounds of the fractions.
        thin: splits in which the bounds hold, each by itself.
    """
    keep = np.ones(len(table), bool)
    if not config.has_bounds:
        return keep
    level = sum(i * is_kind(table, kind) for i, kind in enumerate(DIFFICULTIES))
    cell = 2 * level + is_kind(table, FAILED)
    ticket = hash_worlds(table["seed"].to_numpy(), table["world"].to_numpy())
    splits = np.asarray(table["split"])
    for split in thin:
        rows = np.flatnonzero(splits == split)
        if not rows.size:
            continue
        counts = np.bincount(cell[rows], minlength=2 * len(DIFFICULTIES))
        n_kept = thin_counts(counts, config.upper_bounds())
        ordered = rows[np.lexsort((ticket[rows], cell[rows]))]
        rank = np.arange(rows.size) - np.repeat(np.cumsum(counts) - counts, counts)
        keep[ordered] = rank < np.repeat(n_kept, counts)
    return keep


def thin_counts(counts: np.ndarray, caps: list[tuple[np.ndarray, float]]) -> np.ndarray:
    """Return the number of episodes of each cell that remain, so that no cap is exceeded.

    Args:
        counts: int [c] episodes of each cell.
        caps: cells, bool [c], and their largest fraction of the remaining episodes.
    """
    kept = counts.astype(np.int64)
    while True:
        before = kept.sum()
        for cells, fraction in caps:
            inside = int(kept[cells].sum())
            limit = _max_inside(int(kept.sum()) - inside, fraction)
            if inside > limit:
                kept[cells] = scale_counts(kept[cells], limit)
        if kept.sum() == before:
            return kept


def _max_inside(outside: int, fraction: float) -> int:
    """Return the largest number that is at most a fraction of itself and the others."""
    if fraction >= 1.0:
        return int(np.iinfo(np.int64).max)
    return int(np.floor(outside * fraction / (1.0 - fraction) + 1e-9))


def scale_counts(counts: np.ndarray, total: int) -> np.ndarray:
    """Scale counts to a sum, as close to their proportions as whole numbers can be.

    Args:
        counts: int [c].
        total: requested sum; at most the sum of the counts.
    """
    exact = counts * (total / max(int(counts.sum()), 1))
    down = np.floor(exact).astype(np.int64)
    first = np.lexsort((np.arange(len(counts)), down - exact))
    down[first[: total - int(down.sum())]] += 1
    return down


def hash_worlds(seed: np.ndarray, world: np.ndarray) -> np.ndarray:
    """Return a pseudo-random number of each world of a seed, uint64 [episode].

    The mixer of SplitMix64 (G. Steele, D. Lea, C. Flood, Fast splittable pseudorandom number
    generators, 2014).
    """
    with np.errstate(over="ignore"):
        x = seed.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15) + world.astype(np.uint64)
        for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
            x = (x ^ (x >> np.uint64(shift))) * np.uint64(factor)
        mixed: np.ndarray = x ^ (x >> np.uint64(31))
    return mixed
