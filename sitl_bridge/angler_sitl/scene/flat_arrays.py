"""Trees as a few flat arrays: a compiled call takes microseconds per array, in and out."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

type Arrays = tuple[jax.Array, ...]


@dataclass(frozen=True, kw_only=True)
class FlatLayout[T]:
    """Layout of a tree's leaves in one array for each type of number."""

    tree: jax.tree_util.PyTreeDef
    shapes: tuple[tuple[int, ...], ...]
    dtypes: tuple[np.dtype, ...]

    @classmethod
    def from_tree(cls, tree: T) -> "FlatLayout[T]":
        """Return the layout of trees like this one, with JAX's default types."""
        leaves, structure = jax.tree.flatten(tree)
        return cls(
            tree=structure,
            shapes=tuple(np.shape(leaf) for leaf in leaves),
            dtypes=tuple(np.dtype(jnp.result_type(leaf)) for leaf in leaves),
        )

    @property
    def array_specs(self) -> tuple[jax.ShapeDtypeStruct, ...]:
        """Shapes and types of the result of `pack`, for a compiler."""
        return tuple(
            jax.ShapeDtypeStruct((sum(math.prod(self.shapes[i]) for i in members),), dtype)
            for dtype, members in self._group_by_dtype().items()
        )

    def pack(self, tree: T) -> Arrays:
        """Return the arrays of a traced tree, one for each type."""
        return tuple(
            jnp.concatenate([jnp.ravel(leaf) for leaf in leaves])
            for leaves in self._group_leaves(tree)
        )

    def pack_on_device(self, tree: T) -> Arrays:
        """Return the arrays of a tree that is not traced; nothing is compiled."""
        arrays: Arrays = jax.device_put(
            tuple(
                np.concatenate([np.ravel(leaf) for leaf in leaves])
                for leaves in self._group_leaves(tree)
            )
        )
        return arrays

    def unpack(self, arrays: Sequence[jax.Array | np.ndarray]) -> T:
        """Invert `pack`; the leaves are traced, or NumPy's, as the arrays are."""
        leaves: dict[int, jax.Array | np.ndarray] = {}
        for array, members in zip(arrays, self._group_by_dtype().values(), strict=True):
            offset = 0
            for i in members:
                size = math.prod(self.shapes[i])
                leaves[i] = array[offset : offset + size].reshape(self.shapes[i])
                offset += size
        tree: T = jax.tree.unflatten(self.tree, [leaves[i] for i in range(len(self.shapes))])
        return tree

    def _group_leaves(self, tree: T) -> list[list[jax.Array]]:
        """Return the leaves of each type of number."""
        leaves = jax.tree.leaves(tree)
        return [[leaves[i] for i in members] for members in self._group_by_dtype().values()]

    def _group_by_dtype(self) -> dict[np.dtype, list[int]]:
        members: dict[np.dtype, list[int]] = {}
        for i, dtype in enumerate(self.dtypes):
            members.setdefault(dtype, []).append(i)
        return members
