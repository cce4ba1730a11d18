"""Trees whose leaves are object arrays of lanes: one array for every element of a body's arrays."""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import source_info_util
from jax.extend.core import JaxprEqn, Literal, Var

from angler_kernels.lanes.table import LaneValue, LookupTable

type Elements = np.ndarray | LookupTable
"""Object array of lanes, or a `LookupTable`."""


class UnsupportedOperationError(NotImplementedError):
    """A function of one body uses an operation that lanes have no rule for.

    Attributes:
        operation: name of JAX's primitive.
        source: file, line and function of the code that uses it; empty where JAX does not say.
    """

    def __init__(self, eqn: JaxprEqn, reason: str) -> None:
        """Describe an equation of a jaxpr and why it has no rule."""
        super().__init__(f"lanes: {reason}: {eqn}")
        self.operation: str = eqn.primitive.name
        self.source: str = source_info_util.summarize(eqn.source_info)


@contextmanager
def naming_source(eqn: JaxprEqn) -> Iterator[None]:
    """Give an `UnsupportedOperationError` without a source that of the call it comes from.

    JAX traces its own compiled functions once, without the code that calls them.
    """
    try:
        yield
    except UnsupportedOperationError as error:
        error.source = error.source or source_info_util.summarize(eqn.source_info)
        raise


def aval_of(atom: Var | Literal) -> jax.core.ShapedArray:
    """Return shape and type of a variable or a constant of a jaxpr.

    Raises:
        TypeError: it is no array.
    """
    if not isinstance(atom.aval, jax.core.ShapedArray):
        raise TypeError(f"lanes: no array: {atom.aval}")
    return atom.aval


def split[T](tree: T) -> T:
    """Turn arrays with an axis of lanes in front into object arrays, leaf by leaf."""
    elements: T = jax.tree.map(split_leaf, tree)
    return elements


def split_leaf(leaf: jax.Array, lead: int = 1) -> np.ndarray:
    """Turn an array with ``lead`` axes of lanes in front into an object array."""
    tail = leaf.shape[lead:]
    out = np.empty(tail, object)
    for index in np.ndindex(*tail):
        out[index] = leaf[(..., *index)] if tail else leaf
    return out


def join[T](tree: T) -> T:
    """Turn object arrays of lanes into arrays with the lanes' axes in front, leaf by leaf."""

    def join_leaf(leaf: np.ndarray) -> jax.Array:
        shape = np.broadcast_shapes(*(np.shape(x) for x in leaf.ravel()))
        flat = [jnp.broadcast_to(jnp.asarray(x), shape) for x in leaf.ravel()]
        if leaf.ndim == 0:
            return flat[0]
        return jnp.stack(flat, axis=-1).reshape(*shape, *leaf.shape)

    arrays: T = jax.tree.map(join_leaf, tree)
    return arrays


def pack(items: Sequence[LaneValue], shape: tuple[int, ...]) -> np.ndarray:
    """Return a row of lanes as an object array of a shape."""
    out = np.empty(len(items), object)
    for i, item in enumerate(items):  # an assignment of the whole would look into the lanes
        out[i] = item
    return out.reshape(shape)


def flatten[T](tree: T) -> tuple[list[jax.Array], Callable[[Sequence[jax.Array]], T]]:
    """Return lanes of a tree of object arrays in a row, and the function that rebuilds the tree."""
    leaves, structure = jax.tree.flatten(tree)
    shapes = [leaf.shape for leaf in leaves]
    flat = [x for leaf in leaves for x in leaf.ravel()]

    def rebuild(row: Sequence[jax.Array]) -> T:
        out, at = [], 0
        for shape in shapes:
            size = math.prod(shape)
            out.append(pack(row[at : at + size], shape))
            at += size
        rebuilt: T = jax.tree.unflatten(structure, out)
        return rebuilt

    return flat, rebuild


def repeat[T](times: jax.Array | int, body: Callable[[jax.Array, T], T], tree: T) -> T:
    """Repeat ``body(i, tree)`` on a tree of object arrays, in a loop of the program.

    Args:
        times: number of repetitions; a number, or int32 [].
        body: function of int32 [] i and the tree; returns the same tree.
        tree: object arrays whose lanes all have their final shape.
    """
    flat, rebuild = flatten(tree)

    def step_row(i: jax.Array, row: Sequence[jax.Array]) -> list[jax.Array]:
        after, _ = flatten(body(i, rebuild(row)))
        return [broadcast_like(x, old) for x, old in zip(after, row, strict=True)]

    return rebuild(jax.lax.fori_loop(0, times, step_row, flat))


def broadcast_like(x: LaneValue, like: jax.Array) -> jax.Array:
    """Return lanes or a number with the shape and type of ``like``."""
    return jnp.broadcast_to(jnp.asarray(x, like.dtype), like.shape)


def any_lane(where: jax.Array | np.bool_) -> jax.Array:
    """Return whether any lane of a bool array is true, in a form that all backends support."""
    return jnp.max(jnp.where(where, 1, 0)) > 0


def select_lanes[T](condition: jax.Array, tree: T, otherwise: T) -> T:
    """Select the lanes of one tree of object arrays where a condition holds, else of the other."""
    flat, rebuild = flatten(otherwise)
    return rebuild(
        [jnp.where(condition, x, y) for x, y in zip(flatten(tree)[0], flat, strict=True)]
    )
