"""Evaluate a function of one body on many bodies, with one array for every element of its arrays.

``vmap`` turns an array [3] of one body into an array [n, 3]. This turns it into three arrays [n],
the lanes: small axes become Python objects, and only elementwise operations on whole lanes remain.
Compilers keep such code in registers, vectorise it without shuffles, and kernels that know no
slices, stacks or reductions can hold it. Operations with constants 0 and 1 are not traced at all,
so an element that is zero for every body (of an added-mass matrix, say) costs nothing.

The function is traced once with the shapes of one body; its jaxpr is then followed with object
arrays of lanes in place of its variables. A loop runs until all lanes are done.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from angler_kernels.lanes.folding import fold, two
from angler_kernels.lanes.table import Table

type Elements = Any
"""An object array of lanes, or a `Table`."""


def apply(function: Callable[..., Any], *args: Any) -> Any:
    """Evaluate ``function`` of one body on lanes.

    Args:
        function: of one body, in JAX; see the list of rules below for what it may use.
        *args: pytrees as the function takes them, each leaf [...] an object array [...] of lanes
            (from `split`), a `Table`, or a number that is the same for all.

    Returns:
        The function's result, each leaf [...] an object array [...] of lanes.
    """
    leaves, tree = jax.tree.flatten(args)
    elements = [leaf if isinstance(leaf, Table) else _elements(leaf) for leaf in leaves]
    shapes = [jax.ShapeDtypeStruct(leaf.shape, _dtype(leaf)) for leaf in elements]
    closed, out = jax.make_jaxpr(function, return_shape=True)(*jax.tree.unflatten(tree, shapes))
    return jax.tree.unflatten(jax.tree.structure(out), _follow(closed, elements))


def split(tree: Any, lead: int = 1) -> Any:
    """Arrays with ``lead`` axes of lanes in front to object arrays of lanes, leaf by leaf."""

    def one(leaf: jax.Array) -> Elements:
        tail = leaf.shape[lead:]
        out = np.empty(tail, object)
        for index in np.ndindex(*tail):
            out[index] = leaf[(..., *index)] if tail else leaf
        return out

    return jax.tree.map(one, tree)


def join(tree: Any) -> Any:
    """Object arrays of lanes to arrays with the lanes' axes in front, leaf by leaf."""

    def one(leaf: Elements) -> jax.Array:
        shape = np.broadcast_shapes(*(np.shape(x) for x in leaf.ravel()))
        flat = [jnp.broadcast_to(jnp.asarray(x), shape) for x in leaf.ravel()]
        if leaf.ndim == 0:
            return flat[0]
        return jnp.stack(flat, axis=-1).reshape(*shape, *leaf.shape)

    return jax.tree.map(one, tree)


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


def repeat(times: int, body: Callable[[jax.Array, Any], Any], tree: Any) -> Any:
    """``body(i, tree)`` a number of times, on a tree of object arrays, in a loop of the program.

    Args:
        times: how often.
        body: of int32 [] i and the tree; gives the same tree.
        tree: object arrays whose lanes all have their final shape.
    """
    flat, rebuild = flatten(tree)

    def one(i: jax.Array, row: Sequence[jax.Array]) -> list[jax.Array]:
        after, _ = flatten(body(i, rebuild(row)))
        return [spread(x, old) for x, old in zip(after, row, strict=True)]

    return rebuild(jax.lax.fori_loop(0, times, one, flat))


def spread(x: Any, like: jax.Array) -> jax.Array:
    """Lanes or a number, with the shape and type of ``like``."""
    return jnp.broadcast_to(jnp.asarray(x, like.dtype), like.shape)


def any_lane(where: Any) -> jax.Array:
    """Whether any lane of a bool array is true, in a form that all backends know."""
    return jnp.max(jnp.where(where, 1, 0)) > 0


def _elements(leaf: Any) -> Elements:
    """A leaf as an object array."""
    if isinstance(leaf, np.ndarray) and leaf.dtype == object:
        return leaf
    out = np.empty((), object)
    out[()] = leaf if isinstance(leaf, jax.Array) else _constant(leaf)
    return out


def _constant(value: Any) -> Any:
    """A Python number with JAX's default type."""
    return np.asarray(value, jnp.result_type(value))[()]


def _dtype(leaf: Elements) -> Any:
    if isinstance(leaf, Table):
        return leaf.dtype
    traced = [x.dtype for x in leaf.ravel() if not isinstance(x, np.generic)]
    return traced[0] if traced else leaf.ravel()[0].dtype


def _follow(closed: ClosedJaxpr, args: Sequence[Elements]) -> list[Elements]:
    """Evaluate a closed jaxpr on object arrays."""
    consts = [_closed_over(const) for const in closed.consts]
    return _follow_open(closed.jaxpr, consts, args)


def _follow_open(
    jaxpr: Jaxpr, consts: Sequence[Elements], args: Sequence[Elements]
) -> list[Elements]:
    known: dict[Any, Elements] = {}

    def read(var: Any) -> Elements:
        if isinstance(var, Literal):
            aval: Any = var.aval
            return _from_array(np.asarray(var.val, aval.dtype))
        return known[var]

    known.update(zip(jaxpr.constvars, consts, strict=True))
    known.update(zip(jaxpr.invars, args, strict=True))
    for eqn in jaxpr.eqns:
        operands = [read(var) for var in eqn.invars]
        rule = RULES.get(eqn.primitive.name)
        if rule is not None:
            results = rule(eqn, operands)
        elif _is_elementwise(eqn):
            results = [_elementwise(eqn, operands)]
        else:
            raise NotImplementedError(f"lanes: no rule for {eqn}")
        known.update(zip(eqn.outvars, results, strict=True))
    return [read(var) for var in jaxpr.outvars]


_AXES = {"axis", "axes", "dimension", "dimensions", "dimension_numbers"}
"""What parameters are called that name an axis."""


def _is_elementwise(eqn: Any) -> bool:
    """Whether it is an operation on numbers, done to each element of operands as numpy would.

    The shapes do not tell: a running sum has those of its operand. But it names an axis, and a
    factorisation does not take a number.
    """
    if len(eqn.outvars) != 1 or not eqn.invars or _AXES & eqn.params.keys():
        return False
    numbers = [jax.ShapeDtypeStruct((), var.aval.dtype) for var in eqn.invars]
    try:
        shape = np.broadcast_shapes(*(var.aval.shape for var in eqn.invars))
        if shape != ():
            jax.eval_shape(partial(eqn.primitive.bind, **eqn.params), *numbers)
    except (TypeError, ValueError, IndexError):
        return False
    return bool(shape == eqn.outvars[0].aval.shape)


def _closed_over(value: Any) -> Elements:
    """What a function holds beside its arguments: numbers, or arrays that are the same for all."""
    if isinstance(value, jax.core.Tracer):
        return split(value, 0)
    return _from_array(np.asarray(value))


def _from_array(value: np.ndarray) -> Elements:
    """A constant array as an object array of typed numbers."""
    out = np.empty(value.shape, object)
    for index in np.ndindex(*value.shape):
        out[index] = value[index]
    return out


def _elementwise(eqn: Any, operands: Sequence[Elements]) -> Elements:
    """One operation on each element; operands are broadcast as numpy would."""
    out = np.empty(eqn.outvars[0].aval.shape, object)
    whole = (x.whole() if isinstance(x, Table) else x for x in operands)
    operands = [np.broadcast_to(x, out.shape) for x in whole]
    for index in np.ndindex(*out.shape):
        out[index] = fold(eqn, [operand[index] for operand in operands])
    return out


def _broadcast(eqn: Any, operands: Sequence[Elements]) -> list[Elements]:
    shape, axes = eqn.params["shape"], eqn.params["broadcast_dimensions"]
    x = operands[0]
    x = x.whole() if isinstance(x, Table) else x
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
        out[index] = source.take(place) if isinstance(source, Table) else _pick(source, place)
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
    if not isinstance(source, Table) or eqn.params["slice_sizes"] != (1,):
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
    return [_from_array(np.broadcast_to(count.reshape(spread), shape))]


def _reduce(combine: Callable[[Any, Any], Any]) -> Callable[[Any, Sequence[Elements]], list[Any]]:
    def rule(eqn: Any, operands: Sequence[Elements]) -> list[Elements]:
        axes = eqn.params["axes"]
        x = operands[0].whole() if isinstance(operands[0], Table) else operands[0]
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


def _call(eqn: Any, operands: Sequence[Elements]) -> list[Elements]:
    inner = eqn.params.get("jaxpr") or eqn.params["call_jaxpr"]
    return _follow(inner, operands)


def _while(eqn: Any, operands: Sequence[Elements]) -> list[Elements]:
    """Repeat until the condition fails in every lane; lanes that are done keep what they have."""
    params = eqn.params
    n_cond, n_body = params["cond_nconsts"], params["body_nconsts"]
    of_cond, of_body = operands[:n_cond], operands[n_cond : n_cond + n_body]

    def alive(leaves: Sequence[Elements]) -> Any:
        return _follow(params["cond_jaxpr"], [*of_cond, *leaves])[0][()]

    def body(leaves: Sequence[Elements]) -> list[Elements]:
        on = alive(leaves)
        after = _follow(params["body_jaxpr"], [*of_body, *leaves])
        kept, rebuild = flatten(list(leaves))
        moved = flatten(after)[0]
        both = zip(moved, kept, strict=True)
        masked: list[Elements] = rebuild([jnp.where(on, x, y) for x, y in both])
        return masked

    row, rebuild = _settled(body, [*operands[n_cond + n_body :]])
    end = jax.lax.while_loop(
        lambda row: any_lane(alive(rebuild(row))),
        lambda row: _like(flatten(body(rebuild(row)))[0], row),
        row,
    )
    after: list[Elements] = rebuild(end)
    return after


def _scan(eqn: Any, operands: Sequence[Elements]) -> list[Elements]:
    """A loop of fixed length that reads and gives no rows: ``fori_loop``."""
    params = eqn.params
    inner = params["jaxpr"].jaxpr
    outer = [*eqn.invars, *eqn.outvars]
    within = [*inner.invars, *inner.outvars]
    if any(x.aval.shape != y.aval.shape for x, y in zip(outer, within, strict=True)):
        raise NotImplementedError(f"lanes: only loops without rows: {eqn}")
    n_const = len(eqn.invars) - len(eqn.outvars)
    const = operands[:n_const]

    def body(leaves: Sequence[Elements]) -> list[Elements]:
        return _follow(params["jaxpr"], [*const, *leaves])

    row, rebuild = _settled(body, [*operands[n_const:]])
    end = jax.lax.fori_loop(
        0, params["length"], lambda _, row: _like(flatten(body(rebuild(row)))[0], row), row
    )
    after: list[Elements] = rebuild(end)
    return after


def _settled(
    body: Callable[[Sequence[Elements]], list[Elements]], start: list[Elements]
) -> tuple[list[jax.Array], Callable[[Sequence[jax.Array]], Any]]:
    """The start of a loop with lanes as wide as the loop makes them: one number or all lanes."""
    row, rebuild = flatten(start)
    row = [jnp.asarray(x) for x in row]
    while True:
        after = jax.eval_shape(lambda row: flatten(body(rebuild(row)))[0], row)
        shapes = [np.broadcast_shapes(x.shape, y.shape) for x, y in zip(row, after, strict=True)]
        if all(x.shape == shape for x, shape in zip(row, shapes, strict=True)):
            return row, rebuild
        row = [jnp.broadcast_to(x, shape) for x, shape in zip(row, shapes, strict=True)]


def _like(row: Sequence[Any], old: Sequence[jax.Array]) -> list[jax.Array]:
    return [spread(x, y) for x, y in zip(row, old, strict=True)]


RULES: dict[str, Callable[[Any, Sequence[Elements]], list[Elements]]] = {
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
    "jit": _call,
    "pjit": _call,
    "custom_jvp_call": _call,
    "custom_vjp_call": _call,
    "while": _while,
    "scan": _scan,
}
