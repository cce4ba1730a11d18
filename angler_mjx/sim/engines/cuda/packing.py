"""Trees of arrays as planes of lanes, by one kernel, where XLA would take one for each leaf.

The way back is XLA's: lanes that write leaves store to memory far apart, which took 45 us for 8,192
worlds of `reef_fleet` on an H200, XLA's 14 kernels 30.
"""

from collections.abc import Sequence
from typing import Any

import jax
from jax.typing import DTypeLike

from angler_kernels.lanes.planes import LeafLayout, PlaneLayout
from angler_mjx.sim.engines.cuda import launch

MAX_PLANES = 128
"""Maximum number of planes of a tree; larger ones, with tables, are laid out by XLA."""

type Layouts = Sequence[PlaneLayout[Any]]
"""Layouts of trees of arrays [W, R, ...] with the same worlds and rows."""


def pack_trees(
    shape: launch.LaunchShape | None, layouts: Layouts, trees: Sequence[Any], dtype: DTypeLike
) -> list[jax.Array]:
    """Pack trees of arrays [W, R, ...] into flat arrays, as `PlaneLayout.pack`.

    Args:
        shape: threads of the kernel; None to have it done by XLA.
        layouts: of the trees.
        trees: arrays.
        dtype: type of the flat arrays.

    Returns:
        A flat array for each tree.
    """
    if shape is None or not all(map(fits_kernel, layouts)):
        return [layout.pack(tree, dtype) for layout, tree in zip(layouts, trees, strict=True)]
    leaves = [leaf for tree in trees for leaf in jax.tree.leaves(tree)]
    worlds, rows = leaves[0].shape[:2]

    def kernel(world: jax.Array, row: jax.Array, *refs: jax.Ref) -> None:
        sources, flats = refs[: len(leaves)], refs[len(leaves) :]
        lane = row * worlds + world
        for (number, layout, leaf), source in zip(_list_leaves(layouts), sources, strict=True):
            for k in range(leaf.size):
                value = source[(world * rows + row) * leaf.size + k].astype(dtype)
                flats[number][(leaf.first + k) * layout.lanes + lane] = value

    changed = [jax.lax.empty((layout.size,), dtype) for layout in layouts]
    flat = [leaf.reshape(-1) for leaf in leaves]
    return list(launch.call_kernel(kernel, shape, worlds, rows, flat, changed))


def fits_kernel(layout: PlaneLayout[Any]) -> bool:
    """Return whether the leaves of a tree can be written one by one in a kernel."""
    return layout.planes <= MAX_PLANES and all(leaf.size > 0 for leaf in layout.leaves)


def _list_leaves(layouts: Layouts) -> list[tuple[int, PlaneLayout[Any], LeafLayout]]:
    """Return number and layout of its tree for each leaf."""
    return [
        (number, layout, leaf) for number, layout in enumerate(layouts) for leaf in layout.leaves
    ]
