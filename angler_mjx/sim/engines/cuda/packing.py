"""Trees of arrays as planes of lanes and back, and states of worlds that begin anew, by kernels.

XLA takes a kernel for each leaf: a control step alone would take longer to lay out than to fly.
"""

import math
from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike

from angler_kernels.lanes.planes import LeafLayout, PlaneLayout, cast_element
from angler_mjx.sim.engines.cuda import launch
from angler_mjx.sim.state import WorldState
from angler_mjx.sim.state import replace_worlds as in_jax

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


def unpack_trees(
    shape: launch.LaunchShape | None,
    layouts: Layouts,
    flats: Sequence[jax.Array],
    lead: tuple[int, int],
) -> list[Any]:
    """Return the trees of flat arrays: the inverse of `pack_trees`.

    Args:
        shape: threads of the kernel; None to have it done by XLA.
        layouts: of the trees.
        flats: a flat array for each.
        lead: numbers of worlds and rows.
    """
    if shape is None or not all(map(fits_kernel, layouts)):
        return [layout.unpack(flat, lead) for layout, flat in zip(layouts, flats, strict=True)]
    worlds, rows = lead
    every = list(_list_leaves(layouts))

    def kernel(world: jax.Array, row: jax.Array, *refs: jax.Ref) -> None:
        flats, targets = refs[: len(layouts)], refs[len(layouts) :]
        lane = row * worlds + world
        for (number, layout, leaf), target in zip(every, targets, strict=True):
            for k in range(leaf.size):
                value = flats[number][(leaf.first + k) * layout.lanes + lane]
                target[(world * rows + row) * leaf.size + k] = cast_element(value, leaf.dtype)

    changed = [jax.lax.empty((worlds * rows * leaf.size,), leaf.dtype) for _, _, leaf in every]
    arrays = iter(launch.call_kernel(kernel, shape, worlds, rows, list(flats), changed))
    return [
        jax.tree.unflatten(
            layout.tree, [next(arrays).reshape(*lead, *leaf.shape) for leaf in layout.leaves]
        )
        for layout in layouts
    ]


def replace_worlds(
    shape: launch.LaunchShape | None,
    state: WorldState,
    ended: jax.Array,
    initial: WorldState,
    rows: jax.Array,
) -> WorldState:
    """Return states of which the ended ones begin anew, as `state.replace_worlds`.

    Args:
        shape: threads of the kernels; None to have it done by XLA.
        state: [W] leads.
        ended: bool [W].
        initial: states at t = 0, [B] leads.
        rows: int32 [W] whose of them.
    """
    if shape is None or len(ended) % shape.block:
        return in_jax(state, ended, initial, rows)
    leaves, structure = jax.tree.flatten(state)
    pairs = list(zip(leaves, jax.tree.leaves(initial), strict=True))
    numbers_by_rows: dict[int, list[int]] = defaultdict(list)
    for number, leaf in enumerate(leaves):
        numbers_by_rows[_count_kernel_rows(leaf)].append(number)
    for count, numbers in numbers_by_rows.items():
        now, first = ([pairs[number][side] for number in numbers] for side in (0, 1))
        selected = (
            _select_rows(shape, count, now, ended, first, rows)
            if count
            else jax.tree.leaves(in_jax(now, ended, first, rows))
        )
        for number, leaf in zip(numbers, selected, strict=True):
            leaves[number] = leaf
    replaced: WorldState = jax.tree.unflatten(structure, leaves)
    return replaced


def _count_kernel_rows(leaf: jax.Array) -> int:
    """Return the rows of a leaf [W, rows, ...] that a kernel selects; 0 if XLA does."""
    is_small = leaf.ndim > 1 and 0 < math.prod(leaf.shape[2:]) <= MAX_PLANES
    return leaf.shape[1] if is_small and leaf.dtype in (jnp.float32, jnp.int32, jnp.bool_) else 0


def _select_rows(
    shape: launch.LaunchShape,
    count: int,
    now: Sequence[jax.Array],
    ended: jax.Array,
    first: Sequence[jax.Array],
    rows: jax.Array,
) -> list[jax.Array]:
    """Return leaves [W, count, ...] as `replace_worlds`, by one kernel."""
    sizes = [math.prod(leaf.shape[2:]) for leaf in now]

    def kernel(world: jax.Array, row: jax.Array, *refs: jax.Ref) -> None:
        is_ended, source = refs[0][world], refs[1][world]
        firsts, nows, targets = (refs[2 + k * len(now) :][: len(now)] for k in range(3))
        at = [(world * count + row) * size for size in sizes]

        def load(refs: Sequence[jax.Ref], base: Sequence[jax.Array]) -> list[jax.Array]:
            return [
                ref[start + k]
                for ref, start, size in zip(refs, base, sizes, strict=True)
                for k in range(size)
            ]

        def load_new() -> list[jax.Array]:
            new = load(firsts, [(source * count + row) * size for size in sizes])
            return [jnp.where(is_ended, x, y) for x, y in zip(new, load(nows, at), strict=True)]

        values = iter(jax.lax.cond(jnp.any(is_ended), load_new, lambda: load(nows, at)))
        for target, start, size in zip(targets, at, sizes, strict=True):
            for k in range(size):
                target[start + k] = next(values)

    changed = [jax.lax.empty((leaf.size,), leaf.dtype) for leaf in now]
    constant = [ended, rows, *(leaf.reshape(-1) for leaf in (*first, *now))]
    flat = launch.call_kernel(kernel, shape, len(ended), count, constant, changed)
    return [x.reshape(leaf.shape) for x, leaf in zip(flat, now, strict=True)]


def fits_kernel(layout: PlaneLayout[Any]) -> bool:
    """Return whether the leaves of a tree can be written one by one in a kernel."""
    return layout.planes <= MAX_PLANES and all(leaf.size > 0 for leaf in layout.leaves)


def _list_leaves(layouts: Layouts) -> list[tuple[int, PlaneLayout[Any], LeafLayout]]:
    """Return number and layout of its tree for each leaf."""
    return [
        (number, layout, leaf) for number, layout in enumerate(layouts) for leaf in layout.leaves
    ]
