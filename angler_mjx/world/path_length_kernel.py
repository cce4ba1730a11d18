"""The shortest paths of `difficulty` as one GPU kernel: a program per pair of cells.

The sweeps and the test whether a pair is settled are the same, so the lengths are equal to the last
bit, since all of them are whole numbers. A program's lanes are the cells of one layer of its grid.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp

from angler_kernels.programs import BlockProgram

type _Move = tuple[int, ...]

_MOVES: tuple[_Move, ...] = tuple(m for m in itertools.product((-1, 0, 1), repeat=3) if any(m))
_LAYERS = tuple((a, *(b for b in range(3) if b != a)) for a in range(3))
"""Axis of a sweep, and the two axes of its layers."""


@dataclass(frozen=True, kw_only=True)
class Lengths:
    """Units of lengths."""

    of_axes: tuple[int, int, int]
    """Lengths of moves over 1, 2, 3 axes."""
    none: int
    """Length without a path."""
    strides: tuple[int, int, int]
    """Stride from a move's bit to that of the next move along each axis; the middle bit is no
    move."""


def shortest_length(
    moves: jax.Array,
    start: jax.Array,
    goal: jax.Array,
    lengths: Lengths,
    *,
    interpret: bool = False,
) -> jax.Array:
    """Return the shortest path length between two cells, int32 []; ``lengths.none`` where none is.

    Args:
        moves: uint32 [nx, ny, nz] moves that may end in each cell.
        start: int32 [3] cell.
        goal: int32 [3] cell, assumed free.
        lengths: static.
        interpret: run as ordinary JAX, on any device.
    """
    kernel = _PathLengthKernel.of(moves.shape, lengths, interpret)
    length, _ = kernel.program.run(
        kernel,
        [jnp.concatenate([start, goal]).astype(jnp.int32), moves.reshape(-1)],
        [
            jax.ShapeDtypeStruct((1,), jnp.int32),
            jax.ShapeDtypeStruct((kernel.total,), jnp.int32),
        ],
    )
    return length[0]


@dataclass(frozen=True)
class _PathLengthKernel:
    shape: tuple[int, ...]
    lengths: Lengths
    program: BlockProgram

    __name__ = "shortest_ways"

    @classmethod
    def of(cls, shape: tuple[int, ...], lengths: Lengths, interpret: bool) -> "_PathLengthKernel":
        return cls(shape, lengths, BlockProgram.of(lanes_needed(shape), interpret=interpret))

    @property
    def total(self) -> int:
        """Return the number of cells, padded at both ends of each axis."""
        return math.prod(n + 2 for n in self.shape)

    @property
    def wide(self) -> tuple[int, int, int]:
        """Return the strides of the padded cells."""
        _, ny, nz = self.shape
        return (ny + 2) * (nz + 2), nz + 2, 1

    @property
    def strides(self) -> tuple[int, int, int]:
        """Return the strides of the moves."""
        _, ny, nz = self.shape
        return ny * nz, nz, 1

    def __call__(self, ends: jax.Ref, moves: jax.Ref, length: jax.Ref, distance: jax.Ref) -> None:
        program, none = self.program, self.lengths.none
        lane = jnp.arange(program.lanes, dtype=jnp.int32)
        nowhere = jnp.full((program.lanes,), none, jnp.int32)

        def empty(k: jax.Array, unchanged: jax.Array) -> jax.Array:
            at = k * program.lanes + lane
            program.store(distance, at, nowhere, at < self.total)
            return unchanged

        jax.lax.fori_loop(0, -(-self.total // program.lanes), empty, jnp.int32(0))
        program.barrier()
        start, goal = ([ends[3 * end + axis] for axis in range(3)] for end in (0, 1))
        first = sum((c + 1) * s for c, s in zip(goal, self.wide, strict=True))
        distance[first] = jnp.int32(0)
        program.barrier()
        last = sum((c + 1) * s for c, s in zip(start, self.wide, strict=True))

        # No path is shorter than this: most pairs need a sweep or two.
        bound = self._free_length([jnp.abs(a - b) for a, b in zip(start, goal, strict=True)])

        def again(_: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            for axis, b, c in _LAYERS:
                sweeps = partial(self._sweep_axis, distance, moves, lane, axis, b, c)
                program.when(distance[last] > bound, sweeps)
            shortest = distance[last]
            more = jax.lax.cond(
                shortest > bound,
                lambda: self._can_improve(distance, moves, lane, start, shortest),
                lambda: jnp.int32(0),
            )
            return shortest, more

        shortest, _ = jax.lax.while_loop(
            lambda state: state[1] > 0, again, (jnp.int32(none), jnp.int32(1))
        )
        length[0] = shortest

    def _sweep_axis(
        self, distance: jax.Ref, moves: jax.Ref, lane: jax.Array, axis: int, b: int, c: int
    ) -> None:
        """Sweep to either side of an axis, layer by layer."""
        n = self.shape[axis]
        real = lane < self.shape[b] * self.shape[c]
        i, j = jnp.where(real, lane // self.shape[c], 0), jnp.where(real, lane % self.shape[c], 0)
        wide, near = self.wide, self.strides
        in_layer = (i + 1) * wide[b] + (j + 1) * wide[c]
        of_moves = i * near[b] + j * near[c]
        for side in (1, -1):
            which = [move for move in _MOVES if move[axis] == side]
            begin = 0 if side == 1 else n - 1

            def advance(
                k: jax.Array,
                unchanged: jax.Array,
                side: int = side,
                begin: int = begin,
                which: Sequence[_Move] = which,
            ) -> jax.Array:
                layer = begin + side * k
                at = (layer + 1) * wide[axis] + in_layer
                may = self.program.load(moves, layer * near[axis] + of_moves, real, 0)
                before = self.program.load(distance, at, real, self.lengths.none)
                new = jnp.minimum(before, self._relax_moves(distance, at, may, real, which))
                self.program.store(distance, at, new, real)
                self.program.barrier()
                return unchanged

            jax.lax.fori_loop(1, n, advance, jnp.int32(0))

    def _relax_moves(
        self,
        distance: jax.Ref,
        at: jax.Array,
        may: jax.Array,
        real: jax.Array,
        which: Sequence[_Move],
    ) -> jax.Array:
        """Return the min path length to each cell over paths that end with one of some moves."""
        none = jnp.int32(self.lengths.none)
        best: jax.Array = none
        for count, cost in enumerate(self.lengths.of_axes, start=1):
            nearest: jax.Array = none
            for move in which:
                if sum(map(abs, move)) != count:
                    continue
                came = sum(m * s for m, s in zip(move, self.wide, strict=True))
                source = self.program.load(distance, at - came, real, none)
                bit = sum((m + 1) * s for m, s in zip(move, self.lengths.strides, strict=True))
                allowed = (may & jnp.uint32(1 << bit)) != 0
                nearest = jnp.minimum(nearest, jnp.where(allowed, source, none))
            best = jnp.minimum(best, nearest + cost)
        return best

    def _free_length(self, apart: list[jax.Array]) -> jax.Array:
        """Return the shortest path length between cells, by their offsets along each axis."""
        one, two, three = self.lengths.of_axes
        shortest = jnp.minimum(jnp.minimum(apart[0], apart[1]), apart[2])
        longest = jnp.maximum(jnp.maximum(apart[0], apart[1]), apart[2])
        middle = apart[0] + apart[1] + apart[2] - shortest - longest
        return three * shortest + two * (middle - shortest) + one * (longest - middle)

    def _can_improve(
        self,
        distance: jax.Ref,
        moves: jax.Ref,
        lane: jax.Array,
        start: Sequence[jax.Array],
        shortest: jax.Array,
    ) -> jax.Array:
        """Return whether a path through any improvable cell could be shorter; int32 []."""
        nx, ny, nz = self.shape
        real = lane < ny * nz
        j, k = jnp.where(real, lane // nz, 0), jnp.where(real, lane % nz, 0)
        across = jnp.abs(j - start[1]), jnp.abs(k - start[2])
        in_layer = (j + 1) * self.wide[1] + (k + 1) * self.wide[2]

        def look(i: jax.Array, seen: jax.Array) -> jax.Array:
            at = (i + 1) * self.wide[0] + in_layer
            may = self.program.load(moves, i * self.strides[0] + lane, real, 0)
            current = self.program.load(distance, at, real, self.lengths.none)
            relaxed = self._relax_moves(distance, at, may, real, _MOVES)
            ahead = self._free_length([jnp.abs(i - start[0]), *across])
            better = real & (relaxed < current) & (relaxed + ahead < shortest)
            return jnp.maximum(seen, better.astype(jnp.int32))

        seen = jax.lax.fori_loop(0, nx, look, jnp.zeros((self.program.lanes,), jnp.int32))
        self.program.barrier()
        return jnp.max(seen)


def lanes_needed(shape: tuple[int, ...]) -> int:
    """Return the number of cells of the largest layer of a grid."""
    nx, ny, nz = shape
    return max(nx * ny, ny * nz, nx * nz)
