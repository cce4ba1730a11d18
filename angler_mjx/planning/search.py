"""Space-time reachability of one robot over free cells, and the way back from its goal.

A layer is half the time of a step along an axis. Steps along 1, 2, 3 axes take 2, 3, 4 layers: the
lengths 2, 2.83, 3.46 rounded up. The set of cells that can be reached exactly at a layer is one word
per column; the next layer is some hundred bit operations per word.

Other robots are balls (see `traffic`). A step is covered by balls too: about its beginning, middle
and end, each with a quarter of its length; during each of its layers only those count between which
the robot then is. A ball is tested as the upright cylinder around it, which in a word is one span of
bits. So a step that is taken is clear in continuous time and space.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.planning.lattice import BLOCKS, EDGES, FreeSpace, Layout, Terrain, span_bits
from angler_mjx.planning.traffic import Balls

QUARTER = {axes: 0.25 * axes**0.5 for axes in (0, 1, 2, 3)}
"""Radius of the balls that cover a step over so many axes, cells; 0 axes: waiting."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Lines:
    """What the next layer needs of those before; words [..., total], newest last."""

    reached: jax.Array
    """[total] cells reached at the last layer."""
    leave: tuple[jax.Array, jax.Array, jax.Array]
    """[n + 1, total] per number of axes n: cells reached at the last n + 1 layers from which such a
    step can set out."""
    rest: jax.Array
    """[4, total] cells that are taken during the last layer, for waiting and for the ends of steps
    over 1, 2, 3 axes."""
    middle: tuple[jax.Array, jax.Array, jax.Array]
    """[n, blocks, total] per number of axes: middles of blocks that were taken during the last
    layers (2, 3, 3 of them)."""


def reachable(
    land: Terrain, free: FreeSpace, balls: Balls, start: jax.Array, first: jax.Array
) -> jax.Array:
    """Cells that the robot can be in at each layer.

    Args:
        land: the world.
        free: the robot's free space.
        balls: the other robots; L layers.
        start: uint32 [total] the start cell's bit.
        first: int [] layer at which the robot is there.

    Returns:
        uint32 [L, inner].
    """
    layout = land.layout
    stamp = _Stamp(land)
    n_block = [sum(sum(b) == axes for b in BLOCKS) for axes in (1, 2, 3)]
    none = jnp.zeros((layout.total,), jnp.uint32)

    def zeros(*lead: int) -> jax.Array:
        return jnp.zeros((*lead, layout.total), jnp.uint32)

    begin = Lines(
        reached=none,
        leave=(zeros(2), zeros(3), zeros(4)),
        rest=zeros(4),
        middle=(zeros(2, n_block[0]), zeros(3, n_block[1]), zeros(3, n_block[2])),
    )

    def layer(
        lines: Lines, now: tuple[jax.Array, jax.Array, jax.Array]
    ) -> tuple[Lines, jax.Array]:
        n, centre, radius = now
        inner = _advance(layout, free, lines)
        seed = jnp.where(n == first, start, jnp.uint32(0))
        reached = layout.pad(inner) | seed
        rest, middle = stamp(centre, radius)
        return (
            Lines(
                reached=reached,
                leave=tuple(
                    jnp.concatenate([line[1:], (reached & ~rest[axes])[None]])
                    for axes, line in zip((1, 2, 3), lines.leave, strict=True)
                ),
                rest=rest,
                middle=tuple(
                    jnp.concatenate([line[1:], taken[None]])
                    for line, taken in zip(lines.middle, middle, strict=True)
                ),
            ),
            reached[layout.guard : layout.guard + layout.inner],
        )

    n_layer = balls.radius_m.shape[0]
    _, history = jax.lax.scan(
        layer, begin, (jnp.arange(n_layer), balls.centre_m, balls.radius_m)
    )
    return history


def _advance(layout: Layout, free: FreeSpace, lines: Lines) -> jax.Array:
    """Cells [inner] that are reached one layer after the last of ``lines``."""
    taken = (
        lines.middle[0][0] | lines.middle[0][1],
        lines.middle[1][0] | lines.middle[1][1] | lines.middle[1][2],
        lines.middle[2][0] | lines.middle[2][1],
    )
    blocks = {
        block: taken[axes - 1][index]
        for axes in (1, 2, 3)
        for index, block in enumerate(b for b in BLOCKS if sum(b) == axes)
    }
    reached = layout.look(lines.reached & ~lines.rest[0], 0, 0, 0)
    for axes in (1, 2, 3):
        arrived = jnp.zeros_like(reached)
        for edge, clear in zip(EDGES, free.edges, strict=True):
            if edge.axes != axes:
                continue
            for a, b in ((edge.near, edge.far), (edge.far, edge.near)):
                came = layout.look(lines.leave[axes - 1][0], *(i - k for i, k in zip(a, b, strict=True)))
                back = tuple(-k for k in b)
                arrived |= came & layout.look(clear, *back) & ~layout.look(blocks[edge.block], *back)
        reached |= arrived & ~layout.look(lines.rest[axes], 0, 0, 0)
    return reached & layout.look(free.cells, 0, 0, 0)


class _Stamp:
    """Marks what the other robots take during a layer."""

    def __init__(self, land: Terrain) -> None:
        self.grid = land.grid
        self.x, self.y = land.layout.centres(land.grid)

    def __call__(
        self, centre: jax.Array, radius: jax.Array
    ) -> tuple[jax.Array, tuple[jax.Array, jax.Array, jax.Array]]:
        """Taken cells [4, total] (waiting, steps over 1, 2, 3 axes) and middles, per axes."""
        rest = [self._cylinders(centre, radius, (0, 0, 0), QUARTER[axes]) for axes in range(4)]
        middle = [
            jnp.stack(
                [
                    self._cylinders(centre, radius, block, QUARTER[axes])
                    for block in BLOCKS
                    if sum(block) == axes
                ]
            )
            for axes in (1, 2, 3)
        ]
        return jnp.stack(rest), (middle[0], middle[1], middle[2])

    def _cylinders(
        self, centre: jax.Array, radius: jax.Array, block: tuple[int, int, int], grow: float
    ) -> jax.Array:
        """Words [total] of the points at the middle of ``block`` inside any robot's cylinder.

        Args:
            centre: [R, 3] m.
            radius: [R] m, negative where the robot does not count.
            block: (0, 0, 0) for the cells' centres.
            grow: what the radius grows by, cells.
        """
        cell = self.grid.cell_m
        wide = jnp.where(radius >= 0.0, radius + grow * cell, -1.0)
        x, y = self.x + 0.5 * block[0] * cell, self.y + 0.5 * block[1] * cell
        z = (centre[:, 2] - self.grid.origin_m[2]) / cell - 0.5 - 0.5 * block[2]
        up = jnp.clip(jnp.floor(z + wide / cell), -1.0, 32.0).astype(jnp.int32)
        down = jnp.clip(jnp.ceil(z - wide / cell), -1.0, 32.0).astype(jnp.int32)
        bits = span_bits(down, up)
        words = jnp.zeros((x.shape[0],), jnp.uint32)
        for k in range(centre.shape[0]):
            square = (x - centre[k, 0]) ** 2 + (y - centre[k, 1]) ** 2
            inside = (square < wide[k] ** 2) & (wide[k] >= 0.0)
            words |= jnp.where(inside, bits[k], jnp.uint32(0))
        return words


def _backward_tables() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Of the 26 steps: what to add to a cell to get the one before, layers, cover of the way.

    The cover is five rows (share of the step still ahead, layer before arrival, 1 the last), some
    of them equal; see the module's docstring.
    """
    cover = {
        1: [(1.0, 2), (0.5, 2), (0.5, 1), (0.0, 1), (0.0, 1)],
        2: [(1.0, 3), (0.5, 3), (0.5, 2), (0.5, 1), (0.0, 1)],
        3: [(1.0, 4), (0.5, 3), (0.5, 2), (0.0, 1), (0.0, 1)],
    }
    steps, layers, share, when, grow = [], [], [], [], []
    for edge in EDGES:
        step = np.subtract(edge.far, edge.near)
        for sign in (1, -1):
            steps.append(sign * step)
            layers.append(edge.layers)
            share.append([row[0] for row in cover[edge.axes]])
            when.append([row[1] for row in cover[edge.axes]])
            grow.append(QUARTER[edge.axes])
    return np.array(steps), np.array(layers), np.array(share), np.array(when), np.array(grow)


_STEPS, _LAYERS, _SHARE, _WHEN, _GROW = _backward_tables()


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Route:
    """A way over cells in time; K rows from the start to the goal, the first one repeated."""

    position_m: jax.Array
    """[K, 3]."""
    arrive_s: jax.Array
    """[K]."""
    leave_s: jax.Array
    """[K] >= arrive_s: until then the robot can stay there."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _Walk:
    cell: jax.Array
    layer: jax.Array
    last: jax.Array
    row: jax.Array
    cells: jax.Array
    arrive: jax.Array
    leave: jax.Array


def trace_back(
    land: Terrain,
    free: FreeSpace,
    balls: Balls,
    history: jax.Array,
    layer_s: jax.Array,
    goal: tuple[jax.Array, jax.Array],
    start: tuple[jax.Array, jax.Array],
) -> Route:
    """A way from the start to the goal through the reached sets, walked backwards.

    Where the robot could have been in the same cell one layer before, it waited there: so every cell
    of the way is entered as early as it can be. Among the steps that could have led there the one
    nearest to the straight line from the start is taken, because that pulls straight best.

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
    layout = land.layout
    size = history.shape[0] // 2 + 2
    row = jnp.array(size - 1)
    walk = _Walk(
        cell=goal[0],
        layer=goal[1],
        last=goal[1],
        row=row,
        cells=jnp.broadcast_to(start[0], (size, 3)),
        arrive=jnp.zeros((size,), goal[1].dtype),
        leave=jnp.zeros((size,), goal[1].dtype),
    )
    flat = history.reshape(-1)
    shape = jnp.array(layout.shape)
    edge_rows = jnp.repeat(jnp.arange(len(EDGES)), 2)
    lowest = jnp.array(np.minimum(0, -_STEPS))

    def was_there(cells: jax.Array, layers: jax.Array) -> jax.Array:
        inside = jnp.all((cells >= 0) & (cells < shape), axis=-1) & (layers >= start[1])
        at = layers * layout.inner + cells[:, 0] * layout.row + cells[:, 1]
        words = flat[jnp.where(inside, at, 0)]
        return inside & (((words >> cells[:, 2].astype(jnp.uint32)) & 1) == 1)

    def step(walk: _Walk) -> _Walk:
        recent = jax.tree.map(
            lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, jnp.maximum(walk.layer - 4, 0), 4), balls
        )
        before = jnp.concatenate([walk.cell[None], walk.cell - _STEPS])
        took = jnp.concatenate([jnp.ones((1,), jnp.int32), jnp.array(_LAYERS, jnp.int32)])
        possible = was_there(before, walk.layer - took)
        low = walk.cell + lowest
        word = layout.guard + low[:, 0] * layout.row + low[:, 1]
        free_edge = (free.edges[edge_rows, word] >> jnp.maximum(low[:, 2], 0).astype(jnp.uint32)) & 1
        possible &= jnp.concatenate([jnp.ones((1,), bool), free_edge == 1])
        possible &= _undisturbed(land, recent, walk)
        off = _off_line(walk.cell - _STEPS, start[0], walk.cell)
        # Waiting first; a way that cannot be (-inf would hide it) goes last.
        cost = jnp.where(possible, jnp.concatenate([jnp.full((1,), -1.0, off.dtype), off]), jnp.inf)
        best = jnp.argmin(cost)
        moved = best > 0
        here = (jnp.arange(size) == walk.row) & moved
        return replace(
            walk,
            cell=before[best],
            layer=walk.layer - took[best],
            last=jnp.where(moved, walk.layer - took[best], walk.last),
            row=walk.row - moved,
            cells=jnp.where(here[:, None], walk.cell, walk.cells),
            arrive=jnp.where(here, walk.layer, walk.arrive),
            leave=jnp.where(here, walk.last, walk.leave),
        )

    def going(walk: _Walk) -> jax.Array:
        return walk.layer > start[1]

    walk = jax.lax.while_loop(going, step, walk)
    first = jnp.arange(size) == walk.row
    leave = jnp.where(first, walk.last, walk.leave)
    arrive = jnp.where(first, walk.layer, walk.arrive)
    grid = land.grid
    return Route(
        position_m=grid.origin_m + (walk.cells + 0.5) * grid.cell_m,
        arrive_s=arrive * layer_s,
        leave_s=leave * layer_s,
    )


def _undisturbed(land: Terrain, recent: Balls, walk: _Walk) -> jax.Array:
    """Whether waiting and each of the 26 steps that end in ``walk`` keep clear of balls, bool [27]."""
    cell = land.grid.cell_m
    here = land.grid.origin_m + (walk.cell + 0.5) * cell
    first = jnp.maximum(walk.layer - 4, 0)
    index = jnp.maximum(walk.layer - _WHEN - first, 0)
    place = here - _SHARE[..., None] * _STEPS[:, None, :] * cell
    centre, radius = recent.centre_m[index], recent.radius_m[index]
    apart = jnp.sum((place[:, :, None, :] - centre) ** 2, axis=-1)
    wide = radius + (_GROW * cell)[:, None, None]
    hit = (radius >= 0.0) & (apart < wide * wide)
    now = walk.layer - 1 - first
    rest = jnp.sum((here - recent.centre_m[now]) ** 2, axis=-1)
    stays = (recent.radius_m[now] < 0.0) | (rest >= recent.radius_m[now] ** 2)
    return jnp.concatenate([jnp.all(stays)[None], ~jnp.any(hit, axis=(1, 2))])


def _off_line(points: jax.Array, a: jax.Array, b: jax.Array) -> jax.Array:
    """Squared distance [n] of ``points`` [n, 3] from the line through a and b, in cells."""
    d = (b - a).astype(jnp.float32)
    r = (points - a).astype(jnp.float32)
    along = jnp.sum(r * d, axis=-1)
    return jnp.sum(r * r, axis=-1) - along * along / jnp.maximum(jnp.sum(d * d), 1.0)
