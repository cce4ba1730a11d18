"""Rules for operations that move or combine elements: object arrays only."""

import operator
from collections.abc import Callable, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import JaxprEqn

from angler_kernels.lanes.folding import apply_binary
from angler_kernels.lanes.table import LaneValue, LookupTable
from angler_kernels.lanes.trees import Elements, UnsupportedOperationError, aval_of

type PrimitiveRule = Callable[[JaxprEqn, Sequence[Elements]], Sequence[Elements]]
"""Rule of a primitive: operands of an equation to its results."""


def from_array(value: np.ndarray) -> np.ndarray:
    """Return a constant array as an object array of typed numbers."""
    out = np.empty(value.shape, object)
    for index in np.ndindex(*value.shape):
        out[index] = value[index]
    return out


def read_elements(x: Elements) -> np.ndarray:
    """Return elements as an object array: of a table all entries."""
    return x.read_all() if isinstance(x, LookupTable) else x


def _apply_broadcast(eqn: JaxprEqn, operands: Sequence[Elements]) -> list[np.ndarray]:
    shape, axes = eqn.params["shape"], eqn.params["broadcast_dimensions"]
    x = read_elements(operands[0])
    expanded = np.ones(len(shape), int)
    expanded[list(axes)] = x.shape
    return [np.broadcast_to(x.reshape(expanded), shape)]


def _apply_reshape(eqn: JaxprEqn, operands: Sequence[Elements]) -> list[np.ndarray]:
    shape = aval_of(eqn.outvars[0]).shape
    return [read_elements(operands[0]).reshape(shape)]


def _apply_slice(eqn: JaxprEqn, operands: Sequence[Elements]) -> list[np.ndarray]:
    starts, limits = eqn.params["start_indices"], eqn.params["limit_indices"]
    steps = eqn.params["strides"] or (1,) * len(starts)
    window = tuple(slice(*edges) for edges in zip(starts, limits, steps, strict=True))
    return [operands[0][window]]


def _apply_dynamic_slice(eqn: JaxprEqn, operands: Sequence[Elements]) -> list[np.ndarray]:
    """Return rows at a traced index: loaded from a table, or selected from lanes one by one."""
    source, starts = operands[0], map(read_elements, operands[1:])
    sizes = eqn.params["slice_sizes"]
    first = [start[()] for start in starts]
    out = np.empty(sizes, object)
    for index in np.ndindex(*sizes):
        position = [at + i for at, i in zip(first, index, strict=True)]
        out[index] = (
            source.take(position)
            if isinstance(source, LookupTable)
            else _select_element(source, position)
        )
    return [out]


def _select_element(source: np.ndarray, position: Sequence[LaneValue]) -> LaneValue:
    """Return the element of a small array at a position whose indices may be traced."""
    if not position:
        element: LaneValue = source.item()
        return element
    at, *rest = position
    rows = [_select_element(_as_object_array(row), rest) for row in source]
    if isinstance(at, np.generic):
        return rows[int(at)]
    chosen = rows[0]
    for i, row in enumerate(rows[1:], start=1):
        chosen = jnp.where(at >= i, row, chosen)
    return chosen


def _apply_gather(eqn: JaxprEqn, operands: Sequence[Elements]) -> list[np.ndarray]:
    """Return entries of a table [n], one for each index, or of rows of a table [r, n], one of each.

    These are look-ups under ``vmap``.
    """
    source, indices = operands[0], read_elements(operands[1])
    shape = aval_of(eqn.outvars[0]).shape
    numbers = eqn.params["dimension_numbers"]
    is_by_row = (
        isinstance(source, LookupTable)
        and eqn.params["slice_sizes"] == (1, 1)
        and tuple(numbers.operand_batching_dims) == (0,)
        and tuple(numbers.start_indices_batching_dims) == (0,)
        and indices.size == source.shape[0]
    )
    is_alike = isinstance(source, LookupTable) and eqn.params["slice_sizes"] == (1,)
    if not is_alike and not is_by_row:
        raise UnsupportedOperationError(eqn, "gather only looks up single entries of a Table")
    out = np.empty(indices.size, object)
    for i, at in enumerate(indices.ravel()):
        out[i] = source.take([i, at] if is_by_row else [at])
    return [out.reshape(shape)]


def _apply_concatenate(eqn: JaxprEqn, operands: Sequence[Elements]) -> list[np.ndarray]:
    return [np.concatenate([*map(read_elements, operands)], axis=eqn.params["dimension"])]


def _apply_stack(eqn: JaxprEqn, operands: Sequence[Elements]) -> list[np.ndarray]:
    return [np.stack([*map(read_elements, operands)], axis=eqn.params["axis"])]


def _apply_unstack(eqn: JaxprEqn, operands: Sequence[Elements]) -> list[np.ndarray]:
    x = np.moveaxis(read_elements(operands[0]), eqn.params["axis"], 0)
    return [_as_object_array(row) for row in x]


def _as_object_array(value: np.ndarray | LaneValue) -> np.ndarray:
    """Return a row of an object array; numpy returns a bare element where no axes remain."""
    if isinstance(value, np.ndarray) and value.dtype == object:
        return value
    out = np.empty((), object)
    out[()] = value
    return out


def _apply_split(eqn: JaxprEqn, operands: Sequence[Elements]) -> list[np.ndarray]:
    ends = np.cumsum(eqn.params["sizes"])[:-1]
    return list(np.split(read_elements(operands[0]), ends, axis=eqn.params["axis"]))


def _apply_transpose(eqn: JaxprEqn, operands: Sequence[Elements]) -> list[np.ndarray]:
    return [np.transpose(read_elements(operands[0]), eqn.params["permutation"])]


def _apply_iota(eqn: JaxprEqn, operands: Sequence[Elements]) -> list[np.ndarray]:
    shape, axis = eqn.params["shape"], eqn.params["dimension"]
    count = np.arange(shape[axis], dtype=eqn.params["dtype"])
    spread = [1] * len(shape)
    spread[axis] = -1
    return [from_array(np.broadcast_to(count.reshape(spread), shape))]


def _build_reduction(combine: Callable[[LaneValue, LaneValue], LaneValue]) -> PrimitiveRule:
    def rule(eqn: JaxprEqn, operands: Sequence[Elements]) -> list[np.ndarray]:
        axes = eqn.params["axes"]
        x = np.moveaxis(read_elements(operands[0]), axes, range(len(axes)))
        rows = x.reshape(-1, *x.shape[len(axes) :])
        out = np.empty(rows.shape[1:], object)
        for index in np.ndindex(*out.shape):
            total = rows[(0, *index)]
            for row in rows[1:]:
                total = combine(total, row[index])
            out[index] = total
        return [out]

    return rule


SHAPING: dict[str, PrimitiveRule] = {
    "broadcast_in_dim": _apply_broadcast,
    "reshape": _apply_reshape,
    "squeeze": _apply_reshape,
    "expand_dims": _apply_reshape,
    "slice": _apply_slice,
    "dynamic_slice": _apply_dynamic_slice,
    "gather": _apply_gather,
    "concatenate": _apply_concatenate,
    "stack": _apply_stack,
    "unstack": _apply_unstack,
    "split": _apply_split,
    "transpose": _apply_transpose,
    "iota": _apply_iota,
    "reduce_sum": _build_reduction(partial(apply_binary, jax.lax.add_p)),
    "reduce_max": _build_reduction(partial(apply_binary, jax.lax.max_p)),
    "reduce_min": _build_reduction(partial(apply_binary, jax.lax.min_p)),
    "reduce_and": _build_reduction(operator.and_),
    "reduce_or": _build_reduction(operator.or_),
}
