"""From a path over cells to a smooth one: shortcuts of least cost, then a descent in its shape."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.planning.current.motion_cost import PowerModel, cost_and_speed
from angler_mjx.planning.path_search.lattice import Terrain, line_of_sight

type Flow = Callable[[jax.Array, jax.Array], jax.Array]
"""Velocity [3] m/s of the water at a point [3] and a time [] s."""

_WINDOW = 24
"""Rows that one shortcut can leave out."""
_N_SAMPLES = 8
"""Number of water samples along a shortcut."""
_N_ITERATIONS = 40
"""Of descent."""
_HOLD_ITERATIONS = 3
"""Times in a step that ends of legs which would not be free stay where they are."""
_RETRY_PERIOD = 5
"""Steps after which points that had to stay are tried again."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class LegCosts:
    """Legs [n] between points [n + 1, 3]."""

    cost: jax.Array
    """[n] metres of still water."""
    span_s: jax.Array
    """[n] time."""


def leg_costs(
    robot: PowerModel, points: jax.Array, flow: Flow, begin_s: jax.Array, stays: bool
) -> LegCosts:
    """Return the cost and the duration of the legs of a path.

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
    sample_points_m = [points[:-1] + fraction * gap for fraction in (0.25, 0.75)]

    def leg_cost(
        d: jax.Array, metres: jax.Array, points_m: list[jax.Array], t: jax.Array
    ) -> LegCosts:
        samples = [cost_and_speed(robot, d, flow(point_m, t)) for point_m in points_m]
        cost = sum(cost for cost, _ in samples) / len(samples)
        slowness = sum(1.0 / speed for _, speed in samples) / len(samples)
        return LegCosts(cost=metres * cost, span_s=metres * slowness)

    costs: LegCosts
    if stays:
        costs = jax.vmap(leg_cost, in_axes=(0, 0, 0, None))(
            direction, length, sample_points_m, begin_s
        )
        return costs

    def next_leg(
        t: jax.Array, row: tuple[jax.Array, jax.Array, list[jax.Array]]
    ) -> tuple[jax.Array, LegCosts]:
        # The time at the middle of the leg, by its speed at the beginning.
        first = leg_cost(*row, t)
        leg = leg_cost(*row, t + 0.5 * first.span_s)
        return t + leg.span_s, leg

    _, costs = jax.lax.scan(next_leg, begin_s, (direction, length, sample_points_m))
    return costs


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _DescentState:
    """State of the descent of one path."""

    path_m: jax.Array
    value: jax.Array
    slope: jax.Array
    fixed: jax.Array
    """bool [n - 2] points that stay, because legs from them would not be free."""
    rate: jax.Array


def shorten_path(
    land: Terrain,
    robot: PowerModel,
    points: jax.Array,
    clearance_m: jax.Array,
    flow: Flow,
    max_points: int,
) -> tuple[jax.Array, jax.Array]:
    """Return the cheapest path along lines of sight between points of a path.

    Args:
        land: the world.
        robot: one.
        points: [n, 3] of a path with free legs; its end may be repeated.
        clearance_m: [] to keep from still bodies.
        flow: of the water; as it is at time 0.
        max_points: points of the result, static.

    Returns:
        Points [max_points, 3], the last repeated; and whether they were enough, bool [].
    """
    n = points.shape[0]
    # Repetitions first, where the way back from the end can stop at the first of them.
    n_repeated = jnp.sum(jnp.all(points == points[-1], axis=-1)) - 1
    points = points[jnp.maximum(jnp.arange(n) - n_repeated, 0)]
    zero = jnp.zeros((), points.dtype)
    fractions = (np.arange(_N_SAMPLES) + 0.5) / _N_SAMPLES

    def cost(a: jax.Array, b: jax.Array, next_to: jax.Array) -> jax.Array:
        gap = b - a
        length = jnp.sqrt(jnp.sum(gap * gap) + 1e-12)
        water = jax.vmap(lambda s: flow(a + s * gap, zero))(jnp.asarray(fractions, a.dtype))
        cost_per_m = cost_and_speed(robot, jnp.broadcast_to(gap / length, water.shape), water)[0]
        total = jnp.where(length < 1e-4, 0.0, length * jnp.mean(cost_per_m))
        is_visible = next_to | line_of_sight(land, a, b, clearance_m)
        return jnp.where(is_visible, total, jnp.inf)

    def relax(j: jax.Array, state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        best_costs, before = state
        rows = j - 1 - jnp.arange(_WINDOW)
        predecessors = jnp.maximum(rows, 0)
        leg_costs = jax.vmap(cost, in_axes=(0, None, 0))(
            points[predecessors], points[j], rows == j - 1
        )
        total = jnp.where(rows >= 0, best_costs[predecessors] + leg_costs, jnp.inf)
        best = jnp.argmin(total)
        return best_costs.at[j].set(total[best]), before.at[j].set(predecessors[best])

    # From the first point that is none of the repetitions; of a batch, as far as its longest way.
    best_costs = jnp.where(jnp.arange(n) <= n_repeated, 0.0, jnp.inf).astype(points.dtype)
    initial = (best_costs, jnp.zeros(n, jnp.int32))
    best_costs, before = jax.lax.fori_loop(n_repeated + 1, n, relax, initial)

    def step_back(at: jax.Array, _: None) -> tuple[jax.Array, jax.Array]:
        return before[at], at

    _, rows = jax.lax.scan(step_back, jnp.array(n - 1), None, length=max_points)
    # Backwards from the end, the start repeated; turned round, repetitions lead.
    return points[rows[::-1]], (rows[-1] == 0) & jnp.isfinite(best_costs[-1])


def resample_path(points: jax.Array, count: int) -> jax.Array:
    """Return points [count, 3] along lines between points [n, 3], which are among them.

    Longer legs are given more. ``count`` is at least n; points that repeat another are left out.
    """
    gap = jnp.sqrt(jnp.sum((points[1:] - points[:-1]) ** 2, axis=-1))
    is_leg = gap > 1e-6
    path_fraction = jnp.cumsum(gap) / jnp.maximum(jnp.sum(gap), 1e-6)
    n_spare = count - 1 - jnp.sum(is_leg)
    last_rows = jnp.cumsum(is_leg) + jnp.floor(n_spare * path_fraction + 1e-4).astype(jnp.int32)
    row = jnp.arange(count)
    leg = jnp.minimum(jnp.searchsorted(last_rows, row, side="right"), gap.shape[0] - 1)
    begin = jnp.where(leg > 0, last_rows[jnp.maximum(leg - 1, 0)], 0)
    fraction = jnp.clip((row - begin) / jnp.maximum(last_rows[leg] - begin, 1), 0.0, 1.0)
    return points[leg] + fraction[:, None] * (points[leg + 1] - points[leg])


def descend_path(
    land: Terrain,
    robot: PowerModel,
    points: jax.Array,
    clearance_m: jax.Array,
    floor_z_m: jax.Array,
    flow: Flow,
    stays: bool,
) -> jax.Array:
    """Return a path with the same ends, as clear as the first, that costs less.

    Each step goes down the gradient of the cost, smoothed over the path by the inverse of its
    second difference: a bend of any length goes at the same rate, as in Newton's method for the
    length. Positions near still bodies cost more, and legs that would not be free do not go there.

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
    length_m = jnp.sqrt(jnp.sum((points[1:] - points[:-1]) ** 2, axis=-1)).sum()
    step = length_m / (n - 1)

    def cost(middle: jax.Array) -> jax.Array:
        path = jnp.concatenate([points[:1], middle, points[-1:]])
        gap = path[1:] - path[:-1]
        length = jnp.sum(gap * gap, axis=-1)
        # Points that slide along the way cost nothing; this keeps them apart.
        spacing_cost = 0.05 * jnp.sum((length - jnp.mean(length)) ** 2) / (step**3 + 1e-9)
        nearness = jax.vmap(lambda p: _nearness_cost(land, p, clearance_m))(middle)
        total: jax.Array = jnp.sum(leg_costs(robot, path, flow, zero, stays).cost) + spacing_cost
        return total + step * jnp.sum(nearness)

    value_and_slope = jax.value_and_grad(cost)

    def is_blocked(path: jax.Array) -> jax.Array:
        is_visible = jax.vmap(line_of_sight, in_axes=(None, 0, 0, None))(
            land, path[:-1], path[1:], clearance_m
        )
        inside = jax.vmap(lambda p: _is_inside(land, p, clearance_m, floor_z_m))(path)
        inside = inside.at[0].set(True).at[-1].set(True)
        return ~(is_visible & inside[:-1] & inside[1:])

    def improve(state: _DescentState, number: jax.Array) -> tuple[_DescentState, None]:
        fixed = is_kept | (state.fixed & (number % _RETRY_PERIOD > 0))
        move = state.rate * step * _smooth_slope(jnp.nan_to_num(state.slope), fixed)
        largest_move = jnp.sqrt(jnp.max(jnp.sum(move * move, axis=-1)) + 1e-12)
        move = move * jnp.minimum(1.0, 0.5 * cell / largest_move)
        new = state.path_m.at[1:-1].add(-move)

        def hold_blocked(_: int, tried: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            moved, is_stuck = tried
            ends = _leg_ends(is_blocked(moved) & ~is_tight)
            return jnp.where(ends[:, None], state.path_m, moved), is_stuck | ends

        new, is_stuck = jax.lax.fori_loop(
            0, _HOLD_ITERATIONS, hold_blocked, (new, jnp.zeros(n, bool))
        )
        value, slope = value_and_slope(new[1:-1])
        is_better = (value < state.value) & ~jnp.any(is_blocked(new) & ~is_tight)
        accepted = _DescentState(
            path_m=new,
            value=value,
            slope=slope,
            fixed=fixed | is_stuck[1:-1],
            rate=jnp.minimum(1.3 * state.rate, 1.0),
        )
        rejected = replace(state, fixed=fixed | is_stuck[1:-1], rate=0.5 * state.rate)
        return jax.tree.map(lambda a, b: jnp.where(is_better, a, b), accepted, rejected), None

    cell = land.grid.cell_m
    # Steps between cells may pass a corner more closely than lines of sight; they stay.
    is_tight = is_blocked(points)
    is_kept = _leg_ends(is_tight)[1:-1]
    value, slope = value_and_slope(points[1:-1])
    begin = _DescentState(
        path_m=points,
        value=value,
        slope=slope,
        fixed=jnp.zeros(n - 2, bool),
        rate=jnp.full((), 0.5, points.dtype),
    )
    last, _ = jax.lax.scan(improve, begin, jnp.arange(_N_ITERATIONS))
    return last.path_m


def _leg_ends(is_leg: jax.Array) -> jax.Array:
    """Return the points [n + 1] at the ends of legs [n]."""
    return jnp.concatenate([is_leg, is_leg[-1:]]) | jnp.concatenate([is_leg[:1], is_leg])


def _smooth_slope(slope: jax.Array, fixed: jax.Array) -> jax.Array:
    """Return the inverse second difference of rows [n, 3]; 0 at rows that are ``fixed`` [n].

    Between two rows that stay, a and b, the inverse is Green's function of a string held there:
    (i - a) (b - j) / (b - a) for i <= j.
    """
    row = jnp.arange(1, fixed.shape[0] + 1)
    last = jax.lax.cummax(jnp.where(fixed, row, 0))
    after = jax.lax.cummin(jnp.where(fixed, row, fixed.shape[0] + 1), reverse=True)
    low, high = jnp.minimum(row[:, None], row), jnp.maximum(row[:, None], row)
    numerator = (low - last[:, None]) * (after[:, None] - high)
    is_same_span = (last[:, None] == last) & ~fixed[:, None] & ~fixed
    greens_function = jnp.where(
        is_same_span, numerator / jnp.maximum(after - last, 1)[:, None], 0.0
    )
    return jnp.sum(greens_function[:, :, None].astype(slope.dtype) * slope, axis=1)


def _is_inside(
    land: Terrain, p: jax.Array, clearance_m: jax.Array, floor_z_m: jax.Array
) -> jax.Array:
    """Return whether a point [3] keeps clear of faces and floor, as centres of cells do."""
    lo, n = land.grid.origin_m, jnp.array(land.layout.shape)
    hi = lo + n * land.grid.cell_m
    walls = jnp.all((p >= lo + clearance_m) & (p <= hi - clearance_m))
    return walls & (p[2] - floor_z_m >= clearance_m)


def _nearness_cost(land: Terrain, p: jax.Array, clearance_m: jax.Array) -> jax.Array:
    """Return the cost of a metre near still bodies, in metres.

    Distances of cells' centres, read between them: beside a flat wall half the distance and a
    quarter of a cell.
    """
    gap = land.gap_m if land.cell_gap_m is None else jnp.minimum(land.gap_m, land.cell_gap_m)
    cell = land.grid.cell_m
    at = (p - land.grid.origin_m) / cell - 0.5
    top = jnp.array(gap.shape) - 1
    at = jnp.clip(at, 0.0, top)
    low = jnp.minimum(at.astype(jnp.int32), top - 1)
    offset = at - low
    total = jnp.zeros((), p.dtype)
    for corner in np.ndindex(2, 2, 2):
        weight = jnp.ones((), p.dtype)
        for axis, up in enumerate(corner):
            weight = weight * (offset[axis] if up else 1.0 - offset[axis])
        i, j, k = (low[axis] + up for axis, up in enumerate(corner))
        total += weight * gap[i, j, k]
    shortfall = jnp.maximum(0.5 * clearance_m + 0.4 * cell - total, 0.0) / cell
    return 100.0 * shortfall * shortfall
