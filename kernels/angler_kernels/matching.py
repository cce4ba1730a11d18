"""Pairs of rows and columns, shortest first."""

from dataclasses import dataclass
from typing import Any, Self

import jax
import jax.numpy as jnp

from angler_kernels.programs import BlockProgram, on_gpu

_LANES_A_WARP = 1024
"""32 for each thread: nothing is read in the loop, so that registers are all that counts."""
MOST_LANES = 16 * _LANES_A_WARP
"""Of a program: one for each pair."""


def matched(way: jax.Array) -> jax.Array:
    """Pairs of rows and columns, each in one at most: the shortest of all, then of those left.

    Args:
        way: [r, m] lengths; inf for what is no pair.

    Returns:
        The column of each row, int32 [r]; -1 for none. Of equally long pairs that of the lower row
        comes first, then that of the lower column.
    """
    kernel = _Kernel(MatchedPairs.of(way.shape, lanes_a_warp=_LANES_A_WARP))
    if on_gpu() and kernel.pairs.program.lanes <= MOST_LANES:
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
class MatchedPairs:
    """A program with a lane for each pair, for kernels that work lengths out themselves."""

    rows: int
    columns: int
    wide: int
    """Columns, and as many more as make a power of two."""
    program: BlockProgram

    @classmethod
    def of(cls, shape: tuple[int, ...], *, lanes_a_warp: int, interpret: bool = False) -> Self:
        """Of rows and columns."""
        rows, columns = shape
        wide = 1 << (columns - 1).bit_length()
        program = BlockProgram.of(rows * wide, lanes_a_warp=lanes_a_warp, interpret=interpret)
        return cls(rows, columns, wide, program)

    @property
    def lane(self) -> Any:
        """Numbers of the lanes."""
        return jnp.arange(self.program.lanes, dtype=jnp.int32)

    @property
    def places(self) -> tuple[Any, Any, Any]:
        """Row and column of each lane, and whether there is such a pair."""
        row, column = self.lane // self.wide, self.lane % self.wide
        return row, column, (row < self.rows) & (column < self.columns)

    def clear(self, taken: Any) -> None:
        """Write that no row has a column."""
        none = jnp.full((self.program.lanes,), -1, jnp.int32)
        self.program.store(taken, self.lane, none, self.lane < self.rows)
        self.program.barrier()

    def take(self, way: Any, taken: Any) -> None:
        """Write the column of each row that gets one.

        Args:
            way: of each lane; inf for what is no pair.
            taken: [r] cleared before.
        """
        lane, (row, column, _) = self.lane, self.places

        def next_(state: tuple[Any, Any]) -> tuple[Any, Any]:
            way, least = state
            first = jnp.min(jnp.where(way == least, lane, self.program.lanes))
            taken[first // self.wide] = first % self.wide
            gone = (row == first // self.wide) | (column == first % self.wide)
            way = jnp.where(gone, jnp.inf, way)
            return way, jnp.min(way)

        jax.lax.while_loop(lambda state: state[1] < jnp.inf, next_, (way, jnp.min(way)))


@dataclass(frozen=True)
class _Kernel:
    pairs: MatchedPairs

    __name__ = "matched"

    def run(self, way: jax.Array) -> jax.Array:
        """The column of each row."""
        out = jax.ShapeDtypeStruct((self.pairs.rows,), jnp.int32)
        (taken,) = self.pairs.program.run(self, [way.reshape(-1)], [out])
        return taken

    def __call__(self, lengths: Any, taken: Any) -> None:
        pairs = self.pairs
        row, column, real = pairs.places
        at = jnp.where(real, row * pairs.columns + column, 0)
        pairs.clear(taken)
        pairs.take(pairs.program.load(lengths, at, real, jnp.inf), taken)
