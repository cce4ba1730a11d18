"""The search for the nearest of the shapes that robots can meet, on lanes.

Distances that cannot matter are left out: a shape whose bounding sphere is farther than the least
distance so far is not looked at.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import lanes
from angler_mjx.sim.engines.lanes.steps import Lanes

type LaneIndex = jax.Array | np.ndarray | int | tuple[jax.Array | np.ndarray | slice | None, ...]
"""Index of lanes [n, W]."""


@dataclass(frozen=True, kw_only=True)
class CandidateBody[Body]:
    """A shape that robots can meet, in every lane; what costs something is loaded when asked for.

    ``details`` gives its constants (Obstacles or `judge.LaneHull`), its attitude q [4], and its
    velocity [3] in W.
    """

    p: Lanes
    reach: jax.Array
    """Radius of its bounding sphere; -inf where there is none."""
    details: Callable[[], tuple[Body, Lanes, Lanes]]


@dataclass(frozen=True, kw_only=True)
class OtherBodies[Index, Body]:
    """Shapes that robots can meet, one after another."""

    count: int
    load: Callable[[Index], CandidateBody[Body]]
    """Shape i of these, for every lane; a `SearchFunction` of another kind asks in another way."""
    first: int = 0
    """Number of shape 0 among all of its kind."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Seeker:
    """A robot that looks for the nearest shape, in every lane; leaves are object arrays."""

    p: Lanes
    a: Lanes
    """[c, 3] one end of each axis of its hull, in W."""
    b: Lanes
    """[c, 3] other end."""
    r: Lanes
    """[c] radii."""
    radius_m: Lanes
    """[] of its bounding sphere."""
    running: Lanes
    """bool [] whether it looks at all."""
    limit_m: Lanes
    """[] distances from here on do not matter, unless something touches."""

    def is_candidate(
        self, candidate: CandidateBody[object], is_other: jax.Array | bool
    ) -> jax.Array:
        """Whether a shape is near enough to matter."""
        running: jax.Array = self.running.item()
        radius_m: jax.Array = self.radius_m.item()
        square = sum((candidate.p[k] - self.p[k]) ** 2 for k in range(3))
        within = jnp.maximum(self.limit_m[()], 0.0) + radius_m + candidate.reach
        near: jax.Array = (within >= 0.0) & (square <= within * within)
        return running & is_other & near


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class NearestBody:
    """The nearest shape so far, in every lane."""

    gap: jax.Array
    index: jax.Array
    fixed: jax.Array
    v: tuple[jax.Array, ...]

    def replace_where(
        self,
        where: jax.Array,
        gap: jax.Array,
        index: jax.Array,
        fixed: jax.Array | np.bool_,
        v: Lanes,
    ) -> "NearestBody":
        """Return another body where a mask is true, else this one."""
        return NearestBody(
            gap=jnp.where(where, gap, self.gap),
            index=jnp.where(where, index, self.index),
            fixed=jnp.where(where, fixed, self.fixed),
            v=tuple(jnp.where(where, x, y) for x, y in zip(v, self.v, strict=True)),
        )


type _Slots = tuple[jax.Array, ...]
"""Groups that each lane has noted, with the wanted shapes of each."""

GROUP_SIZE = 8
"""Shapes that are asked for together where there are many: their loads wait together."""
MAX_NOTED_GROUPS = 4
"""Groups that a lane can note."""
LIST_THRESHOLD = GROUP_SIZE + 1
"""Shapes from which on they are listed. The list of a single group costs large batches more than
it saves."""

type GapFunction[Body] = Callable[
    [Seeker, CandidateBody[Body]], tuple[jax.Array, jax.Array | np.bool_, Lanes]
]
"""The gap to a shape, whether it never moves, and its velocity [3]."""


class SearchFunction[Index](Protocol):
    """The nearest of some shapes and of one found before, if nearer than the limit or touching."""

    def __call__[Body](
        self,
        seeker: Seeker,
        others: OtherBodies[Index, Body],
        measure_gap: GapFunction[Body],
        start: NearestBody,
        self_index: LaneIndex,
    ) -> NearestBody:
        """Search; ``self_index`` is the number of the lane's own shape.

        The first of equals counts.
        """


def search_in_turn[Body](
    seeker: Seeker,
    others: OtherBodies[jax.Array, Body],
    measure_gap: GapFunction[Body],
    start: NearestBody,
    self_index: LaneIndex,
) -> NearestBody:
    """See `SearchFunction`: one shape after another, skipped where no lane wants it."""
    if others.count == 0:
        return start

    def visit_body(i: jax.Array, best: NearestBody) -> NearestBody:
        candidate, number = others.load(i), others.first + i
        wanted = seeker.is_candidate(candidate, number != self_index)

        def look(best: NearestBody) -> NearestBody:
            gap, fixed, v = measure_gap(seeker, candidate)
            better = wanted & (gap < best.gap)
            return best.replace_where(better, gap, number, fixed, v)

        after: NearestBody = jax.lax.cond(lanes.any_lane(wanted), look, lambda best: best, best)
        return after

    nearest: NearestBody = jax.lax.fori_loop(0, others.count, visit_body, start)
    return nearest


def search_in_groups[Body](
    seeker: Seeker,
    others: OtherBodies[jax.Array, Body],
    measure_gap: GapFunction[Body],
    start: NearestBody,
    self_index: LaneIndex,
) -> NearestBody:
    """See `SearchFunction`: each lane lists the shapes that it wants and works through its list.

    Among many shapes every lane of a kernel wants a few, and each another: in turn, each of them
    would cost as much as one that all lanes want. Shapes are asked for in groups of `GROUP_SIZE`; a
    lane notes a group and which of it are wanted in one number, and has room for `MAX_NOTED_GROUPS`
    of them.
    """
    groups = -(-others.count // GROUP_SIZE)
    empty = jnp.zeros_like(start.index)

    def note_group(
        carry: tuple[jax.Array, jax.Array, _Slots],
    ) -> tuple[jax.Array, jax.Array, _Slots]:
        group, noted, slots = carry
        mask = empty
        for k in range(GROUP_SIZE):
            i = group * GROUP_SIZE + k
            candidate = others.load(jnp.minimum(i, others.count - 1))
            wanted = seeker.is_candidate(
                candidate, (others.first + i != self_index) & (i < others.count)
            )
            mask |= jnp.where(wanted, 1 << k, 0)
        note = jnp.where(mask != 0, (group << GROUP_SIZE) | mask, 0)
        slots = tuple(
            jnp.where((noted == n) & (note != 0), note, slot) for n, slot in enumerate(slots)
        )
        return group + 1, noted + jnp.where(note != 0, 1, 0), slots

    def pop(carry: tuple[_Slots, NearestBody]) -> tuple[_Slots, NearestBody]:
        (head, *rest), best = carry
        bit = head & -head
        k = jax.lax.population_count((bit - 1) & (2**GROUP_SIZE - 1))
        i = jnp.where(head != 0, (head >> GROUP_SIZE) * GROUP_SIZE + k, 0)
        gap, fixed, v = measure_gap(seeker, others.load(i))
        better = (head != 0) & (gap < best.gap)
        nearest = best.replace_where(better, gap, others.first + i, fixed, v)
        left = head ^ bit
        done = (left & (2**GROUP_SIZE - 1)) == 0
        moved = (*rest, empty)
        slots = tuple(jnp.where(done, x, y) for x, y in zip(moved, (left, *rest), strict=True))
        return slots, nearest

    def search_groups(
        carry: tuple[jax.Array, NearestBody],
    ) -> tuple[jax.Array, NearestBody]:
        group, best = carry
        group, _, slots = jax.lax.while_loop(
            lambda x: (x[0] < groups) & ~lanes.any_lane(x[1] == MAX_NOTED_GROUPS),
            note_group,
            (group, empty, (empty,) * MAX_NOTED_GROUPS),
        )
        _, best = jax.lax.while_loop(lambda x: lanes.any_lane(x[0][0] != 0), pop, (slots, best))
        return group, best

    _, nearest = jax.lax.while_loop(lambda x: x[0] < groups, search_groups, (jnp.int32(0), start))
    return nearest


def search_lanes[Body](
    seeker: Seeker,
    others: OtherBodies[jax.Array, Body],
    measure_gap: GapFunction[Body],
    start: NearestBody,
    self_index: LaneIndex,
) -> NearestBody:
    """See `SearchFunction`: what is quicker for so many shapes."""
    search = search_in_groups if others.count >= LIST_THRESHOLD else search_in_turn
    return search(seeker, others, measure_gap, start, self_index)
