"""Trees as a few flat arrays: a compiled call takes microseconds per array, in and out."""

import math
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

type Arrays = tuple[jax.Array, ...]


@dataclass(frozen=True, kw_only=True)
class FlatLayout:
    """Layout of a tree's leaves in one array for each type of number."""

    tree: Any
    shapes: tuple[tuple[int, ...], ...]
    dtypes: tuple[np.dtype[Any], ...]

    @classmethod
    def from_tree(cls, tree: Any) -> "FlatLayout":
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

    def pack(self, tree: Any) -> Arrays:
        """Return the arrays of a traced tree, one for each type."""
        arrays: Arrays = self._concatenate_leaves(tree, jnp)
        return arrays

    def pack_on_device(self, tree: Any) -> Arrays:
        """Return the arrays of a tree that is not traced; nothing is compiled."""
        arrays: Arrays = jax.device_put(self._concatenate_leaves(tree, np))
        return arrays

    def unpack(self, arrays: tuple[Any, ...]) -> Any:
        """Invert `pack`; the leaves are traced, or NumPy's, as the arrays are."""
        leaves: list[Any] = [None] * len(self.shapes)
        for array, members in zip(arrays, self._group_by_dtype().values(), strict=True):
            offset = 0
            for i in members:
                size = math.prod(self.shapes[i])
                leaves[i] = array[offset : offset + size].reshape(self.shapes[i])
                offset += size
        return jax.tree.unflatten(self.tree, leaves)

    def _concatenate_leaves(self, tree: Any, xp: Any) -> Any:
        leaves = jax.tree.leaves(tree)
        return tuple(
            xp.concatenate([xp.ravel(leaves[i]) for i in members])
            for members in self._group_by_dtype().values()
        )

    def _group_by_dtype(self) -> dict[np.dtype[Any], list[int]]:
        members: dict[np.dtype[Any], list[int]] = {}
        for i, dtype in enumerate(self.dtypes):
            members.setdefault(dtype, []).append(i)
        return members
