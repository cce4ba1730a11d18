"""Trees of per-body arrays in one flat array, a plane of lanes for every element.

Element k of lane n has the index ``k * lanes + n``: programs that work on neighbouring lanes read
neighbouring elements.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from angler_kernels import lanes
from angler_kernels.lanes.table import LoadFunction, MemoryIndex
from angler_kernels.lanes.trees import Elements

TABLE_MIN_ROWS = 16
"""Arrays of one body with more rows than this stay in memory and are read by the entry."""
TABLE_MIN_COLUMNS = 64
"""And so do arrays with two axes and more columns than this: a table for each of some parts."""

type StoreFunction = Callable[[jax.Array, jax.Array], None]
"""Stores values at indices of a flat array."""


def is_table(tail: tuple[int, ...]) -> bool:
    """Return whether an array [...] of one body is read from memory by the entry."""
    is_wide = len(tail) == 2 and tail[1] > TABLE_MIN_COLUMNS
    return len(tail) > 0 and (tail[0] > TABLE_MIN_ROWS or is_wide)


@dataclass(frozen=True, kw_only=True)
class LeafLayout:
    """Position of one leaf of a tree."""

    first: int
    """Number of its first plane."""
    shape: tuple[int, ...]
    dtype: np.dtype

    @property
    def size(self) -> int:
        """Return the number of its planes."""
        return math.prod(self.shape)


@dataclass(frozen=True, kw_only=True)
class PlaneLayout[T]:
    """Positions of the leaves of a tree."""

    tree: jax.tree_util.PyTreeDef
    leaves: tuple[LeafLayout, ...]
    lanes: int

    @staticmethod
    def of[S](tree: S, lead: int) -> "PlaneLayout[S]":
        """Build the layout of arrays [W, (n,) ...] with ``lead`` axes of lanes, or of shapes."""
        flat, structure = jax.tree.flatten(tree)
        leaves, first = [], 0
        for leaf in flat:
            leaves.append(
                LeafLayout(first=first, shape=leaf.shape[lead:], dtype=np.dtype(leaf.dtype))
            )
            first += leaves[-1].size
        count = math.prod(flat[0].shape[:lead])
        return PlaneLayout(tree=structure, leaves=tuple(leaves), lanes=count)

    @property
    def planes(self) -> int:
        """Return the number of planes of the whole tree."""
        return sum(leaf.size for leaf in self.leaves)

    @property
    def size(self) -> int:
        """Return the number of elements."""
        return self.planes * self.lanes

    def pack(self, tree: object, dtype: DTypeLike) -> jax.Array:
        """Pack arrays [W, (n,) ...] into one flat array [planes * lanes].

        Whole numbers must be small.
        """
        rows = []
        for leaf, value in zip(self.leaves, jax.tree.leaves(tree), strict=True):
            lead = value.ndim - len(leaf.shape)
            worlds_last = jnp.swapaxes(value, 0, lead - 1)
            rows.append(worlds_last.reshape(self.lanes, leaf.size).T.astype(dtype))
        return jnp.concatenate(rows).reshape(-1)

    def unpack(self, flat: jax.Array, lead: tuple[int, ...]) -> T:
        """Return the arrays of a flat array: the inverse of `pack`.

        Args:
            flat: [..., planes * lanes].
            lead: sizes of the axes of lanes, worlds first.

        Returns:
            Arrays [W, ..., (n,) ...].
        """
        front = flat.shape[:-1]
        planes = flat.reshape(*front, self.planes, *reversed(lead))
        out = []
        for leaf in self.leaves:
            part = planes[..., leaf.first : leaf.first + leaf.size, *(slice(None),) * len(lead)]
            part = jnp.moveaxis(part, len(front), -1)  # [..., (n,) W, planes]
            part = jnp.moveaxis(part, part.ndim - 2, 0)
            out.append(part.reshape(*part.shape[:-1], *leaf.shape).astype(leaf.dtype))
        tree: T = jax.tree.unflatten(self.tree, out)
        return tree

    def read_lanes(self, load: LoadFunction, lane: jax.Array) -> T:
        """Read the tree of lanes number ``lane``; long arrays as tables."""
        return self.read_part(load, lane, lambda tree: tree)

    def read_part[P](self, load: LoadFunction, lane: jax.Array, only: Callable[[T], P]) -> P:
        """Read a part of the tree of lanes number ``lane``; long arrays as tables."""
        selected = only(jax.tree.unflatten(self.tree, self.leaves))
        part: P = jax.tree.map(lambda leaf: self._read_leaf(leaf, load, lane), selected)
        return part

    def _read_leaf(self, leaf: LeafLayout, load: LoadFunction, lane: jax.Array) -> Elements:
        start = leaf.first * self.lanes
        if is_table(leaf.shape):

            def entry(at: MemoryIndex) -> jax.Array:
                return cast_element(load(at), leaf.dtype)

            return lanes.LookupTable(
                entry, leaf.shape, leaf.dtype, base=start + lane, step=self.lanes
            )
        rows = [
            cast_element(load(start + k * self.lanes + lane), leaf.dtype) for k in range(leaf.size)
        ]
        return lanes.pack(rows, leaf.shape)

    def write_lanes(self, store: StoreFunction, lane: jax.Array, tree: object) -> None:
        """Store a tree of lanes."""
        for leaf, value in zip(self.leaves, jax.tree.leaves(tree), strict=True):
            for k, x in enumerate(value.ravel()):
                store((leaf.first + k) * self.lanes + lane, x)


@dataclass(frozen=True, kw_only=True)
class SampleBuffer[T]:
    """Samples of a tree in one flat array: for each leaf [samples, rows, elements, worlds].

    Every leaf is one block, so that a plain transposition gives its array.
    """

    layout: PlaneLayout[T]
    """Layout of one sample."""
    samples: int
    rows: int
    worlds: int

    @property
    def size(self) -> int:
        """Return the number of elements of all samples."""
        return self.samples * self.layout.planes * self.rows * self.worlds

    def write_lanes(
        self,
        store: StoreFunction,
        sample: jax.Array,
        row: jax.Array,
        world: jax.Array,
        tree: object,
    ) -> None:
        """Store lanes of one row as a sample."""
        for leaf, value in zip(self.layout.leaves, jax.tree.leaves(tree), strict=True):
            block = leaf.first * self.samples * self.rows * self.worlds
            first = (sample * self.rows + row) * leaf.size
            for k, x in enumerate(value.ravel()):
                store(block + (first + k) * self.worlds + world, x)

    def unpack(self, flat: jax.Array) -> T:
        """Return arrays [worlds, samples, rows, ...]."""
        leaf_stride = self.samples * self.rows * self.worlds
        out = []
        for leaf in self.layout.leaves:
            block = flat[leaf.first * leaf_stride : (leaf.first + leaf.size) * leaf_stride]
            by_world = block.reshape(-1, self.worlds).T
            shape = (self.worlds, self.samples, self.rows, *leaf.shape)
            out.append(by_world.reshape(shape).astype(leaf.dtype))
        tree: T = jax.tree.unflatten(self.layout.tree, out)
        return tree


def cast_element(value: jax.Array, dtype: DTypeLike) -> jax.Array:
    """Cast a number read from an array of floats to its own type."""
    if value.dtype == dtype:
        return value
    return value != 0 if dtype == np.bool_ else value.astype(dtype)
