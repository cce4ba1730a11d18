"""Large array of one body that stays in memory, for `apply`."""

import math
from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

type LaneValue = jax.Array | np.number | np.bool_
"""An element of all bodies, or a number that is the same for all."""

type MemoryIndex = jax.Array | np.integer | int
"""Index in a flat array, of each lane or one for all."""

type LoadFunction = Callable[[MemoryIndex], jax.Array]
"""Loads values at indices of a flat array."""


class LookupTable:
    """Array [n, ...] of each body, read an entry at a time.

    Attributes:
        shape: of one body's array.
        dtype: of its entries.
    """

    def __init__(
        self,
        load: LoadFunction,
        shape: tuple[int, ...],
        dtype: DTypeLike,
        *,
        base: MemoryIndex = 0,
        step: int = 1,
    ) -> None:
        """Set the position of the entries.

        Args:
            load: loads values at memory indices, lanes of whole numbers or one for all.
            shape: of one body's array.
            dtype: of its entries.
            base: lanes, index of each body's first entry.
            step: distance from one entry to the next, in row-major order of ``shape``.
        """
        self.shape = shape
        self.dtype = np.dtype(dtype)
        self._load = load
        self._base = base
        self._step = step

    def where(self, condition: jax.Array, other: "LookupTable") -> "LookupTable":
        """Return this table for lanes where a condition holds, another of same array for others."""
        base = jnp.where(condition, self._base, other._base)
        return LookupTable(self._load, self.shape, self.dtype, base=base, step=self._step)

    def take(self, index: Sequence[LaneValue | int]) -> jax.Array:
        """Return the entry at ``index``, one number or lanes of them for each axis."""
        offset: MemoryIndex = 0
        for axis, at in enumerate(index):
            stride = self._step * math.prod(self.shape[axis + 1 :])
            constant = isinstance(at, int | np.integer)
            offset = offset + (int(at) * stride if constant else at * np.int32(stride))
        return self._load(self._base + offset)

    def read_all(self) -> np.ndarray:
        """Return all entries, as an object array of lanes."""
        out = np.empty(self.shape, object)
        for index in np.ndindex(*self.shape):
            out[index] = self.take(index)
        return out

    def __getitem__(self, window: tuple[slice, ...]) -> np.ndarray:
        """Return the entries at constant indices."""
        indices = np.indices(self.shape)[(slice(None), *window)]
        out = np.empty(indices.shape[1:], object)
        for index in np.ndindex(*out.shape):
            out[index] = self.take([int(axis[index]) for axis in indices])
        return out
