"""The fleet's parameters in one flat array, as kernels read them."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from angler_kernels import lanes
from angler_kernels.lanes.planes import cast_element, is_table
from angler_mjx.robot.control.stack import ControlParams
from angler_mjx.sim.fleet import Fleet, VehicleGroup


@dataclass(frozen=True, kw_only=True)
class ConstantBank:
    """Where each parameter lies: all elements of a variant together, variants one after another."""

    tree: jax.tree_util.PyTreeDef
    shapes: tuple[tuple[int, ...], ...]
    dtypes: tuple[DTypeLike, ...]
    firsts: tuple[int, ...]

    @classmethod
    def of(cls, fleet: Fleet, dtype: DTypeLike) -> tuple["ConstantBank", jax.Array]:
        """The places, and the flat array."""
        leaves, tree = jax.tree.flatten(fleet.control)
        sizes = [leaf.size for leaf in leaves]
        bank = cls(
            tree=tree,
            shapes=tuple(leaf.shape[1:] for leaf in leaves),
            dtypes=tuple(np.dtype(leaf.dtype) for leaf in leaves),
            firsts=tuple(np.cumsum([0, *sizes[:-1]]).tolist()),
        )
        return bank, jnp.concatenate([leaf.reshape(-1).astype(dtype) for leaf in leaves])

    def read_lanes(
        self, load: lanes.LoadFunction, group: VehicleGroup, variant: jax.Array
    ) -> ControlParams:
        """Parameters of lanes of robots of a group, by their variants.

        What all variants of the group share is a number of the program, not read at all.
        """
        out: list[lanes.Elements] = []
        for shape, dtype, first, letters, shared in zip(
            self.shapes, self.dtypes, self.firsts, group.sameness, group.shared, strict=True
        ):
            size = len(letters)
            if is_table(shape):
                base = first + (variant if "v" in letters else group.variant) * np.int32(size)
                out.append(lanes.LookupTable(load, shape, dtype, base=base))
                continue
            row: list[lanes.LaneValue] = [
                cast_element(load(first + variant * size + k), dtype)
                if letter == "v"
                else np.asarray(shared[k], dtype).ravel()[0]
                for k, letter in enumerate(letters)
            ]
            out.append(lanes.pack(row, shape))
        params: ControlParams = jax.tree.unflatten(self.tree, out)
        return params
