"""Nearest neighbours of many bodies by a uniform grid, exact up to a stated distance.

Bodies are sorted by the cell that their centre is in. Cells are so large that what is near enough
to count lies in the 3 x 3 x 3 cells around; along x three cells are one stretch of the sorted
list, so each body looks through nine stretches. Candidates are taken in the order of the gap of
their bounding spheres, and the costly distance of a pair is worked out only while that gap is less
than the least distance found. Nothing has a capacity: crowded cells take longer.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

CELLS_PER_AXIS = 1024
"""The cell number of three axes fits 31 bits. Bodies further out share the last cell of an axis:
neighbours stay neighbours."""

SLACK = 1.0001
"""Cells are this much larger than they have to be, so that rounding cannot part neighbours."""


AT_ONCE = 4
"""Candidates looked at in one round of a loop, since a round has a price of its own. On the CPU 1,
4 and 8 cost the same."""

QUEUE = 4
"""Candidates kept from one look at all of them."""


class _Stretches(NamedTuple):
    """Where the candidates of one body are in the sorted list; [n] leads for all bodies."""

    shift: jax.Array
    """int32 [9] place in the sorted list less number of the candidate."""
    end: jax.Array
    """int32 [9] number of candidates in this stretch and those before it."""

    def place(self, i: jax.Array) -> jax.Array:
        """Place [] in the sorted list of candidate i [] of one body."""
        shift = self.shift[0]
        for k in range(8):
            shift = jnp.where(i >= self.end[k], self.shift[k + 1], shift)
        return i + shift


def nearest(
    centre: jax.Array,
    radius: jax.Array,
    bodies: Any,
    distance: Callable[[Any, Any], jax.Array],
    within: jax.Array | float,
) -> tuple[jax.Array, jax.Array]:
    """Distance [n] of each body to the nearest other and the index of that one, int32 [n].

    Exact up to ``within``; ``within`` and -1 where nothing is nearer. Derivatives are those of
    ``distance`` for the pair found.

    Args:
        centre: [n, 3] m; a body's bounding sphere stands here.
        radius: [n] of the bounding spheres, m.
        bodies: pytree of what ``distance`` needs to know, [n] leads.
        distance: of two bodies, [] m; never less than the gap of their spheres. It is called with
            the body of the lower index first, so both of a pair get the same number.
        within: [] m, >= 0.
    """
    n = centre.shape[0]
    if n == 1:
        return jnp.full(1, within, centre.dtype), jnp.full(1, -1, jnp.int32)
    held = jax.lax.stop_gradient((centre, radius, bodies, jnp.asarray(within, centre.dtype)))
    order, stretches = _sort(held[0], 2.0 * jnp.max(held[1]) + held[3])

    def gap(one: jax.Array, other: jax.Array, of: Any) -> jax.Array:
        first, second = jnp.minimum(one, other), jnp.maximum(one, other)
        return distance(*(jax.tree.map(lambda x, i=i: x[i], of) for i in (first, second)))

    def search(me: jax.Array, mine: _Stretches) -> jax.Array:
        def sphere_gap(place: jax.Array) -> _Pair:
            j = order[place]
            apart = jnp.sqrt(jnp.sum((held[0][j] - held[0][me]) ** 2)) - held[1][j] - held[1][me]
            return _Pair(jnp.where(j == me, jnp.inf, apart), j)

        return _search(me, mine, sphere_gap, lambda j: gap(me, j, held[2]), held[3])

    me = jnp.arange(n, dtype=jnp.int32)
    index = jax.vmap(search)(me, stretches)
    # A body without a neighbour is paired with any other, never with itself: that has no gradient.
    other = jnp.where(index >= 0, index, (me + 1) % n)
    found = jax.vmap(lambda one, other: gap(one, other, bodies))(me, other)
    return jnp.where(index >= 0, found, within), index


def _sort(centre: jax.Array, reach: jax.Array) -> tuple[jax.Array, _Stretches]:
    """Bodies int32 [n] in the order of their cells, and the candidates of each body."""
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
    """A gap [] to another body and the index [] of that body; -1 for none, just a limit."""

    gap: jax.Array
    body: jax.Array

    def before(self, other: "_Pair") -> jax.Array:
        """Whether this one is nearer; of equals the lower index, and a limit before any body."""
        return (self.gap < other.gap) | ((self.gap == other.gap) & (self.body < other.body))

    def instead_of(self, other: "_Pair", where: jax.Array) -> "_Pair":
        """This one where told so."""
        return _Pair(*(jnp.where(where, new, old) for new, old in zip(self, other, strict=True)))


type _Queue = tuple[_Pair, ...]


def _search(
    me: jax.Array,
    stretches: _Stretches,
    sphere_gap: Callable[[jax.Array], _Pair],
    distance: Callable[[jax.Array], jax.Array],
    within: jax.Array,
) -> jax.Array:
    """Index int32 [] of the body nearest to body ``me``; -1 if none is nearer than ``within``.

    Args:
        me: int32 [].
        stretches: of this body.
        sphere_gap: of the body at a place of the sorted list, inf for ``me``.
        distance: to the body of an index.
        within: [] m.
    """
    nobody = jnp.full_like(me, -1)
    total = stretches.end[8]

    def next_ones(wanted: jax.Array, last: _Pair, limit: jax.Array) -> _Queue:
        """The candidates that follow the last one in the order of sphere gaps, below a limit."""

        def look(carry: tuple[jax.Array, _Queue]) -> tuple[jax.Array, _Queue]:
            i, queue = carry
            for _ in range(AT_ONCE):
                seen = sphere_gap(stretches.place(i))
                counts = (i < total) & last.before(seen)
                queue = _insert(queue, seen._replace(gap=jnp.where(counts, seen.gap, jnp.inf)))
                i = i + 1
            return i, queue

        # A body that wants none begins at the end: the loop is not entered if no body wants any.
        start = (jnp.where(wanted, 0, total), (_Pair(limit, nobody),) * QUEUE)
        return jax.lax.while_loop(lambda carry: carry[0] < total, look, start)[1]

    def take_first(carry: tuple[_Queue, jax.Array, _Pair]) -> tuple[_Queue, jax.Array, _Pair]:
        queue, may_follow, best = carry
        found = _Pair(distance(queue[0].body), queue[0].body)
        best = found.instead_of(best, found.before(best))
        left = (*queue[1:], _Pair(best.gap, nobody))
        used_up = may_follow & (left[0].body < 0) & (queue[0].gap < best.gap)
        more = next_ones(used_up, queue[0], best.gap)
        queue = tuple(new.instead_of(old, used_up) for new, old in zip(more, left, strict=True))
        return queue, jnp.where(used_up, more[-1].body >= 0, may_follow), best

    def going_on(carry: tuple[_Queue, jax.Array, _Pair]) -> jax.Array:
        first, best = carry[0][0], carry[2]
        return (first.body >= 0) & (first.gap < best.gap)

    first = _Pair(jnp.full_like(within, -jnp.inf), nobody)
    queue = next_ones(jnp.ones_like(me, bool), first, within)
    start = (queue, queue[-1].body >= 0, _Pair(within, nobody))
    return jax.lax.while_loop(going_on, take_first, start)[2].body


def _insert(queue: _Queue, new: _Pair) -> _Queue:
    """A sorted queue of the same length with one more candidate, less the last."""
    out = []
    for old in queue:
        goes_here = new.before(old)
        out.append(new.instead_of(old, goes_here))
        new = old.instead_of(new, goes_here)
    return tuple(out)
