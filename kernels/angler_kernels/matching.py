"""Pairs of rows and columns, shortest first."""

from dataclasses import dataclass
from typing import Self

import jax
import jax.numpy as jnp

from angler_kernels.programs import BlockProgram, use_kernels

_LANES_PER_WARP = 1024
"""Lanes for each warp, 32 for each thread: nothing is read in the loop, so only registers count."""
MAX_LANES = 16 * _LANES_PER_WARP
"""Maximum number of lanes of a program: one for each pair."""


def match_pairs(lengths: jax.Array) -> jax.Array:
    """Match rows with columns, each once at most: the shortest pair of all, then of remaining ones.

    Args:
        lengths: [r, m] lengths; inf where there is no pair.

    Returns:
        Column of each row, int32 [r]; -1 for none. Of equally long pairs that of the lower row
        comes first, then that of the lower column.
    """
    kernel = _ShortestMatchingKernel(MatchedPairs.of(lengths.shape, lanes_per_warp=_LANES_PER_WARP))
    if use_kernels() and kernel.pairs.program.lanes <= MAX_LANES:
        return kernel.run(lengths)
    return _match_sequentially(lengths)


def _match_sequentially(lengths: jax.Array) -> jax.Array:
    """Match rows with columns one after the other, as `match_pairs`."""
    rows, columns = lengths.shape
    row, column = jnp.arange(rows), jnp.arange(columns, dtype=jnp.int32)

    def has_pairs(state: tuple[jax.Array, jax.Array, jax.Array]) -> jax.Array:
        return jnp.any(state[1] < jnp.inf)

    def match_shortest(
        state: tuple[jax.Array, jax.Array, jax.Array],
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        taken, min_lengths, lengths = state
        first = jnp.argmin(min_lengths)
        # By the least number of a column: the index of a minimum costs more than the minimum.
        matched_column = jnp.min(jnp.where(lengths[first] == min_lengths[first], column, columns))
        is_matched = (row == first) & (min_lengths[first] < jnp.inf)
        lengths = jnp.where(is_matched[:, None] | (column == matched_column), jnp.inf, lengths)
        return jnp.where(is_matched, matched_column, taken), jnp.min(lengths, axis=1), lengths

    start = jnp.full(rows, -1, jnp.int32), jnp.min(lengths, axis=1), lengths
    return jax.lax.while_loop(has_pairs, match_shortest, start)[0]


@dataclass(frozen=True)
class MatchedPairs:
    """Program with a lane for each pair, for kernels that compute the lengths themselves."""

    rows: int
    columns: int
    padded_columns: int
    """Number of columns, padded to a power of two."""
    program: BlockProgram

    @classmethod
    def of(cls, shape: tuple[int, ...], *, lanes_per_warp: int, interpret: bool = False) -> Self:
        """Build the program for rows and columns."""
        rows, columns = shape
        padded_columns = 1 << (columns - 1).bit_length()
        program = BlockProgram.of(
            rows * padded_columns, lanes_per_warp=lanes_per_warp, interpret=interpret
        )
        return cls(rows, columns, padded_columns, program)

    @property
    def lane(self) -> jax.Array:
        """Return the numbers of the lanes."""
        return jnp.arange(self.program.lanes, dtype=jnp.int32)

    @property
    def lane_pairs(self) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Return row and column of each lane, and whether the pair exists."""
        row, column = self.lane // self.padded_columns, self.lane % self.padded_columns
        return row, column, (row < self.rows) & (column < self.columns)

    def clear_matches(self, taken: jax.Ref) -> None:
        """Clear the columns of all rows."""
        none = jnp.full((self.program.lanes,), -1, jnp.int32)
        self.program.store(taken, self.lane, none, self.lane < self.rows)
        self.program.barrier()

    def write_matches(self, lengths: jax.Array, taken: jax.Ref) -> None:
        """Write the column of each row that gets one.

        Args:
            lengths: length of each lane's pair; inf where there is no pair.
            taken: [r] cleared before.
        """
        lane, (row, column, _) = self.lane, self.lane_pairs

        def match_next(state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            lengths, min_length = state
            first = jnp.min(jnp.where(lengths == min_length, lane, self.program.lanes))
            taken[first // self.padded_columns] = first % self.padded_columns
            is_taken = (row == first // self.padded_columns) | (
                column == first % self.padded_columns
            )
            lengths = jnp.where(is_taken, jnp.inf, lengths)
            return lengths, jnp.min(lengths)

        jax.lax.while_loop(
            lambda state: state[1] < jnp.inf, match_next, (lengths, jnp.min(lengths))
        )


@dataclass(frozen=True)
class _ShortestMatchingKernel:
    pairs: MatchedPairs

    __name__ = "matched"

    def run(self, lengths: jax.Array) -> jax.Array:
        """Return the column of each row."""
        out = jax.ShapeDtypeStruct((self.pairs.rows,), jnp.int32)
        (taken,) = self.pairs.program.run(self, [lengths.reshape(-1)], [out])
        return taken

    def __call__(self, lengths: jax.Ref, taken: jax.Ref) -> None:
        pairs = self.pairs
        row, column, is_pair = pairs.lane_pairs
        at = jnp.where(is_pair, row * pairs.columns + column, 0)
        pairs.clear_matches(taken)
        pairs.write_matches(pairs.program.load(lengths, at, is_pair, jnp.inf), taken)
