"""Difficulty of a world: the length of the shortest path, and whether the straight line is free.

Paths go through centres of cells, to any of the 26 neighbours, without cutting corners: a diagonal
move needs all cells of the 2 x 2 or 2 x 2 x 2 block that it spans. Arrays hold many worlds, along
their last axis.
"""

import itertools
import math
from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp

from angler_kernels.bit_grid import shift_grid, unpack_grid
from angler_kernels.programs import MAX_LANES, use_kernels
from angler_mjx.world import groups, path_length_kernel

type Move = tuple[int, ...]
type _Settling = tuple[jax.Array, jax.Array, jax.Array]
"""Number of groups done, lengths [n_pair], and whether each is settled."""
type _SearchState = tuple[jax.Array, jax.Array, jax.Array, jax.Array]
"""Number of rounds, path lengths [nx, ny, nz, n] to a group's goals, lengths [n], and settled
flags."""
MOVES: tuple[Move, ...] = tuple(m for m in itertools.product((-1, 0, 1), repeat=3) if any(m))
_STRIDE = (9, 3, 1)
"""Stride from a move to the next along each axis, in bits of a word of moves."""
_EDGE = 1 << 18
"""Number of length units in a cell's edge. Lengths are whole numbers of units: sums are then exact
in any order, and so is the test whether a path can still be improved. The rounded square roots of 2
and 3 are within 1.1e-6 of the true values."""
_COST = {n_axis: round(_EDGE * math.sqrt(n_axis)) for n_axis in (1, 2, 3)}
_NO_PATH = 1 << 30
"""Length without a path: 4,096 edges, many times the longest path through any grid generated
here."""
LENGTHS = path_length_kernel.Lengths(
    of_axes=(_COST[1], _COST[2], _COST[3]), none=_NO_PATH, strides=_STRIDE
)
"""The same units for kernels."""
_GROUP_DIVISOR = 8
"""Number of groups into which all pairs are divided."""


def shortest_paths(passable: jax.Array, nz: int, start: jax.Array, goal: jax.Array) -> jax.Array:
    """Return shortest path lengths between pairs of cells, in cell edges; inf where none exists.

    Bellman's equation, relaxed layer by layer (fast sweeping): a single sweep along an axis updates
    every path that never turns back on that axis. A round is six sweeps, forth and back along each
    axis. A pair is settled when no cell can be improved enough to make a path through it, straight
    from there to the start, shorter; its length is then exact. One round settles most pairs. All
    pairs get one round, group by group; the remaining pairs form new groups, and each of these
    continues until it is settled. One loop does both, so the body is compiled once.

    Args:
        passable: packed cells, [nx, ny, words, n_world] (see `angler_kernels.bit_grid`).
        nz: cells along z.
        start: int32 [3, n, n_world] cells.
        goal: int32 [3, n, n_world] cells.

    Returns:
        [n, n_world].
    """
    nx, ny = passable.shape[:2]
    _, n, n_world = start.shape
    if use_kernels() and path_length_kernel.lanes_needed((nx, ny, nz)) <= MAX_LANES:
        return in_cells(by_kernel(passable, nz, start, goal))
    n_pair = n * n_world
    size = -(-n_pair // _GROUP_DIVISOR)
    moves, free = _moves_into(passable, nz), unpack_grid(passable, nz)
    index = jnp.arange(nx * ny * nz, dtype=jnp.int32).reshape(nx, ny, nz, 1)
    start, to_cell = start.reshape(3, n_pair), _flat_index(goal, (nx, ny, nz)).reshape(n_pair)

    def settle_group(carry: _Settling) -> _Settling:
        turn, length, settled = carry
        group = groups.choose_group(turn, ~settled, size)
        read, world = group.read, group.read % n_world
        theirs, their_start = moves[..., world], start[:, read]
        at_goal = (index == to_cell[read]) & free[..., world]
        to_the_end = groups.all_had_turn(turn, n_pair, size)

        def unsettled(state: _SearchState) -> jax.Array:
            return (state[0] == 0) | (~jnp.all(state[3]) & to_the_end)

        def go_on(state: _SearchState) -> _SearchState:
            # Tied to a loop variable, the moves stay bits: XLA would hoist each bit's test out of
            # the loop, as 26 grids to read instead of one.
            distance, moves = jax.lax.optimization_barrier((state[1], theirs))
            distance = _sweep_all(distance, moves)
            return state[0] + 1, distance, *_length_at_start(distance, moves, their_start)

        nowhere = jnp.full(at_goal.shape, _NO_PATH, jnp.int32)
        begin = (jnp.int32(0), jnp.where(at_goal, 0, nowhere), length[read], settled[read])
        _, _, new_length, done = jax.lax.while_loop(unsettled, go_on, begin)
        return (
            turn + 1,
            length.at[group.index].set(new_length, mode="drop"),
            settled.at[group.index].set(done, mode="drop"),
        )

    none = (jnp.int32(0), jnp.full(n_pair, _NO_PATH, jnp.int32), jnp.zeros(n_pair, bool))
    _, length, _ = jax.lax.while_loop(lambda carry: ~jnp.all(carry[2]), settle_group, none)
    return in_cells(length.reshape(n, n_world))


def by_kernel(
    passable: jax.Array,
    nz: int,
    start: jax.Array,
    goal: jax.Array,
    *,
    interpret: bool = False,
) -> jax.Array:
    """Return lengths int32 [n, n_world] as of `shortest_paths`, by a GPU program for each pair."""
    moves = jnp.moveaxis(_moves_into(passable, nz), -1, 0)
    at_goal = jnp.take_along_axis(
        unpack_grid(passable, nz).reshape(-1, passable.shape[-1]),
        _flat_index(goal, (*passable.shape[:2], nz)),
        axis=0,
    )

    def of_world(moves: jax.Array, starts: jax.Array, goals: jax.Array) -> jax.Array:
        return jax.vmap(
            lambda a, b: path_length_kernel.shortest_length(
                moves, a, b, LENGTHS, interpret=interpret
            ),
            in_axes=1,
        )(starts, goals)

    length = jax.vmap(of_world, in_axes=(0, 2, 2), out_axes=1)(moves, start, goal)
    return jnp.where(at_goal, length, _NO_PATH)


def in_cells(length: jax.Array) -> jax.Array:
    """Return lengths in cell edges; inf where no path exists."""
    edges = length.astype(float) / _EDGE
    return jnp.where(edges < _NO_PATH // _EDGE, edges, jnp.inf)


def open_path_lengths(passable: jax.Array, nz: int, start: jax.Array, goal: jax.Array) -> jax.Array:
    """Return lengths as `shortest_paths` does, for a box of passable cells: without a search.

    A path within the box that its two ends span is a shortest path.
    """
    flat = unpack_grid(passable, nz).reshape(-1, passable.shape[-1])
    shape = (*passable.shape[:2], nz)
    in_box = [jnp.take_along_axis(flat, _flat_index(cell, shape), axis=0) for cell in (start, goal)]
    length = _free_length([jnp.abs(a - b) for a, b in zip(start, goal, strict=True)])
    return jnp.where(in_box[0] & in_box[1], length.astype(float) / _EDGE, jnp.inf)


def _free_length(apart: Sequence[jax.Array]) -> jax.Array:
    """Return the shortest path length between cells, by their offsets along each axis."""
    shortest = jnp.minimum(jnp.minimum(apart[0], apart[1]), apart[2])
    longest = jnp.maximum(jnp.maximum(apart[0], apart[1]), apart[2])
    middle = apart[0] + apart[1] + apart[2] - shortest - longest
    longer, longest = middle - shortest, longest - middle
    return _COST[3] * shortest + _COST[2] * longer + _COST[1] * longest


def bit_of(move: Move) -> jax.Array:
    """Return the bit of a move in a word of moves: its index in a block of 3 x 3 x 3."""
    position = sum(stride * (k + 1) for stride, k in zip(_STRIDE, move, strict=True))
    bit: jax.Array = jnp.uint32(1 << position)
    return bit


def _moves_into(passable: jax.Array, nz: int) -> jax.Array:
    """Return the moves that may end in each cell: uint32 [nx, ny, nz, n_world], as of `bit_of`."""
    allowed = jnp.zeros((), jnp.uint32)
    blocks: dict[Move, jax.Array] = {(0, 0, 0): passable}
    # A block is that of one axis fewer, and the same shifted one cell back along the axis.
    for move in sorted(MOVES, key=lambda m: sum(map(abs, m))):
        axis = next(a for a in range(3) if move[a])
        fewer = blocks[tuple(0 if a == axis else move[a] for a in range(3))]
        blocks[move] = fewer & shift_grid(fewer, axis, move[axis], nz)
        allowed = allowed | jnp.where(unpack_grid(blocks[move], nz), bit_of(move), jnp.uint32(0))
    return allowed


def _sweep_all(distance: jax.Array, moves: jax.Array) -> jax.Array:
    """Return path lengths [nx, ny, nz, ...] after a sweep to either side of each axis."""
    for axis in range(3):
        distance = _sweep_axis(distance, moves, axis)
    return distance


def _length_at_start(
    distance: jax.Array, moves: jax.Array, start: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return the length [...] at each start [3, ...], and whether no relaxation can change it."""
    flat = _flat_index(start, distance.shape)
    length = jnp.take_along_axis(distance.reshape(-1, *flat.shape), flat[None], axis=0)[0]
    new = relax_moves(pad_axes(distance, (0, 1, 2)), distance.shape, moves, MOVES)
    # Fused with the reduction, the relaxation would not use a CPU's vectors.
    new = jax.lax.optimization_barrier(new)
    apart = [
        jnp.abs(jnp.arange(n).reshape([n if a == axis else 1 for a in range(distance.ndim)]) - cell)
        for axis, (n, cell) in enumerate(zip(distance.shape, start, strict=False))
    ]
    improved = (new < distance) & (new + _free_length(apart) < length)
    return length, ~jnp.any(improved, axis=(0, 1, 2))


def _flat_index(cell: jax.Array, shape: Sequence[int]) -> jax.Array:
    """Return the flat index of cells [3, ...] of a grid."""
    return (cell[0] * shape[1] + cell[1]) * shape[2] + cell[2]


def _sweep_axis(distance: jax.Array, moves: jax.Array, axis: int) -> jax.Array:
    """Return path lengths after a sweep to either side: layer by layer, each from the previous one.

    Args:
        distance: [nx, ny, nz, ...] lengths so far.
        moves: uint32 [nx, ny, nz, ...] (see `_moves_into`).
        axis: axis of the sweep.
    """
    n = distance.shape[axis]
    across = [a for a in range(3) if a != axis]
    back = [move for move in MOVES if move[axis] == -1]
    layer_of = partial(jax.lax.dynamic_index_in_dim, axis=axis)

    def sweep(turn: jax.Array, distance: jax.Array) -> jax.Array:
        # Both sides read the same cells of the previous layer: only the bits differ, by a shift.
        first, step = jnp.where(turn == 0, 0, n - 1), 1 - 2 * turn
        shift = jnp.where(turn == 0, 2 * _STRIDE[axis], 0).astype(jnp.uint32)

        def advance(
            k: jax.Array, carry: tuple[jax.Array, jax.Array]
        ) -> tuple[jax.Array, jax.Array]:
            before, distance = carry
            i = first + k * step
            may = layer_of(moves, i) >> shift
            new = relax_moves(pad_axes(before, across), before.shape, may, back)
            layer = jnp.minimum(layer_of(distance, i), new)
            return layer, jax.lax.dynamic_update_index_in_dim(distance, layer, i, axis)

        swept: jax.Array = jax.lax.fori_loop(1, n, advance, (layer_of(distance, first), distance))[
            1
        ]
        return swept

    both: jax.Array = jax.lax.fori_loop(0, 2, sweep, distance)
    return both


def pad_axes(distance: jax.Array, axes: Sequence[int]) -> jax.Array:
    """Return path lengths padded with a cell without a path at both ends of some axes."""
    pad = [(1, 1) if axis in axes else (0, 0) for axis in range(distance.ndim)]
    return jnp.pad(distance, pad, constant_values=_NO_PATH)


def relax_moves(
    wide: jax.Array,
    shape: tuple[int, ...],
    moves: jax.Array,
    which: Sequence[Move],
) -> jax.Array:
    """Return the min path length to each cell over paths that end with one of some moves.

    Args:
        wide: path lengths at the origins of the moves, padded (see `pad_axes`) along some axes;
            along the others, the origins have the same index.
        shape: of the result.
        moves: uint32, moves that may end in each cell.
        which: moves to try.
    """
    nothing = jnp.int32(_NO_PATH)
    best: jax.Array = nothing
    for n_axis, cost in _COST.items():
        nearest = nothing
        for move in which:
            if sum(map(abs, move)) != n_axis:
                continue
            source = wide
            for axis in range(3):
                if wide.shape[axis] > shape[axis]:
                    start = 1 - move[axis]
                    source = jax.lax.slice_in_dim(source, start, start + shape[axis], axis=axis)
            nearest = jnp.minimum(nearest, jnp.where((moves & bit_of(move)) != 0, source, nothing))
        best = jnp.minimum(best, nearest + cost)
    return best


def line_is_free(occupied: jax.Array, start: jax.Array, goal: jax.Array) -> jax.Array:
    """Return whether the straight segment between two points meets no occupied cell; bool [...].

    Exact slab test against all cells; touching a cell's face, edge or corner does not count.

    Args:
        occupied: bool [nx, ny, nz, ...].
        start: [3, ...] in cell edges from the lower corner of the grid.
        goal: [3, ...], as ``start``.
    """
    enter, leave = jnp.zeros((), start.dtype), jnp.ones((), start.dtype)
    for axis, n in enumerate(occupied.shape[:3]):
        shape = [n if a == axis else 1 for a in range(3)] + [1] * (occupied.ndim - 3)
        lower = jnp.arange(n, dtype=start.dtype).reshape(shape)
        along = goal[axis] - start[axis]
        still = along == 0
        safe = jnp.where(still, 1.0, along)
        t0, t1 = (lower - start[axis]) / safe, (lower + 1 - start[axis]) / safe
        beside = still & ((start[axis] <= lower) | (start[axis] >= lower + 1))
        first = jnp.where(still, -jnp.inf, jnp.minimum(t0, t1))
        enter = jnp.maximum(enter, jnp.where(beside, jnp.inf, first))
        leave = jnp.minimum(leave, jnp.where(still, jnp.inf, jnp.maximum(t0, t1)))
    # Rounding of t is below 1e-6; a shorter interval in a cell counts as a touch.
    return ~jnp.any(occupied & (leave - enter > 1e-5), axis=(0, 1, 2))
