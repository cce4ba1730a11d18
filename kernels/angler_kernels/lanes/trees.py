"""Trees whose leaves are object arrays of lanes: one array for every element of a body's arrays."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

type Elements = Any
"""An object array of lanes, or a `Table`."""


def split(tree: Any, lead: int = 1) -> Any:
    """Arrays with ``lead`` axes of lanes in front to object arrays of lanes, leaf by leaf."""

    def split_leaf(leaf: jax.Array) -> Elements:
        tail = leaf.shape[lead:]
        out = np.empty(tail, object)
        for index in np.ndindex(*tail):
            out[index] = leaf[(..., *index)] if tail else leaf
        return out

    return jax.tree.map(split_leaf, tree)


def join(tree: Any) -> Any:
    """Object arrays of lanes to arrays with the lanes' axes in front, leaf by leaf."""

    def join_leaf(leaf: Elements) -> jax.Array:
        shape = np.broadcast_shapes(*(np.shape(x) for x in leaf.ravel()))
        flat = [jnp.broadcast_to(jnp.asarray(x), shape) for x in leaf.ravel()]
        if leaf.ndim == 0:
            return flat[0]
        return jnp.stack(flat, axis=-1).reshape(*shape, *leaf.shape)

    return jax.tree.map(join_leaf, tree)


def pack(items: Sequence[Any], shape: tuple[int, ...]) -> Elements:
    """Lanes in a row as an object array of the given shape."""
    out = np.empty(len(items), object)
    for i, item in enumerate(items):  # an assignment of the whole would look into the lanes
        out[i] = item
    return out.reshape(shape)


def flatten(tree: Any) -> tuple[list[jax.Array], Callable[[Sequence[jax.Array]], Any]]:
    """The lanes of a tree of object arrays in a row, and what puts such a row back into a tree."""
    leaves, structure = jax.tree.flatten(tree)
    shapes = [leaf.shape for leaf in leaves]
    flat = [x for leaf in leaves for x in leaf.ravel()]

    def rebuild(row: Sequence[jax.Array]) -> Any:
        out, at = [], 0
        for shape in shapes:
            size = math.prod(shape)
            out.append(pack(row[at : at + size], shape))
            at += size
        return jax.tree.unflatten(structure, out)

    return flat, rebuild


def repeat(times: Any, body: Callable[[jax.Array, Any], Any], tree: Any) -> Any:
    """``body(i, tree)`` a number of times, on a tree of object arrays, in a loop of the program.

    Args:
        times: how often; a number, or int32 [].
        body: of int32 [] i and the tree; gives the same tree.
        tree: object arrays whose lanes all have their final shape.
    """
    flat, rebuild = flatten(tree)

    def step_row(i: jax.Array, row: Sequence[jax.Array]) -> list[jax.Array]:
        after, _ = flatten(body(i, rebuild(row)))
        return [broadcast_like(x, old) for x, old in zip(after, row, strict=True)]

    return rebuild(jax.lax.fori_loop(0, times, step_row, flat))


def broadcast_like(x: Any, like: jax.Array) -> jax.Array:
    """Lanes or a number, with the shape and type of ``like``."""
    return jnp.broadcast_to(jnp.asarray(x, like.dtype), like.shape)


def any_lane(where: Any) -> jax.Array:
    """Whether any lane of a bool array is true, in a form that all backends know."""
    return jnp.max(jnp.where(where, 1, 0)) > 0


def select_lanes(condition: jax.Array, tree: Any, otherwise: Any) -> Any:
    """The lanes of one tree of object arrays where a condition holds, those of the other else."""
    flat, rebuild = flatten(otherwise)
    return rebuild(
        [jnp.where(condition, x, y) for x, y in zip(flatten(tree)[0], flat, strict=True)]
    )
