"""Rules for operations that move elements about, or combine them: nothing but object arrays."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels.lanes.folding import two
from angler_kernels.lanes.table import LookupTable
from angler_kernels.lanes.trees import Elements

type Rule = Callable[[Any, Sequence[Elements]], list[Elements]]
"""What becomes of an equation's operands."""


def from_array(value: np.ndarray) -> Elements:
    """A constant array as an object array of typed numbers."""
    out = np.empty(value.shape, object)
    for index in np.ndindex(*value.shape):
        out[index] = value[index]
    return out


def _broadcast(eqn: Any, operands: Sequence[Elements]) -> list[Elements]:
    shape, axes = eqn.params["shape"], eqn.params["broadcast_dimensions"]
    x = operands[0]
    x = x.whole() if isinstance(x, LookupTable) else x
    grown = np.ones(len(shape), int)
    grown[list(axes)] = x.shape
    return [np.broadcast_to(x.reshape(grown), shape)]


def _reshape(eqn: Any, operands: Sequence[Elements]) -> list[Elements]:
    shape = eqn.outvars[0].aval.shape
    return [operands[0].reshape(shape)]


def _slice(eqn: Any, operands: Sequence[Elements]) -> list[Elements]:
    starts, limits = eqn.params["start_indices"], eqn.params["limit_indices"]
    steps = eqn.params["strides"] or (1,) * len(starts)
    window = tuple(slice(*edges) for edges in zip(starts, limits, steps, strict=True))
    return [operands[0][window]]


def _dynamic_slice(eqn: Any, operands: Sequence[Elements]) -> list[Elements]:
    """Rows at a traced index: loaded from a table, or picked from lanes one by one."""
    source, *starts = operands
    sizes = eqn.params["slice_sizes"]
    first = [start[()] for start in starts]
    out = np.empty(sizes, object)
    for index in np.ndindex(*sizes):
        place = [at + i for at, i in zip(first, index, strict=True)]
        out[index] = source.take(place) if isinstance(source, LookupTable) else _pick(source, place)
    return [out]


def _pick(source: Elements, place: Sequence[Any]) -> Any:
    """The element of a small array at a place of which each number may be traced."""
    if not place:
        return source[()]
    at, *rest = place
    rows = [_pick(_object(row), rest) for row in source]
    if isinstance(at, np.generic):
        return rows[int(at)]
    chosen = rows[0]
    for i, row in enumerate(rows[1:], start=1):
        chosen = jnp.where(at >= i, row, chosen)
    return chosen


def _gather(eqn: Any, operands: Sequence[Elements]) -> list[Elements]:
    """Entries of a table [n], one for each index: what ``vmap`` makes of a look-up."""
    source, indices = operands
    shape = eqn.outvars[0].aval.shape
    if not isinstance(source, LookupTable) or eqn.params["slice_sizes"] != (1,):
        raise NotImplementedError(f"lanes: gather only looks up single entries of a Table: {eqn}")
    out = np.empty(indices.size, object)
    for i, at in enumerate(indices.ravel()):
        out[i] = source.take([at])
    return [out.reshape(shape)]


def _concatenate(eqn: Any, operands: Sequence[Elements]) -> list[Elements]:
    return [np.concatenate(operands, axis=eqn.params["dimension"])]


def _stack(eqn: Any, operands: Sequence[Elements]) -> list[Elements]:
    return [np.stack(operands, axis=eqn.params["axis"])]


def _unstack(eqn: Any, operands: Sequence[Elements]) -> list[Elements]:
    x = np.moveaxis(operands[0], eqn.params["axis"], 0)
    return [_object(row) for row in x]


def _object(value: Any) -> Elements:
    """A row of an object array, which numpy gives bare where it has no axes left."""
    if isinstance(value, np.ndarray) and value.dtype == object:
        return value
    out = np.empty((), object)
    out[()] = value
    return out


def _split(eqn: Any, operands: Sequence[Elements]) -> list[Elements]:
    ends = np.cumsum(eqn.params["sizes"])[:-1]
    return list(np.split(operands[0], ends, axis=eqn.params["axis"]))


def _transpose(eqn: Any, operands: Sequence[Elements]) -> list[Elements]:
    return [np.transpose(operands[0], eqn.params["permutation"])]


def _iota(eqn: Any, operands: Sequence[Elements]) -> list[Elements]:
    shape, axis = eqn.params["shape"], eqn.params["dimension"]
    count = np.arange(shape[axis], dtype=eqn.params["dtype"])
    spread = [1] * len(shape)
    spread[axis] = -1
    return [from_array(np.broadcast_to(count.reshape(spread), shape))]


def _reduce(combine: Callable[[Any, Any], Any]) -> Callable[[Any, Sequence[Elements]], list[Any]]:
    def rule(eqn: Any, operands: Sequence[Elements]) -> list[Elements]:
        axes = eqn.params["axes"]
        x = operands[0].whole() if isinstance(operands[0], LookupTable) else operands[0]
        x = np.moveaxis(x, axes, range(len(axes)))
        rows = x.reshape(-1, *x.shape[len(axes) :])
        out = np.empty(rows.shape[1:], object)
        for index in np.ndindex(*out.shape):
            total = rows[(0, *index)]
            for row in rows[1:]:
                total = combine(total, row[index])
            out[index] = total
        return [out]

    return rule


SHAPING: dict[str, Rule] = {
    "broadcast_in_dim": _broadcast,
    "reshape": _reshape,
    "squeeze": _reshape,
    "expand_dims": _reshape,
    "slice": _slice,
    "dynamic_slice": _dynamic_slice,
    "gather": _gather,
    "concatenate": _concatenate,
    "stack": _stack,
    "unstack": _unstack,
    "split": _split,
    "transpose": _transpose,
    "iota": _iota,
    "reduce_sum": _reduce(partial(two, jax.lax.add_p)),
    "reduce_max": _reduce(partial(two, jax.lax.max_p)),
    "reduce_min": _reduce(partial(two, jax.lax.min_p)),
    "reduce_and": _reduce(lambda a, b: a & b),
    "reduce_or": _reduce(lambda a, b: a | b),
}
