"""Nearest neighbours of many bodies by a uniform grid, exact up to a stated distance.

Bodies are sorted by the cell of their centre. Cells are so large that all neighbours within the
distance lie in the 3 x 3 x 3 cells around; along x three cells are one stretch of the sorted list,
so each body searches nine stretches. Candidates are taken in the order of the gap of their bounding
spheres, and the costly distance of a pair is computed only while that gap is less than the least
distance found. Nothing has a capacity: crowded cells take longer.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

CELLS_PER_AXIS = 1024
"""Maximum number of cells along an axis: the cell number of three axes fits 31 bits. Bodies further
out share the last cell of an axis:
neighbours stay neighbours."""

SLACK = 1.0001
"""Relative growth of cells beyond their necessary size, so that rounding cannot part neighbours."""


CANDIDATES_PER_ROUND = 4
"""Candidates tested in one round of a loop, since a round has a cost of its own. On the CPU 1, 4
and 8 cost the same."""

QUEUE_LENGTH = 4
"""Candidates kept from one pass over all of them."""


class _Stretches(NamedTuple):
    """Candidates of one body in the sorted list; [n] leads for all bodies."""

    shift: jax.Array
    """int32 [9] index in the sorted list less number of the candidate."""
    end: jax.Array
    """int32 [9] number of candidates in this stretch and those before it."""

    def sorted_index(self, i: jax.Array) -> jax.Array:
        """Return the index [] in the sorted list of candidate i [] of one body."""
        shift = self.shift[0]
        for k in range(8):
            shift = jnp.where(i >= self.end[k], self.shift[k + 1], shift)
        return i + shift


def find_nearest[T](
    centre: jax.Array,
    radius: jax.Array,
    bodies: T,
    distance: Callable[[T, T], jax.Array],
    limit_m: jax.Array | float,
) -> tuple[jax.Array, jax.Array]:
    """Return distance [n] of each body to its nearest neighbour and that one's index, int32 [n].

    Exact up to ``limit_m``; ``limit_m`` and -1 where nothing is nearer. Derivatives are those of
    ``distance`` for the pair found.

    Args:
        centre: [n, 3] m; a body's bounding sphere stands here.
        radius: [n] of the bounding spheres, m.
        bodies: pytree of the inputs of ``distance``, [n] leads.
        distance: of two bodies, [] m; never less than the gap of their spheres. It is called with
            the body of the lower index first, so both of a pair get the same number.
        limit_m: [] m, >= 0.
    """
    n = centre.shape[0]
    if n == 1:
        return jnp.full(1, limit_m, centre.dtype), jnp.full(1, -1, jnp.int32)
    constants = jax.lax.stop_gradient((centre, radius, bodies, jnp.asarray(limit_m, centre.dtype)))
    order, stretches = _sort_bodies(constants[0], 2.0 * jnp.max(constants[1]) + constants[3])

    def gap(body: jax.Array, other: jax.Array, body_tree: T) -> jax.Array:
        first, second = jnp.minimum(body, other), jnp.maximum(body, other)
        return distance(*(jax.tree.map(lambda x, i=i: x[i], body_tree) for i in (first, second)))

    def search(self_index: jax.Array, body_stretches: _Stretches) -> jax.Array:
        def sphere_gap(sorted_index: jax.Array) -> _Pair:
            j = order[sorted_index]
            centre_gap = (
                jnp.sqrt(jnp.sum((constants[0][j] - constants[0][self_index]) ** 2))
                - constants[1][j]
                - constants[1][self_index]
            )
            return _Pair(jnp.where(j == self_index, jnp.inf, centre_gap), j)

        return _search_nearest(
            self_index,
            body_stretches,
            sphere_gap,
            lambda j: gap(self_index, j, constants[2]),
            constants[3],
        )

    self_index = jnp.arange(n, dtype=jnp.int32)
    index = jax.vmap(search)(self_index, stretches)
    # A body without a neighbour is paired with any other, never with itself: that has no gradient.
    other = jnp.where(index >= 0, index, (self_index + 1) % n)
    distances = jax.vmap(lambda body, other: gap(body, other, bodies))(self_index, other)
    return jnp.where(index >= 0, distances, limit_m), index


def _sort_bodies(centre: jax.Array, reach: jax.Array) -> tuple[jax.Array, _Stretches]:
    """Return bodies int32 [n] in the order of their cells, and the candidates of each body."""
    cell = jnp.floor((centre - jnp.min(centre, axis=0)) / (SLACK * reach))
    # One ring of cells without bodies lies around.
    cell = jnp.clip(cell.astype(jnp.int32), 0, CELLS_PER_AXIS - 1) + 1
    side = CELLS_PER_AXIS + 2
    x, row = cell[:, 0], cell[:, 1] * side + cell[:, 2]
    order = jnp.argsort(row * side + x).astype(jnp.int32)
    key = (row * side + x)[order]
    steps = jnp.array([dy * side + dz for dy in (-1, 0, 1) for dz in (-1, 0, 1)])
    first = (row[:, None] + steps) * side + x[:, None] - 1
    start, end = (jnp.searchsorted(key, at).astype(jnp.int32) for at in (first, first + 3))
    count = jnp.cumsum(end - start, axis=1)
    return order, _Stretches(shift=end - count, end=count)


class _Pair(NamedTuple):
    """Gap [] to another body and the index [] of that body; -1 for none, only a limit."""

    gap: jax.Array
    body: jax.Array

    def is_before(self, other: "_Pair") -> jax.Array:
        """Return whether this pair is nearer.

        Of equals the lower index, and a limit before any body.
        """
        return (self.gap < other.gap) | ((self.gap == other.gap) & (self.body < other.body))

    def replace_where(self, other: "_Pair", where: jax.Array) -> "_Pair":
        """Return this pair where the mask is true, else the other."""
        return _Pair(*(jnp.where(where, new, old) for new, old in zip(self, other, strict=True)))


type _Queue = tuple[_Pair, ...]


def _search_nearest(
    self_index: jax.Array,
    stretches: _Stretches,
    sphere_gap: Callable[[jax.Array], _Pair],
    distance: Callable[[jax.Array], jax.Array],
    limit_m: jax.Array,
) -> jax.Array:
    """Return the index int32 [] of the body nearest to ``self_index``; -1 beyond ``limit_m``.

    Args:
        self_index: int32 [].
        stretches: candidates of this body.
        sphere_gap: gap of the body at an index of the sorted list, inf for ``self_index``.
        distance: to the body of an index.
        limit_m: [] m.
    """
    no_body = jnp.full_like(self_index, -1)
    total = stretches.end[8]

    def next_candidates(is_needed: jax.Array, last: _Pair, limit: jax.Array) -> _Queue:
        """Return the candidates after the last one in the order of sphere gaps, below a limit."""

        def scan_candidates(carry: tuple[jax.Array, _Queue]) -> tuple[jax.Array, _Queue]:
            i, queue = carry
            for _ in range(CANDIDATES_PER_ROUND):
                pair = sphere_gap(stretches.sorted_index(i))
                is_candidate = (i < total) & last.is_before(pair)
                queue = _insert_sorted(
                    queue, pair._replace(gap=jnp.where(is_candidate, pair.gap, jnp.inf))
                )
                i = i + 1
            return i, queue

        # A body that needs none begins at the end: the loop is not entered if no body needs any.
        start = (jnp.where(is_needed, 0, total), (_Pair(limit, no_body),) * QUEUE_LENGTH)
        return jax.lax.while_loop(lambda carry: carry[0] < total, scan_candidates, start)[1]

    def take_first(carry: tuple[_Queue, jax.Array, _Pair]) -> tuple[_Queue, jax.Array, _Pair]:
        queue, may_follow, best = carry
        candidate = _Pair(distance(queue[0].body), queue[0].body)
        best = candidate.replace_where(best, candidate.is_before(best))
        remaining = (*queue[1:], _Pair(best.gap, no_body))
        is_used_up = may_follow & (remaining[0].body < 0) & (queue[0].gap < best.gap)
        refilled = next_candidates(is_used_up, queue[0], best.gap)
        queue = tuple(
            new.replace_where(old, is_used_up) for new, old in zip(refilled, remaining, strict=True)
        )
        return queue, jnp.where(is_used_up, refilled[-1].body >= 0, may_follow), best

    def has_candidates(carry: tuple[_Queue, jax.Array, _Pair]) -> jax.Array:
        first, best = carry[0][0], carry[2]
        return (first.body >= 0) & (first.gap < best.gap)

    first = _Pair(jnp.full_like(limit_m, -jnp.inf), no_body)
    queue = next_candidates(jnp.ones_like(self_index, bool), first, limit_m)
    start = (queue, queue[-1].body >= 0, _Pair(limit_m, no_body))
    return jax.lax.while_loop(has_candidates, take_first, start)[2].body


def _insert_sorted(queue: _Queue, new: _Pair) -> _Queue:
    """Insert a candidate into a sorted queue and drop its last."""
    out = []
    for old in queue:
        is_before = new.is_before(old)
        out.append(new.replace_where(old, is_before))
        new = old.replace_where(new, is_before)
    return tuple(out)
