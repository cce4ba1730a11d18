"""Backward trace from the goal: one route through the reached sets of the search."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.planning.path_search.lattice import EDGES, FreeSpace, LatticeLayout, Terrain
from angler_mjx.planning.path_search.search import QUARTER
from angler_mjx.planning.path_search.traffic import Balls


def _backward_tables() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return of the 26 steps the offset to the cell before, the layers, and the covered block.

    The cover is five rows (share of the step still ahead, layer before arrival, 1 the last), some
    of them equal; see `search`.
    """
    cover = {
        1: [(1.0, 2), (0.5, 2), (0.5, 1), (0.0, 1), (0.0, 1)],
        2: [(1.0, 3), (0.5, 3), (0.5, 2), (0.5, 1), (0.0, 1)],
        3: [(1.0, 4), (0.5, 3), (0.5, 2), (0.0, 1), (0.0, 1)],
    }
    steps, layers, fractions, layers_before, grow = [], [], [], [], []
    for edge in EDGES:
        step = np.subtract(edge.far, edge.near)
        for sign in (1, -1):
            steps.append(sign * step)
            layers.append(edge.layers)
            fractions.append([row[0] for row in cover[edge.axes]])
            layers_before.append([row[1] for row in cover[edge.axes]])
            grow.append(QUARTER[edge.axes])
    return (
        np.array(steps),
        np.array(layers),
        np.array(fractions),
        np.array(layers_before),
        np.array(grow),
    )


_STEPS, _LAYERS, _REMAINING_FRACTION, _LAYERS_BEFORE, _INFLATION = _backward_tables()


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Route:
    """A path over cells in time; K rows from the start to the goal, the first one repeated."""

    position_m: jax.Array
    """[K, 3]."""
    arrive_s: jax.Array
    """[K]."""
    leave_s: jax.Array
    """[K] >= arrive_s: until then the robot can stay there."""
    begin: jax.Array
    """[] row from which on the rows are not repeated."""
    whole: jax.Array
    """bool []: every step of it was found among the reached sets."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _WalkState:
    cell: jax.Array
    layer: jax.Array
    last: jax.Array
    row: jax.Array
    cells: jax.Array
    arrive: jax.Array
    leave: jax.Array
    whole: jax.Array


def trace_back(
    land: Terrain,
    free: FreeSpace,
    balls: Balls,
    history: jax.Array,
    layer_s: jax.Array,
    goal: tuple[jax.Array, jax.Array],
    start: tuple[jax.Array, jax.Array],
) -> Route:
    """Trace a path from the goal to the start through the reached sets.

    Where the robot could have been in the same cell one layer before, it waited there: so every
    cell of the path is entered as early as possible. Among the steps that could have led there the
    one that begins nearest to the straight line from the start is taken.

    Args:
        land: the world.
        free: the robot's free space.
        balls: the other robots, L layers.
        history: uint32 [L, inner] reached sets.
        layer_s: [] time of a layer.
        goal: cell [3] and layer [] of the arrival.
        start: cell [3] and layer [] of the beginning.

    Returns:
        The route; it begins at the start's cell only if the goal was reached.
    """
    size = history.shape[0] // 2 + 2
    walk = _WalkState(
        cell=goal[0],
        layer=goal[1],
        last=goal[1],
        row=jnp.array(size - 1),
        cells=jnp.broadcast_to(start[0], (size, 3)),
        arrive=jnp.zeros((size,), goal[1].dtype),
        leave=jnp.zeros((size,), goal[1].dtype),
        whole=jnp.array(True),
    )

    def back(walk: _WalkState) -> _WalkState:
        return _step_back(land, free, balls, history, start, walk)

    walk = jax.lax.while_loop(lambda walk: walk.layer > start[1], back, walk)
    first = jnp.arange(size) == walk.row
    leave = jnp.where(first, walk.last, walk.leave)
    arrive = jnp.where(first, walk.layer, walk.arrive)
    grid = land.grid
    return Route(
        position_m=grid.origin_m + (walk.cells + 0.5) * grid.cell_m,
        arrive_s=arrive * layer_s,
        leave_s=leave * layer_s,
        begin=walk.row,
        whole=walk.whole & jnp.all(walk.cell == start[0]),
    )


def _step_back(
    land: Terrain,
    free: FreeSpace,
    balls: Balls,
    history: jax.Array,
    start: tuple[jax.Array, jax.Array],
    walk: _WalkState,
) -> _WalkState:
    """Trace one wait of a layer or one step backwards."""
    recent: Balls = jax.tree.map(
        lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, jnp.maximum(walk.layer - 4, 0), 4), balls
    )
    before = jnp.concatenate([walk.cell[None], walk.cell - _STEPS])
    layers = jnp.concatenate([jnp.ones((1,), jnp.int32), jnp.array(_LAYERS, jnp.int32)])
    possible = _was_reached(land.layout, history, before, walk.layer - layers)
    possible &= walk.layer - layers >= start[1]
    possible &= jnp.concatenate([jnp.ones((1,), bool), _edges_to(land.layout, free, walk.cell)])
    possible &= _is_clear_of_balls(land, recent, walk)
    off = _off_line(walk.cell - _STEPS, start[0], walk.cell)
    # Waiting comes first, what is impossible last.
    cost = jnp.where(possible, jnp.concatenate([jnp.full((1,), -1.0, off.dtype), off]), jnp.inf)
    best = jnp.argmin(cost)
    has_moved = best > 0
    layer = walk.layer - layers[best]
    is_row = (jnp.arange(walk.arrive.shape[0]) == walk.row) & has_moved
    return _WalkState(
        cell=before[best],
        layer=layer,
        last=jnp.where(has_moved, layer, walk.last),
        row=walk.row - has_moved,
        cells=jnp.where(is_row[:, None], walk.cell, walk.cells),
        arrive=jnp.where(is_row, walk.layer, walk.arrive),
        leave=jnp.where(is_row, walk.last, walk.leave),
        whole=walk.whole & (cost[best] < jnp.inf),
    )


def _was_reached(
    layout: LatticeLayout, history: jax.Array, cells: jax.Array, layers: jax.Array
) -> jax.Array:
    """Return whether each of ``cells`` [n, 3] is in the reached set of its layer [n], bool [n]."""
    inside = jnp.all((cells >= 0) & (cells < jnp.array(layout.shape)), axis=-1) & (layers >= 0)
    at = layers * layout.inner + cells[:, 0] * layout.row + cells[:, 1]
    packed = history.reshape(-1)[jnp.where(inside, at, 0)]
    return inside & (((packed >> jnp.maximum(cells[:, 2], 0).astype(jnp.uint32)) & 1) == 1)


def _edges_to(layout: LatticeLayout, free: FreeSpace, cell: jax.Array) -> jax.Array:
    """Return whether edges of the 26 steps to ``cell`` [3] are free, bool [26]; never guards."""
    low = cell + np.minimum(0, -_STEPS)
    word = layout.guard_size + low[:, 0] * layout.row + low[:, 1]
    edge = np.repeat(np.arange(len(EDGES)), 2)
    bit = jnp.maximum(low[:, 2], 0).astype(jnp.uint32)
    return ((free.edges[edge, word] >> bit) & 1) == 1


def _is_clear_of_balls(land: Terrain, recent: Balls, walk: _WalkState) -> jax.Array:
    """Return whether waiting and each of the 26 steps to the cell are clear of balls, bool [27]."""
    cell = land.grid.cell_m
    centre_m = land.grid.origin_m + (walk.cell + 0.5) * cell
    first = jnp.maximum(walk.layer - 4, 0)
    index = jnp.maximum(walk.layer - _LAYERS_BEFORE - first, 0)
    points_m = centre_m - _REMAINING_FRACTION[..., None] * _STEPS[:, None, :] * cell
    centre, radius = recent.centre_m[index], recent.radius_m[index]
    square_distance = jnp.sum((points_m[:, :, None, :] - centre) ** 2, axis=-1)
    inflated = radius + (_INFLATION * cell)[:, None, None]
    is_hit = (radius >= 0.0) & (square_distance < inflated * inflated)
    now = walk.layer - 1 - first
    rest = jnp.sum((centre_m - recent.centre_m[now]) ** 2, axis=-1)
    stays = (recent.radius_m[now] < 0.0) | (rest >= recent.radius_m[now] ** 2)
    return jnp.concatenate([jnp.all(stays)[None], ~jnp.any(is_hit, axis=(1, 2))])


def _off_line(points: jax.Array, a: jax.Array, b: jax.Array) -> jax.Array:
    """Return squared distances [n] of ``points`` [n, 3] from the line a to b, in cells."""
    d = (b - a).astype(jnp.float32)
    r = (points - a).astype(jnp.float32)
    along = jnp.sum(r * d, axis=-1)
    return jnp.sum(r * r, axis=-1) - along * along / jnp.maximum(jnp.sum(d * d), 1.0)
