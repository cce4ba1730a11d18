"""Pairs of rows and columns, shortest first."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from angler_kernels.programs import Program, on_gpu

_LANES_A_WARP = 1024
"""32 for each thread: nothing is read in the loop, so that registers are all that counts."""
_MOST_LANES = 16 * _LANES_A_WARP
"""Of a program: one for each pair."""


def matched(way: jax.Array) -> jax.Array:
    """Pairs of rows and columns, each in one at most: the shortest of all, then of those left.

    Args:
        way: [r, m] lengths; inf for what is no pair.

    Returns:
        The column of each row, int32 [r]; -1 for none. Of equally long pairs that of the lower row
        comes first, then that of the lower column.
    """
    kernel = _Kernel.of(way.shape)
    if on_gpu() and kernel.program.lanes <= _MOST_LANES:
        return kernel.run(way)
    return _one_by_one(way)


def _one_by_one(way: jax.Array) -> jax.Array:
    """As `matched`."""
    rows, columns = way.shape
    row, column = jnp.arange(rows), jnp.arange(columns, dtype=jnp.int32)

    def going(state: tuple[jax.Array, jax.Array, jax.Array]) -> jax.Array:
        return jnp.any(state[1] < jnp.inf)

    def take(
        state: tuple[jax.Array, jax.Array, jax.Array],
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        taken, least, way = state
        first = jnp.argmin(least)
        # By the least number of a column: the place of a minimum is dearer than the minimum.
        mine = jnp.min(jnp.where(way[first] == least[first], column, columns))
        found = (row == first) & (least[first] < jnp.inf)
        way = jnp.where(found[:, None] | (column == mine), jnp.inf, way)
        return jnp.where(found, mine, taken), jnp.min(way, axis=1), way

    begin = jnp.full(rows, -1, jnp.int32), jnp.min(way, axis=1), way
    return jax.lax.while_loop(going, take, begin)[0]


@dataclass(frozen=True)
class _Kernel:
    rows: int
    columns: int
    wide: int
    """Columns, and as many more as make a power of two."""
    program: Program

    __name__ = "matched"

    @classmethod
    def of(cls, shape: tuple[int, ...], *, interpret: bool = False) -> "_Kernel":
        rows, columns = shape
        wide = 1 << (columns - 1).bit_length()
        program = Program.of(rows * wide, lanes_a_warp=_LANES_A_WARP, interpret=interpret)
        return cls(rows, columns, wide, program)

    def run(self, way: jax.Array) -> jax.Array:
        """The column of each row."""
        (taken,) = self.program.run(
            self, [way.reshape(-1)], [jax.ShapeDtypeStruct((self.rows,), jnp.int32)]
        )
        return taken

    def __call__(self, lengths: Any, taken: Any) -> None:
        program, inf = self.program, jnp.inf
        lane = jnp.arange(program.lanes, dtype=jnp.int32)
        row, column = lane // self.wide, lane % self.wide
        real = (row < self.rows) & (column < self.columns)
        at = jnp.where(real, row * self.columns + column, 0)
        program.store(taken, lane, jnp.full((program.lanes,), -1, jnp.int32), lane < self.rows)
        program.barrier()
        way = program.load(lengths, at, real, inf)

        def take(state: tuple[Any, Any]) -> tuple[Any, Any]:
            way, least = state
            first = jnp.min(jnp.where(way == least, lane, program.lanes))
            taken[first // self.wide] = first % self.wide
            gone = (row == first // self.wide) | (column == first % self.wide)
            way = jnp.where(gone, inf, way)
            return way, jnp.min(way)

        jax.lax.while_loop(lambda state: state[1] < inf, take, (way, jnp.min(way)))
