"""The search of `search` as one GPU kernel: a program per robot, its lines in registers.

A program's lanes are the columns of one robot's grid. In each layer a lane sends its neighbours
the starts of steps, computes the steps over all blocks that have their lowest corner in its
column, and sends its neighbours the ends of these; all else stays in its registers. A program ends
as soon as its own robot can arrive, whatever the others of the batch need.
"""

from dataclasses import dataclass

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

BALLS_PER_LOOP = 4
"""Balls that are marked without a loop."""

_SPANS = tuple((axes, up) for up in (0, 1) for axes in range(4) if axes >= up)
"""Kinds of a ball's span of bits: axes of the step, and whether half a cell further up."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Cylinders:
    """Balls as the kernel takes them: upright cylinders, in the order of the layers."""

    centre_xy_m: jax.Array
    """[L, R, 2] x and y, m."""
    square: jax.Array
    """[L, R, 4] squared radius per number of axes, m^2; negative where it does not count."""
    span: jax.Array
    """uint32 [L, R, 7] bits along z, in the order of _SPANS."""


def build_cylinders(land: Terrain, balls: Balls) -> Cylinders:
    """Return the cylinders around balls, each with a quarter of the steps' lengths more."""
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
        centre_xy_m=balls.centre_m[..., :2],
        square=jnp.stack([jnp.where(counts, w * w, -1.0) for w in wide], axis=-1),
        span=jnp.stack(spans, axis=-1),
    )


def search_reachable(
    land: Terrain,
    free: FreeSpace,
    balls: Balls,
    start: tuple[jax.Array, jax.Array],
    goal: jax.Array,
    may_stay: jax.Array,
    *,
    interpret: bool = False,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Run `search.search_reachable`; layers after the arrival are not written.

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
    around = build_cylinders(land, _pad_to_groups(balls))
    n_layer, n_ball, _ = around.centre_xy_m.shape
    program = BlockProgram.of(layout.shape[0] * layout.shape[1], interpret=interpret)
    x, y = layout.column_centres(land.grid)
    half = 0.5 * land.grid.cell_m
    cell, first = start
    numbers = jnp.stack(
        [
            first,
            layout.guard_size + cell[0] * layout.row + cell[1],
            cell[2],
            goal[0] * layout.row + goal[1],
            goal[2],
        ]
    ).astype(jnp.int32)
    history, arrival, _ = program.run(
        _SearchKernel(layout, program, n_layer, n_ball),
        [
            numbers,
            may_stay.astype(jnp.int32),
            free.cells,
            free.edges.reshape(-1),
            jnp.stack([x, y]).reshape(-1),
            half[None],
            around.centre_xy_m.reshape(-1),
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


def _pad_to_groups(balls: Balls) -> Balls:
    """Pad balls to whole groups by balls that do not count."""
    more = -balls.radius_m.shape[1] % BALLS_PER_LOOP
    return Balls(
        centre_m=jnp.pad(balls.centre_m, ((0, 0), (0, more), (0, 0))),
        radius_m=jnp.pad(balls.radius_m, ((0, 0), (0, more)), constant_values=-1.0),
    )


type _Bits = jax.Array
"""uint32 [lanes]."""
type _Line = tuple[_Bits, ...]
"""Bits of one kind, layer after layer."""
type _Lines = tuple[_Bits, tuple[_Line, ...], _Line, tuple[_Line, ...]]
"""Reached cells; starts of steps over 1 to 3 axes; taken cells by axes; taken middles by axes."""


@dataclass(frozen=True)
class _SearchKernel:
    layout: LatticeLayout
    program: BlockProgram
    n_layer: int
    n_ball: int

    __name__ = "reachable"

    def __call__(
        self,
        numbers: jax.Ref,
        may_stay: jax.Ref,
        cells: jax.Ref,
        edges: jax.Ref,
        centres: jax.Ref,
        half: jax.Ref,
        centre_xy: jax.Ref,
        square: jax.Ref,
        span: jax.Ref,
        history: jax.Ref,
        arrival: jax.Ref,
        scratch: jax.Ref,
    ) -> None:
        layout = self.layout
        lane = jnp.arange(self.program.lanes)
        is_column = lane < layout.shape[0] * layout.shape[1]
        column = jnp.where(is_column, lane, 0)
        inner = column // layout.shape[1] * layout.row + column % layout.shape[1]
        at = inner + layout.guard_size
        zero = jnp.zeros((self.program.lanes,), jnp.uint32)

        def load_bits(ref: jax.Ref, offset: int) -> _Bits:
            return self.program.load(ref, at + offset, is_column, 0)

        self._clear_scratch(scratch, lane)
        free = load_bits(cells, 0)
        open_edges = [load_bits(edges, k * layout.total) for k in range(len(EDGES))]
        x = self.program.load(centres, at, is_column, 0.0)
        y = self.program.load(centres, at + layout.total, is_column, 0.0)
        step = half[0]
        first, start_at, start_z = numbers[0], numbers[1], numbers[2]
        goal_at, goal_z = numbers[3], numbers[4]
        start = jnp.where(
            is_column & (at == start_at), jnp.uint32(1) << start_z.astype(jnp.uint32), zero
        )

        def layer(
            state: tuple[jax.Array, jax.Array, _Lines],
        ) -> tuple[jax.Array, jax.Array, _Lines]:
            n, arrived, lines = state
            for k in range(_LEAVING):
                self.program.store(scratch, at + k * layout.total, lines[1][k][0], is_column)
            self.program.barrier()
            # Written before the barrier, so that every lane may read it.
            before = jnp.maximum(n - 1, 0)
            word = history[before * layout.inner + goal_at]
            is_at_goal = (word >> goal_z.astype(jnp.uint32)) & 1
            arrives = (n > 0) & (is_at_goal == 1) & (may_stay[before] == 1)
            arrived = jnp.where(arrives, n - 1, arrived)
            seed = jnp.where(n == first, start, zero)
            reached = self._advance_layer(scratch, at, is_column, lines, open_edges) & free | seed
            now = jnp.minimum(n, self.n_layer - 1)
            self.program.store(history, now * layout.inner + inner, reached, is_column & (n == now))
            taken = self._mark_taken(now * self.n_ball, x, y, step, centre_xy, square, span)
            return n + 1, arrived, _shift_lines(lines, reached, taken)

        def is_searching(state: tuple[jax.Array, jax.Array, _Lines]) -> jax.Array:
            return (state[1] < 0) & (state[0] <= self.n_layer)

        no_lines: _Lines = (
            zero,
            tuple((zero,) * n for n in (2, 3, 4)),
            (zero,) * 4,
            tuple(((zero,) * n) * k for n, k in ((2, 3), (3, 3), (3, 1))),
        )
        _, arrived, _ = jax.lax.while_loop(
            is_searching, layer, (jnp.int32(0), jnp.int32(-1), no_lines)
        )
        arrival[0] = arrived

    def _clear_scratch(self, scratch: jax.Ref, lane: jax.Array) -> None:
        """Clear the scratch memory; guards are never written again."""
        size = _SCRATCH * self.layout.total
        zero = jnp.zeros((self.program.lanes,), jnp.uint32)

        def clear_part(k: jax.Array, unchanged: jax.Array) -> jax.Array:
            at = k * self.program.lanes + lane
            self.program.store(scratch, at, zero, at < size)
            return unchanged

        jax.lax.fori_loop(0, -(-size // self.program.lanes), clear_part, jnp.int32(0))
        self.program.barrier()

    def _advance_layer(
        self,
        scratch: jax.Ref,
        at: jax.Array,
        real: jax.Array,
        lines: _Lines,
        open_edges: list[_Bits],
    ) -> _Bits:
        """Return the cells reached one layer after the last of ``lines``, occupied ones too."""
        layout = self.layout

        def scratch_index(line: int, x: int, y: int) -> jax.Array:
            return at + (line * layout.total + x * layout.row + y)

        reached, leave, rest, middle = lines
        leaving = {(axes, (0, 0)): leave[axes - 1][0] for axes in (1, 2, 3)}
        for axes, (x, y) in _ENDS:
            leaving[axes, (x, y)] = self.program.load(
                scratch, scratch_index(axes - 1, x, y), real, 0
            )
        blocked = _blocked_blocks(middle)
        ends = {key: jnp.zeros_like(reached) for key in leaving}
        for edge, is_open in zip(EDGES, open_edges, strict=True):
            clear = is_open & ~blocked[edge.block]
            for a, b in ((edge.near, edge.far), (edge.far, edge.near)):
                step = _shift_up(leaving[edge.axes, a[:2]], a[2]) & clear
                ends[edge.axes, b[:2]] |= _shift_up(step, -b[2])
        for line, key in enumerate(_ENDS, start=_LEAVING):
            self.program.store(scratch, scratch_index(line, 0, 0), ends[key], real)
        self.program.barrier()
        for line, (axes, (x, y)) in enumerate(_ENDS, start=_LEAVING):
            ends[axes, (0, 0)] |= self.program.load(scratch, scratch_index(line, -x, -y), real, 0)
        after = reached & ~rest[0]
        for axes in (1, 2, 3):
            after |= ends[axes, (0, 0)] & ~rest[axes]
        return after

    def _mark_taken(
        self,
        row: jax.Array,
        x: jax.Array,
        y: jax.Array,
        half: jax.Array,
        centre_xy: jax.Ref,
        square: jax.Ref,
        span: jax.Ref,
    ) -> _Line:
        """Mark cells taken by balls of a layer: waiting, steps over 1 to 3 axes, then middles."""
        zero = jnp.zeros((self.program.lanes,), jnp.uint32)
        kinds = ((0, 0, 0),) * 4 + BLOCKS
        grows = (0, 1, 2, 3, *(sum(block) for block in BLOCKS))

        def mark(ball: jax.Array, bits_by_block: _Line) -> _Line:
            off_x, off_y = x - centre_xy[2 * ball], y - centre_xy[2 * ball + 1]
            x2 = (off_x**2, (off_x + half) ** 2)
            y2 = (off_y**2, (off_y + half) ** 2)
            wide = [square[4 * ball + axes] for axes in range(4)]
            bits = {key: span[len(_SPANS) * ball + i] for i, key in enumerate(_SPANS)}
            inside: dict[tuple[int, int, int], jax.Array] = {}
            out = []
            for line, block, axes in zip(bits_by_block, kinds, grows, strict=True):
                key = (block[0], block[1], axes)
                if key not in inside:
                    inside[key] = x2[block[0]] + y2[block[1]] < wide[axes]
                out.append(line | jnp.where(inside[key], bits[axes, block[2]], jnp.uint32(0)))
            return tuple(out)

        def mark_some(group: jax.Array | int, bits_by_block: _Line) -> _Line:
            for k in range(BALLS_PER_LOOP):
                bits_by_block = mark(row + group * BALLS_PER_LOOP + k, bits_by_block)
            return bits_by_block

        no_bits = (zero,) * len(kinds)
        if self.n_ball == BALLS_PER_LOOP:
            return mark_some(0, no_bits)
        marked: _Line = jax.lax.fori_loop(0, self.n_ball // BALLS_PER_LOOP, mark_some, no_bits)
        return marked


def _shift_up(bits: _Bits, dz: int) -> _Bits:
    """Return the bits dz cells above."""
    if dz > 0:
        return bits >> dz
    return bits << -dz if dz < 0 else bits


def _blocked_blocks(middle: tuple[_Line, ...]) -> dict[tuple[int, int, int], _Bits]:
    """Return the kinds of block whose middle is taken during a step over it."""
    blocked = {}
    for axes, count in ((1, 2), (2, 3), (3, 2)):
        of_axes = [block for block in BLOCKS if sum(block) == axes]
        for k, block in enumerate(of_axes):
            taken = middle[axes - 1][k * (axes if axes == 3 else axes + 1) :][:count]
            blocked[block] = _bitwise_or(taken)
    return blocked


def _bitwise_or(bits: _Line) -> _Bits:
    union = bits[0]
    for next_bits in bits[1:]:
        union = union | next_bits
    return union


def _shift_lines(lines: _Lines, reached: _Bits, taken: _Line) -> _Lines:
    """Return the lines one layer later: reached, leave per axes, rest, middles per axes."""
    _, leave, _, middle = lines
    rest, middles = taken[:4], dict(zip(BLOCKS, taken[4:], strict=True))
    leave = tuple(
        (*old[1:], reached & ~rest[axes]) for axes, old in zip((1, 2, 3), leave, strict=True)
    )
    shifted = []
    for axes, old in zip((1, 2, 3), middle, strict=True):
        of_axes = [block for block in BLOCKS if sum(block) == axes]
        size = len(old) // len(of_axes)
        rows: _Line = ()
        for k, block in enumerate(of_axes):
            rows += (*old[k * size + 1 : (k + 1) * size], middles[block])
        shifted.append(rows)
    return reached, leave, rest, tuple(shifted)
