"""Space-time reachability of one robot over free cells.

A layer is half the time of a step along an axis. Steps along 1, 2, 3 axes take 2, 3, 4 layers: the
lengths 2, 2.83, 3.46 rounded up. The set of cells that can be reached exactly at a layer is one
word per column; the next layer is some hundred bit operations per word.

Other robots are balls (see `traffic`). A step is covered by balls too: about its beginning, middle
and end, each with a quarter of its length; during each of its layers only those count between which
the robot then is. A ball is tested as the upright cylinder around it, which in a word is one span
of bits. So a step that is taken is clear in continuous time and space.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_kernels.rows import write_row
from angler_mjx.planning.path_search.batching import min_of_batch
from angler_mjx.planning.path_search.lattice import (
    BLOCKS,
    EDGES,
    FreeSpace,
    LatticeLayout,
    Terrain,
    span_bits,
)
from angler_mjx.planning.path_search.traffic import Balls

QUARTER = {axes: 0.25 * axes**0.5 for axes in (0, 1, 2, 3)}
"""Radius of the balls that cover a step over so many axes, cells; 0 axes: waiting."""

ROBOTS_PER_LOOP = 16
"""Robots that are marked without a loop: unrolled for 256, compiling takes minutes."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class LayerLines:
    """Lines of earlier layers that the next one needs; words [..., total], newest last."""

    reached: jax.Array
    """[total] cells reached at the last layer."""
    leave: tuple[jax.Array, jax.Array, jax.Array]
    """[n + 1, total] per number of axes n: cells reached at the last n + 1 layers from which such a
    step can set out."""
    rest: jax.Array
    """[4, total] cells that are taken during the last layer, for waiting and for the ends of steps
    over 1, 2, 3 axes."""
    middle: tuple[jax.Array, jax.Array, jax.Array]
    """[n, blocks, total] per number of axes: middles of its 3, 3, 1 kinds of block that were taken
    during the last 2, 3, 3 layers."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _SearchState:
    layer: jax.Array
    lines: LayerLines
    history: jax.Array
    arrival: jax.Array


def search_reachable(
    land: Terrain,
    free: FreeSpace,
    balls: Balls,
    start: jax.Array,
    first: jax.Array,
    goal: jax.Array,
    may_stay: jax.Array,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return the cells that the robot can reach at each layer, until its goal.

    Args:
        land: the world.
        free: the robot's free space.
        balls: the other robots; L layers.
        start: uint32 [total] the start cell's bit.
        first: int [] layer at which the robot is there.
        goal: int [3] the goal's cell.
        may_stay: bool [L] whether a robot at its goal from this layer on is never met.

    Returns:
        uint32 [L, inner]; zero after the last layer that any world of a batch needed. Layer [] of
        the arrival, and whether there is one.
    """
    layout = land.layout
    n_layer = balls.radius_m.shape[0]
    goal_word = goal[0] * layout.row + goal[1]
    stamp = _TrafficStamp(land)

    def layer(state: _SearchState) -> _SearchState:
        n, lines = state.layer, state.lines
        seed = jnp.where(n == first, start, jnp.uint32(0))
        reached = layout.pad(_advance_layer(layout, free, lines)) | seed
        rest, middle = stamp(balls.centre_m[n], balls.radius_m[n])
        inner = reached[layout.guard_size : layout.guard_size + layout.inner]
        is_at_goal = ((inner[goal_word] >> goal[2].astype(jnp.uint32)) & 1) == 1
        return _SearchState(
            layer=n + 1,
            lines=_shift_lines(lines, reached, rest, middle),
            history=write_row(state.history, inner, n),
            arrival=jnp.where(is_at_goal & may_stay[n] & (state.arrival < 0), n, state.arrival),
        )

    def is_searching(state: _SearchState) -> jax.Array:
        slowest: jax.Array = min_of_batch(state.arrival)
        return (state.layer < n_layer) & (slowest < 0)

    begin = _SearchState(
        layer=jnp.array(0),
        lines=_empty_lines(layout),
        history=jnp.zeros((n_layer, layout.inner), jnp.uint32),
        arrival=jnp.array(-1),
    )
    end = jax.lax.while_loop(is_searching, layer, begin)
    return end.history, jnp.maximum(end.arrival, 0), end.arrival >= 0


def _empty_lines(layout: LatticeLayout) -> LayerLines:
    """Return the lines before the first layer: nothing reached, nothing taken."""

    def zeros(*lead: int) -> jax.Array:
        return jnp.zeros((*lead, layout.total), jnp.uint32)

    return LayerLines(
        reached=zeros(),
        leave=(zeros(2), zeros(3), zeros(4)),
        rest=zeros(4),
        middle=(zeros(2, 3), zeros(3, 3), zeros(3, 1)),
    )


def _shift_lines(
    lines: LayerLines, reached: jax.Array, rest: jax.Array, middle: tuple[jax.Array, ...]
) -> LayerLines:
    """Return the lines one layer later."""
    leave = [
        jnp.concatenate([line[1:], (reached & ~rest[axes])[None]])
        for axes, line in zip((1, 2, 3), lines.leave, strict=True)
    ]
    taken = [
        jnp.concatenate([line[1:], new[None]])
        for line, new in zip(lines.middle, middle, strict=True)
    ]
    return LayerLines(
        reached=reached,
        leave=(leave[0], leave[1], leave[2]),
        rest=rest,
        middle=(taken[0], taken[1], taken[2]),
    )


def _advance_layer(layout: LatticeLayout, free: FreeSpace, lines: LayerLines) -> jax.Array:
    """Return the cells [inner] that are reached one layer after the last of ``lines``."""
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
    reached = layout.shift_to_neighbour(lines.reached & ~lines.rest[0], 0, 0, 0)
    for axes in (1, 2, 3):
        arrived = jnp.zeros_like(reached)
        for edge, clear in zip(EDGES, free.edges, strict=True):
            if edge.axes != axes:
                continue
            for a, b in ((edge.near, edge.far), (edge.far, edge.near)):
                came = layout.shift_to_neighbour(
                    lines.leave[axes - 1][0], *(i - k for i, k in zip(a, b, strict=True))
                )
                back = tuple(-k for k in b)
                arrived |= (
                    came
                    & layout.shift_to_neighbour(clear, *back)
                    & ~layout.shift_to_neighbour(blocks[edge.block], *back)
                )
        reached |= arrived & ~layout.shift_to_neighbour(lines.rest[axes], 0, 0, 0)
    return reached & layout.shift_to_neighbour(free.cells, 0, 0, 0)


class _TrafficStamp:
    """Marks the cells that other robots take during a layer."""

    def __init__(self, land: Terrain) -> None:
        self.grid = land.grid
        self.x, self.y = land.layout.column_centres(land.grid)

    def __call__(
        self, centre: jax.Array, radius: jax.Array
    ) -> tuple[jax.Array, tuple[jax.Array, jax.Array, jax.Array]]:
        """Return taken cells [4, total] (waiting, steps over 1 to 3 axes) and middles, per axes."""
        rest = [self._mark_cylinders(centre, radius, (0, 0, 0), QUARTER[axes]) for axes in range(4)]
        middle = [
            jnp.stack(
                [
                    self._mark_cylinders(centre, radius, block, QUARTER[axes])
                    for block in BLOCKS
                    if sum(block) == axes
                ]
            )
            for axes in (1, 2, 3)
        ]
        return jnp.stack(rest), (middle[0], middle[1], middle[2])

    def _mark_cylinders(
        self, centre: jax.Array, radius: jax.Array, block: tuple[int, int, int], grow: float
    ) -> jax.Array:
        """Return words [total] of the middles of ``block`` inside any robot's cylinder.

        Args:
            centre: [R, 3] m.
            radius: [R] m, negative where the robot does not count.
            block: (0, 0, 0) for the cells' centres.
            grow: growth of the radius, cells.
        """
        cell = self.grid.cell_m
        inflated = jnp.where(radius >= 0.0, radius + grow * cell, -1.0)
        x, y = self.x + 0.5 * block[0] * cell, self.y + 0.5 * block[1] * cell
        z = (centre[:, 2] - self.grid.origin_m[2]) / cell - 0.5 - 0.5 * block[2]
        up = jnp.clip(jnp.floor(z + inflated / cell), -1.0, 32.0).astype(jnp.int32)
        down = jnp.clip(jnp.ceil(z - inflated / cell), -1.0, 32.0).astype(jnp.int32)
        bits = span_bits(down, up)
        n_robot = centre.shape[0]

        def mark(packed: jax.Array, k: int | jax.Array) -> jax.Array:
            square = (x - centre[k, 0]) ** 2 + (y - centre[k, 1]) ** 2
            inside = (square < inflated[k] ** 2) & (inflated[k] >= 0.0)
            return packed | jnp.where(inside, bits[k], jnp.uint32(0))

        def mark_some(group: jax.Array, packed: jax.Array) -> jax.Array:
            for k in range(ROBOTS_PER_LOOP):
                packed = mark(packed, jnp.minimum(group * ROBOTS_PER_LOOP + k, n_robot - 1))
            return packed

        packed = jnp.zeros((x.shape[0],), jnp.uint32)
        if n_robot > ROBOTS_PER_LOOP:
            marked: jax.Array = jax.lax.fori_loop(
                0, -(-n_robot // ROBOTS_PER_LOOP), mark_some, packed
            )
            return marked
        for k in range(n_robot):
            packed = mark(packed, k)
        return packed
