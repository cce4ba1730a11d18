"""The search of `search` as one GPU kernel: a program per robot, its lines in registers.

A program's lanes are the columns of one robot's grid. In each layer a lane tells its neighbours
from where steps set out, works out the steps over all blocks that have their lowest corner in its
column, and tells its neighbours where these end; all else stays in its registers. A program ends as
soon as its own robot can arrive, whatever the others of the batch need.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from angler_kernels.programs import BlockProgram
from angler_mjx.planning.path_search.lattice import (
    BLOCKS,
    EDGES,
    FreeSpace,
    LatticeLayout,
    Terrain,
    span_bits,
)
from angler_mjx.planning.path_search.search import QUARTER
from angler_mjx.planning.path_search.traffic import Balls

_LEAVING = 3
"""Lines of scratch before those of the ends: where steps over 1, 2, 3 axes set out."""
_ENDS = tuple(
    (axes, corner)
    for corner in ((1, 0), (0, 1), (1, 1))
    for axes in (1, 2, 3)
    if any(corner in (edge.near[:2], edge.far[:2]) and edge.axes == axes for edge in EDGES)
)
"""Ends of steps in other columns than that of the block: axes of the step, and the column."""
_SCRATCH = _LEAVING + len(_ENDS)

AT_ONCE = 4
"""Balls that are marked without a loop."""

_SPANS = tuple((axes, up) for up in (0, 1) for axes in range(4) if axes >= up)
"""What a ball's span of bits depends on: axes of the step, and whether half a cell further up."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Cylinders:
    """Balls as the kernel takes them: upright cylinders, in the order of the layers."""

    place: jax.Array
    """[L, R, 2] x and y, m."""
    square: jax.Array
    """[L, R, 4] squared radius per number of axes, m^2; negative where it does not count."""
    span: jax.Array
    """uint32 [L, R, 7] bits along z, in the order of _SPANS."""


def cylinders(land: Terrain, balls: Balls) -> Cylinders:
    """The cylinders around balls, each with a quarter of the steps' lengths more."""
    cell = land.grid.cell_m
    counts = balls.radius_m >= 0.0
    wide = [jnp.where(counts, balls.radius_m + QUARTER[axes] * cell, -1.0) for axes in range(4)]
    spans = []
    for axes, up in _SPANS:
        z = (balls.centre_m[..., 2] - land.grid.origin_m[2]) / cell - 0.5 - 0.5 * up
        top = jnp.clip(jnp.floor(z + wide[axes] / cell), -1.0, 32.0).astype(jnp.int32)
        bottom = jnp.clip(jnp.ceil(z - wide[axes] / cell), -1.0, 32.0).astype(jnp.int32)
        spans.append(span_bits(bottom, top))
    return Cylinders(
        place=balls.centre_m[..., :2],
        square=jnp.stack([jnp.where(counts, w * w, -1.0) for w in wide], axis=-1),
        span=jnp.stack(spans, axis=-1),
    )


def reachable(
    land: Terrain,
    free: FreeSpace,
    balls: Balls,
    start: tuple[jax.Array, jax.Array],
    goal: jax.Array,
    may_stay: jax.Array,
    *,
    interpret: bool = False,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """As `search.reachable`; layers of the history after the arrival are not written.

    Args:
        land: the world.
        free: the robot's free space.
        balls: the other robots; L layers.
        start: cell [3], and layer [] at which the robot is there.
        goal: int [3] the goal's cell.
        may_stay: bool [L].
        interpret: run as ordinary JAX, on any device.
    """
    layout = land.layout
    around = cylinders(land, _whole_groups(balls))
    n_layer, n_ball, _ = around.place.shape
    program = BlockProgram.of(layout.shape[0] * layout.shape[1], interpret=interpret)
    x, y = layout.centres(land.grid)
    half = 0.5 * land.grid.cell_m
    cell, first = start
    numbers = jnp.stack(
        [
            first,
            layout.guard + cell[0] * layout.row + cell[1],
            cell[2],
            goal[0] * layout.row + goal[1],
            goal[2],
        ]
    ).astype(jnp.int32)
    history, arrival, _ = program.run(
        _Kernel(layout, program, n_layer, n_ball),
        [
            numbers,
            may_stay.astype(jnp.int32),
            free.cells,
            free.edges.reshape(-1),
            jnp.stack([x, y]).reshape(-1),
            half[None],
            around.place.reshape(-1),
            around.square.reshape(-1),
            around.span.reshape(-1),
        ],
        [
            jax.ShapeDtypeStruct((n_layer * layout.inner,), jnp.uint32),
            jax.ShapeDtypeStruct((1,), jnp.int32),
            jax.ShapeDtypeStruct((_SCRATCH * layout.total,), jnp.uint32),
        ],
    )
    return (
        history.reshape(n_layer, layout.inner),
        jnp.maximum(arrival[0], 0),
        arrival[0] >= 0,
    )


def _whole_groups(balls: Balls) -> Balls:
    """Balls with as many more, which do not count, as fill the last group."""
    more = -balls.radius_m.shape[1] % AT_ONCE
    return Balls(
        centre_m=jnp.pad(balls.centre_m, ((0, 0), (0, more), (0, 0))),
        radius_m=jnp.pad(balls.radius_m, ((0, 0), (0, more)), constant_values=-1.0),
    )


type _Words = Any
"""uint32 [lanes]."""


@dataclass(frozen=True)
class _Kernel:
    layout: LatticeLayout
    program: BlockProgram
    n_layer: int
    n_ball: int

    __name__ = "reachable"

    def __call__(
        self,
        numbers: Any,
        may_stay: Any,
        cells: Any,
        edges: Any,
        centres: Any,
        half: Any,
        place: Any,
        square: Any,
        span: Any,
        history: Any,
        arrival: Any,
        scratch: Any,
    ) -> None:
        layout = self.layout
        lane = jnp.arange(self.program.lanes)
        real = lane < layout.shape[0] * layout.shape[1]
        column = jnp.where(real, lane, 0)
        inner = column // layout.shape[1] * layout.row + column % layout.shape[1]
        at = inner + layout.guard
        zero = jnp.zeros((self.program.lanes,), jnp.uint32)

        def words(ref: Any, offset: Any) -> _Words:
            return self.program.load(ref, at + offset, real, 0)

        self._clear(scratch, lane)
        free = words(cells, 0)
        open_edges = [words(edges, k * layout.total) for k in range(len(EDGES))]
        x = self.program.load(centres, at, real, 0.0)
        y = self.program.load(centres, at + layout.total, real, 0.0)
        step = half[0]
        first, start_at, start_z = numbers[0], numbers[1], numbers[2]
        goal_at, goal_z = numbers[3], numbers[4]
        start = jnp.where(
            real & (at == start_at), jnp.uint32(1) << start_z.astype(jnp.uint32), zero
        )

        def layer(state: Any) -> Any:
            n, arrived, lines = state
            for k in range(_LEAVING):
                self.program.store(scratch, at + k * layout.total, lines[1][k][0], real)
            self.program.barrier()
            # Written before the barrier, so that every lane may read it.
            before = jnp.maximum(n - 1, 0)
            word = history[before * layout.inner + goal_at]
            there = (word >> goal_z.astype(jnp.uint32)) & 1
            arrives = (n > 0) & (there == 1) & (may_stay[before] == 1)
            arrived = jnp.where(arrives, n - 1, arrived)
            seed = jnp.where(n == first, start, zero)
            reached = self._advance(scratch, at, real, lines, open_edges) & free | seed
            now = jnp.minimum(n, self.n_layer - 1)
            self.program.store(history, now * layout.inner + inner, reached, real & (n == now))
            taken = self._taken(now * self.n_ball, x, y, step, place, square, span)
            return n + 1, arrived, _shift(lines, reached, taken)

        def going(state: Any) -> Any:
            return (state[1] < 0) & (state[0] <= self.n_layer)

        nothing = (
            zero,
            tuple((zero,) * n for n in (2, 3, 4)),
            (zero,) * 4,
            tuple(((zero,) * n) * k for n, k in ((2, 3), (3, 3), (3, 1))),
        )
        _, arrived, _ = jax.lax.while_loop(going, layer, (jnp.int32(0), jnp.int32(-1), nothing))
        arrival[0] = arrived

    def _clear(self, scratch: Any, lane: Any) -> None:
        """Guards are never written again."""
        size = _SCRATCH * self.layout.total
        zero = jnp.zeros((self.program.lanes,), jnp.uint32)

        def one(k: Any, unchanged: Any) -> Any:
            at = k * self.program.lanes + lane
            self.program.store(scratch, at, zero, at < size)
            return unchanged

        jax.lax.fori_loop(0, -(-size // self.program.lanes), one, jnp.int32(0))
        self.program.barrier()

    def _advance(
        self, scratch: Any, at: Any, real: Any, lines: Any, open_edges: list[_Words]
    ) -> _Words:
        """Cells that are reached one layer after the last of ``lines``; not free ones too."""
        layout = self.layout

        def place(line: int, x: int, y: int) -> Any:
            return at + (line * layout.total + x * layout.row + y)

        reached, leave, rest, middle = lines
        leaving = {(axes, (0, 0)): leave[axes - 1][0] for axes in (1, 2, 3)}
        for axes, (x, y) in _ENDS:
            leaving[axes, (x, y)] = self.program.load(scratch, place(axes - 1, x, y), real, 0)
        blocked = _blocked(middle)
        ends = {key: jnp.zeros_like(reached) for key in leaving}
        for edge, is_open in zip(EDGES, open_edges, strict=True):
            clear = is_open & ~blocked[edge.block]
            for a, b in ((edge.near, edge.far), (edge.far, edge.near)):
                step = _up(leaving[edge.axes, a[:2]], a[2]) & clear
                ends[edge.axes, b[:2]] |= _up(step, -b[2])
        for line, key in enumerate(_ENDS, start=_LEAVING):
            self.program.store(scratch, place(line, 0, 0), ends[key], real)
        self.program.barrier()
        for line, (axes, (x, y)) in enumerate(_ENDS, start=_LEAVING):
            ends[axes, (0, 0)] |= self.program.load(scratch, place(line, -x, -y), real, 0)
        after = reached & ~rest[0]
        for axes in (1, 2, 3):
            after |= ends[axes, (0, 0)] & ~rest[axes]
        return after

    def _taken(
        self, row: Any, x: Any, y: Any, half: Any, place: Any, square: Any, span: Any
    ) -> tuple[_Words, ...]:
        """What the balls of a layer take: waiting and steps over 1, 2, 3 axes, then middles."""
        zero = jnp.zeros((self.program.lanes,), jnp.uint32)
        kinds = ((0, 0, 0),) * 4 + BLOCKS
        grows = (0, 1, 2, 3, *(sum(block) for block in BLOCKS))

        def mark(ball: Any, words: tuple[_Words, ...]) -> tuple[_Words, ...]:
            off_x, off_y = x - place[2 * ball], y - place[2 * ball + 1]
            x2 = (off_x**2, (off_x + half) ** 2)
            y2 = (off_y**2, (off_y + half) ** 2)
            wide = [square[4 * ball + axes] for axes in range(4)]
            bits = {key: span[len(_SPANS) * ball + i] for i, key in enumerate(_SPANS)}
            inside: dict[tuple[int, int, int], Any] = {}
            out = []
            for line, block, axes in zip(words, kinds, grows, strict=True):
                key = (block[0], block[1], axes)
                if key not in inside:
                    inside[key] = x2[block[0]] + y2[block[1]] < wide[axes]
                out.append(line | jnp.where(inside[key], bits[axes, block[2]], jnp.uint32(0)))
            return tuple(out)

        def mark_some(group: Any, words: tuple[_Words, ...]) -> tuple[_Words, ...]:
            for k in range(AT_ONCE):
                words = mark(row + group * AT_ONCE + k, words)
            return words

        nothing = (zero,) * len(kinds)
        if self.n_ball == AT_ONCE:
            return mark_some(0, nothing)
        marked: tuple[_Words, ...] = jax.lax.fori_loop(
            0, self.n_ball // AT_ONCE, mark_some, nothing
        )
        return marked


def _up(words: _Words, dz: int) -> _Words:
    """What stands dz cells above."""
    if dz > 0:
        return words >> dz
    return words << -dz if dz < 0 else words


def _blocked(middle: Any) -> dict[tuple[int, int, int], _Words]:
    """Kinds of block whose middle is taken while a step over it would be there."""
    blocked = {}
    for axes, count in ((1, 2), (2, 3), (3, 2)):
        of_axes = [block for block in BLOCKS if sum(block) == axes]
        for k, block in enumerate(of_axes):
            taken = middle[axes - 1][k * (axes if axes == 3 else axes + 1) :][:count]
            blocked[block] = _any(taken)
    return blocked


def _any(words: Any) -> _Words:
    out = words[0]
    for more in words[1:]:
        out = out | more
    return out


def _shift(lines: Any, reached: _Words, taken: tuple[_Words, ...]) -> Any:
    """The lines one layer later: reached, leave per axes, rest, middles per axes."""
    _, leave, _, middle = lines
    rest, middles = taken[:4], dict(zip(BLOCKS, taken[4:], strict=True))
    leave = tuple(
        (*old[1:], reached & ~rest[axes]) for axes, old in zip((1, 2, 3), leave, strict=True)
    )
    shifted = []
    for axes, old in zip((1, 2, 3), middle, strict=True):
        of_axes = [block for block in BLOCKS if sum(block) == axes]
        size = len(old) // len(of_axes)
        rows: tuple[_Words, ...] = ()
        for k, block in enumerate(of_axes):
            rows += (*old[k * size + 1 : (k + 1) * size], middles[block])
        shifted.append(rows)
    return reached, leave, rest, tuple(shifted)
