"""From a way over cells to a smooth one: shortcuts that cost least, then a descent in its shape."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.planning.current.pace import PowerModel, pace
from angler_mjx.planning.path_search.lattice import Terrain, line_of_sight

type Flow = Callable[[jax.Array, jax.Array], jax.Array]
"""Velocity [3] m/s of the water at a point [3] and a time [] s."""

_WINDOW = 24
"""Rows that one shortcut can leave out."""
_LOOKS = 8
"""Times that the water is looked at along a shortcut."""
_ROUNDS = 40
"""Of descent."""
_HELD = 3
"""Times in a step that ends of legs which would not be free stay where they are."""
_FORGET = 5
"""Steps after which points that had to stay are tried again."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Leg:
    """Legs [n] between points [n + 1, 3]."""

    cost: jax.Array
    """[n] metres of still water."""
    span_s: jax.Array
    """[n] time."""


def legs(robot: PowerModel, points: jax.Array, flow: Flow, begin_s: jax.Array, stays: bool) -> Leg:
    """What legs of a way cost, and how long each takes.

    Args:
        robot: one.
        points: [n + 1, 3] m, W.
        flow: of the water.
        begin_s: [] when the first leg begins.
        stays: whether the water's motion does; static. Otherwise leg after leg is looked at when
            it begins.
    """
    gap = points[1:] - points[:-1]
    length = jnp.sqrt(jnp.sum(gap * gap, axis=-1) + 1e-12)
    direction = gap / length[:, None]
    looks = [points[:-1] + share * gap for share in (0.25, 0.75)]

    def one(d: jax.Array, metres: jax.Array, places: list[jax.Array], t: jax.Array) -> Leg:
        seen = [pace(robot, d, flow(place, t)) for place in places]
        cost = sum(cost for cost, _ in seen) / len(seen)
        slow = sum(1.0 / speed for _, speed in seen) / len(seen)
        return Leg(cost=metres * cost, span_s=metres * slow)

    found: Leg
    if stays:
        found = jax.vmap(one, in_axes=(0, 0, 0, None))(direction, length, looks, begin_s)
        return found

    def after(
        t: jax.Array, row: tuple[jax.Array, jax.Array, list[jax.Array]]
    ) -> tuple[jax.Array, Leg]:
        # The time at the middle of the leg, by its speed at the beginning.
        first = one(*row, t)
        leg = one(*row, t + 0.5 * first.span_s)
        return t + leg.span_s, leg

    _, found = jax.lax.scan(after, begin_s, (direction, length, looks))
    return found


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _Descent:
    """Of one way."""

    way: jax.Array
    value: jax.Array
    slope: jax.Array
    fixed: jax.Array
    """bool [n - 2] points that stay, because legs from them would not be free."""
    rate: jax.Array


def shortened(
    land: Terrain,
    robot: PowerModel,
    points: jax.Array,
    clearance_m: jax.Array,
    flow: Flow,
    most: int,
) -> tuple[jax.Array, jax.Array]:
    """The cheapest way along straight lines between points of a way, all in sight of each other.

    Args:
        land: the world.
        robot: one.
        points: [n, 3] of a way whose legs are free; its end may be repeated.
        clearance_m: [] to keep from what stands.
        flow: of the water; as it is at time 0.
        most: points of the result, static.

    Returns:
        Points [most, 3], the last repeated; and whether they were enough, bool [].
    """
    n = points.shape[0]
    # Repetitions first, where the way back from the end can stop at the first of them.
    spare = jnp.sum(jnp.all(points == points[-1], axis=-1)) - 1
    points = points[jnp.maximum(jnp.arange(n) - spare, 0)]
    zero = jnp.zeros((), points.dtype)
    share = (np.arange(_LOOKS) + 0.5) / _LOOKS

    def cost(a: jax.Array, b: jax.Array, next_to: jax.Array) -> jax.Array:
        gap = b - a
        length = jnp.sqrt(jnp.sum(gap * gap) + 1e-12)
        water = jax.vmap(lambda s: flow(a + s * gap, zero))(jnp.asarray(share, a.dtype))
        each = pace(robot, jnp.broadcast_to(gap / length, water.shape), water)[0]
        total = jnp.where(length < 1e-4, 0.0, length * jnp.mean(each))
        seen = next_to | line_of_sight(land, a, b, clearance_m)
        return jnp.where(seen, total, jnp.inf)

    def reach(j: jax.Array, state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        least, before = state
        rows = j - 1 - jnp.arange(_WINDOW)
        there = jnp.maximum(rows, 0)
        ways = jax.vmap(cost, in_axes=(0, None, 0))(points[there], points[j], rows == j - 1)
        total = jnp.where(rows >= 0, least[there] + ways, jnp.inf)
        best = jnp.argmin(total)
        return least.at[j].set(total[best]), before.at[j].set(there[best])

    # From the first point that is none of the repetitions; of a batch, as far as its longest way.
    least = jnp.where(jnp.arange(n) <= spare, 0.0, jnp.inf).astype(points.dtype)
    begin = (least, jnp.zeros(n, jnp.int32))
    least, before = jax.lax.fori_loop(spare + 1, n, reach, begin)

    def back(at: jax.Array, _: None) -> tuple[jax.Array, jax.Array]:
        return before[at], at

    _, rows = jax.lax.scan(back, jnp.array(n - 1), None, length=most)
    # Backwards from the end, the start repeated; turned round, repetitions lead.
    return points[rows[::-1]], (rows[-1] == 0) & jnp.isfinite(least[-1])


def evened(points: jax.Array, count: int) -> jax.Array:
    """Points [count, 3] along lines between points [n, 3]: all of those, and others between them.

    Longer legs are given more. ``count`` is at least n; points that repeat another are left out.
    """
    gap = jnp.sqrt(jnp.sum((points[1:] - points[:-1]) ** 2, axis=-1))
    real = gap > 1e-6
    along = jnp.cumsum(gap) / jnp.maximum(jnp.sum(gap), 1e-6)
    spare = count - 1 - jnp.sum(real)
    until = jnp.cumsum(real) + jnp.floor(spare * along + 1e-4).astype(jnp.int32)
    row = jnp.arange(count)
    leg = jnp.minimum(jnp.searchsorted(until, row, side="right"), gap.shape[0] - 1)
    begin = jnp.where(leg > 0, until[jnp.maximum(leg - 1, 0)], 0)
    share = jnp.clip((row - begin) / jnp.maximum(until[leg] - begin, 1), 0.0, 1.0)
    return points[leg] + share[:, None] * (points[leg + 1] - points[leg])


def descended(
    land: Terrain,
    robot: PowerModel,
    points: jax.Array,
    clearance_m: jax.Array,
    floor_z_m: jax.Array,
    flow: Flow,
    stays: bool,
) -> jax.Array:
    """A way of the same ends that costs less, as free as the first.

    Each step goes down the gradient of the cost, smoothed over the way by the inverse of its
    second difference: a bend of any length goes at the same rate, as in Newton's method for the
    length. Near what stands costs more, and legs that would not be free do not go there.

    Args:
        land: the world.
        robot: one.
        points: [n, 3], free along lines.
        clearance_m: [] to keep.
        floor_z_m: [] height of the floor.
        flow: of the water.
        stays: whether its motion does.
    """
    n = points.shape[0]
    zero = jnp.zeros((), points.dtype)
    whole = jnp.sqrt(jnp.sum((points[1:] - points[:-1]) ** 2, axis=-1)).sum()
    step = whole / (n - 1)

    def cost(middle: jax.Array) -> jax.Array:
        way = jnp.concatenate([points[:1], middle, points[-1:]])
        gap = way[1:] - way[:-1]
        length = jnp.sum(gap * gap, axis=-1)
        # Points that slide along the way cost nothing; this keeps them apart.
        even = 0.05 * jnp.sum((length - jnp.mean(length)) ** 2) / (step**3 + 1e-9)
        near = jax.vmap(lambda p: _near(land, p, clearance_m))(middle)
        total: jax.Array = jnp.sum(legs(robot, way, flow, zero, stays).cost) + even
        return total + step * jnp.sum(near)

    look = jax.value_and_grad(cost)

    def hit(way: jax.Array) -> jax.Array:
        seen = jax.vmap(line_of_sight, in_axes=(None, 0, 0, None))(
            land, way[:-1], way[1:], clearance_m
        )
        inside = jax.vmap(lambda p: _inside(land, p, clearance_m, floor_z_m))(way)
        inside = inside.at[0].set(True).at[-1].set(True)
        return ~(seen & inside[:-1] & inside[1:])

    def better(state: _Descent, number: jax.Array) -> tuple[_Descent, None]:
        fixed = kept | (state.fixed & (number % _FORGET > 0))
        move = state.rate * step * _smoothed(jnp.nan_to_num(state.slope), fixed)
        far = jnp.sqrt(jnp.max(jnp.sum(move * move, axis=-1)) + 1e-12)
        move = move * jnp.minimum(1.0, 0.5 * cell / far)
        new = state.way.at[1:-1].add(-move)

        def hold(_: int, tried: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            there, stuck = tried
            ends = _ends(hit(there) & ~tight)
            return jnp.where(ends[:, None], state.way, there), stuck | ends

        new, stuck = jax.lax.fori_loop(0, _HELD, hold, (new, jnp.zeros(n, bool)))
        value, slope = look(new[1:-1])
        good = (value < state.value) & ~jnp.any(hit(new) & ~tight)
        after = _Descent(
            way=new,
            value=value,
            slope=slope,
            fixed=fixed | stuck[1:-1],
            rate=jnp.minimum(1.3 * state.rate, 1.0),
        )
        stay = replace(state, fixed=fixed | stuck[1:-1], rate=0.5 * state.rate)
        return jax.tree.map(lambda a, b: jnp.where(good, a, b), after, stay), None

    cell = land.grid.cell_m
    # Steps between cells may pass a corner more closely than lines of sight; they stay.
    tight = hit(points)
    kept = _ends(tight)[1:-1]
    value, slope = look(points[1:-1])
    begin = _Descent(
        way=points,
        value=value,
        slope=slope,
        fixed=jnp.zeros(n - 2, bool),
        rate=jnp.full((), 0.5, points.dtype),
    )
    last, _ = jax.lax.scan(better, begin, jnp.arange(_ROUNDS))
    return last.way


def _ends(which: jax.Array) -> jax.Array:
    """Points [n + 1] at the ends of legs [n]."""
    return jnp.concatenate([which, which[-1:]]) | jnp.concatenate([which[:1], which])


def _smoothed(slope: jax.Array, fixed: jax.Array) -> jax.Array:
    """Inverse second difference of rows [n, 3] over those that are not ``fixed`` [n]; 0 there.

    Between two rows that stay, a and b, the inverse is Green's function of a string held there:
    (i - a) (b - j) / (b - a) for i <= j.
    """
    row = jnp.arange(1, fixed.shape[0] + 1)
    last = jax.lax.cummax(jnp.where(fixed, row, 0))
    after = jax.lax.cummin(jnp.where(fixed, row, fixed.shape[0] + 1), reverse=True)
    low, high = jnp.minimum(row[:, None], row), jnp.maximum(row[:, None], row)
    held = (low - last[:, None]) * (after[:, None] - high)
    same = (last[:, None] == last) & ~fixed[:, None] & ~fixed
    green = jnp.where(same, held / jnp.maximum(after - last, 1)[:, None], 0.0)
    return jnp.sum(green[:, :, None].astype(slope.dtype) * slope, axis=1)


def _inside(land: Terrain, p: jax.Array, clearance_m: jax.Array, floor_z_m: jax.Array) -> jax.Array:
    """Whether a point [3] keeps clear of the cube's faces and the floor, as cells' centres do."""
    lo, n = land.grid.origin_m, jnp.array(land.layout.shape)
    hi = lo + n * land.grid.cell_m
    walls = jnp.all((p >= lo + clearance_m) & (p <= hi - clearance_m))
    return walls & (p[2] - floor_z_m >= clearance_m)


def _near(land: Terrain, p: jax.Array, clearance_m: jax.Array) -> jax.Array:
    """Cost of a metre near what stands, in metres.

    Distances of cells' centres, read between them: beside a flat wall half the distance and a
    quarter of a cell.
    """
    gap = land.gap_m if land.cell_gap_m is None else jnp.minimum(land.gap_m, land.cell_gap_m)
    cell = land.grid.cell_m
    at = (p - land.grid.origin_m) / cell - 0.5
    top = jnp.array(gap.shape) - 1
    at = jnp.clip(at, 0.0, top)
    low = jnp.minimum(at.astype(jnp.int32), top - 1)
    share = at - low
    total = jnp.zeros((), p.dtype)
    for corner in np.ndindex(2, 2, 2):
        weight = jnp.ones((), p.dtype)
        for axis, up in enumerate(corner):
            weight = weight * (share[axis] if up else 1.0 - share[axis])
        i, j, k = (low[axis] + up for axis, up in enumerate(corner))
        total += weight * gap[i, j, k]
    missing = jnp.maximum(0.5 * clearance_m + 0.4 * cell - total, 0.0) / cell
    return 100.0 * missing * missing
