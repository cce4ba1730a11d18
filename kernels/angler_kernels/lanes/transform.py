"""Evaluation of a function of one body on many bodies, with one array per element of its arrays.

``vmap`` turns an array [3] of one body into an array [n, 3]. This turns it into three arrays [n],
the lanes: small axes become Python objects, and only elementwise operations on whole lanes remain.
Compilers keep such code in registers, vectorise it without shuffles, and kernels that know no
slices, stacks or reductions can hold it. Operations with constants 0 and 1 are not traced at all,
so an element that is zero for every body (of an added-mass matrix, say) costs nothing.

The function is traced once with the shapes of one body; its jaxpr is then followed with object
arrays of lanes in place of its variables. A loop runs until all lanes are done.
"""

from collections.abc import Callable, Sequence
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal, Primitive, Var
from jax.typing import ArrayLike

from angler_kernels.lanes.folding import fold_operation
from angler_kernels.lanes.shaping import SHAPING, PrimitiveRule, from_array, read_elements
from angler_kernels.lanes.table import LaneValue, LookupTable
from angler_kernels.lanes.trees import (
    Elements,
    UnsupportedOperationError,
    any_lane,
    aval_of,
    broadcast_like,
    flatten,
    naming_source,
    pack,
    split_leaf,
)


def apply[T](function: Callable[..., T], *args: object) -> T:
    """Evaluate ``function`` of one body on lanes.

    Args:
        function: function of one body, in JAX; the rules below list the operations that it may use.
        *args: pytrees as the function takes them, each leaf [...] an object array [...] of lanes
            (from `split`), a `LookupTable`, or a number that is the same for all.

    Returns:
        The function's result, each leaf [...] an object array [...] of lanes.
    """
    leaves, tree = jax.tree.flatten(args)
    elements = [leaf if isinstance(leaf, LookupTable) else _to_elements(leaf) for leaf in leaves]
    shapes = [jax.ShapeDtypeStruct(leaf.shape, _lane_dtype(leaf)) for leaf in elements]
    closed, out = jax.make_jaxpr(function, return_shape=True)(*jax.tree.unflatten(tree, shapes))
    result: T = jax.tree.unflatten(jax.tree.structure(out), _evaluate_closed(closed, elements))
    return result


def _to_elements(leaf: np.ndarray | ArrayLike) -> np.ndarray:
    """Return a leaf as an object array."""
    if isinstance(leaf, np.ndarray) and leaf.dtype == object:
        return leaf
    out = np.empty((), object)
    out[()] = leaf if isinstance(leaf, jax.Array) else _typed_constant(leaf)
    return out


def _typed_constant(value: ArrayLike) -> LaneValue:
    """Return a Python number with JAX's default type."""
    constant: LaneValue = np.asarray(value, jnp.result_type(value)).ravel()[0]
    return constant


def _lane_dtype(leaf: Elements) -> np.dtype:
    if isinstance(leaf, LookupTable):
        return leaf.dtype
    traced = [x.dtype for x in leaf.ravel() if not isinstance(x, np.generic)]
    dtype: np.dtype = traced[0] if traced else leaf.ravel()[0].dtype
    return dtype


def _evaluate_closed(closed: ClosedJaxpr, args: Sequence[Elements]) -> list[Elements]:
    """Evaluate a closed jaxpr on object arrays."""
    consts = [_constant_elements(const) for const in closed.consts]
    return _evaluate_jaxpr(closed.jaxpr, consts, args)


def _evaluate_jaxpr(
    jaxpr: Jaxpr, consts: Sequence[Elements], args: Sequence[Elements]
) -> list[Elements]:
    values: dict[Var, Elements] = {}

    def read(var: Var | Literal) -> Elements:
        if isinstance(var, Literal):
            return from_array(np.asarray(var.val, aval_of(var).dtype))
        return values[var]

    values.update(zip(jaxpr.constvars, consts, strict=True))
    values.update(zip(jaxpr.invars, args, strict=True))
    for eqn in jaxpr.eqns:
        operands = [read(var) for var in eqn.invars]
        rule = RULES.get(eqn.primitive.name)
        if rule is not None:
            with naming_source(eqn):
                results = rule(eqn, operands)
        elif _is_elementwise(eqn):
            results = [_apply_elementwise(eqn, operands)]
        else:
            raise UnsupportedOperationError(eqn, "no rule for")
        values.update(zip(eqn.outvars, results, strict=True))
    return [read(var) for var in jaxpr.outvars]


_NOT_ELEMENTWISE = {"axis", "axes", "dimension", "dimensions", "dimension_numbers", "branches"}
"""Parameters of operations that are none on numbers alone: they name an axis, or hold programs."""


def _is_elementwise(eqn: JaxprEqn) -> bool:
    """Return whether an equation is an elementwise operation on numbers, broadcast as by numpy.

    The shapes do not decide: a running sum has those of its operand. But it names an axis, and a
    factorisation does not take a number.
    """
    if len(eqn.outvars) != 1 or not eqn.invars or _NOT_ELEMENTWISE & eqn.params.keys():
        return False
    try:
        shape = np.broadcast_shapes(*(aval_of(var).shape for var in eqn.invars))
    except ValueError:
        return False
    if shape != aval_of(eqn.outvars[0]).shape:
        return False
    return shape == () or _takes_numbers(
        eqn.primitive, tuple(aval_of(var).dtype for var in eqn.invars), tuple(eqn.params.items())
    )


@cache
def _takes_numbers(
    primitive: Primitive, dtypes: tuple[np.dtype, ...], params: tuple[tuple[str, object], ...]
) -> bool:
    """Return whether an operation is defined on numbers as well."""
    numbers = [jax.ShapeDtypeStruct((), dtype) for dtype in dtypes]
    try:
        jax.eval_shape(partial(primitive.bind, **dict(params)), *numbers)
    except (TypeError, ValueError, IndexError):
        return False
    return True


def _constant_elements(value: jax.Array | np.ndarray) -> np.ndarray:
    """Return the constants of a function: numbers, or arrays that are the same for all lanes."""
    if isinstance(value, jax.core.Tracer):
        return split_leaf(value, 0)
    return from_array(np.asarray(value))


def _apply_elementwise(eqn: JaxprEqn, operands: Sequence[Elements]) -> np.ndarray:
    """Apply one operation to each element; operands are broadcast as by numpy."""
    shape = aval_of(eqn.outvars[0]).shape
    rows = [np.broadcast_to(read_elements(x), shape).ravel() for x in operands]
    return pack([fold_operation(eqn, row) for row in zip(*rows, strict=True)], shape)


def _apply_call(eqn: JaxprEqn, operands: Sequence[Elements]) -> list[Elements]:
    inner = eqn.params.get("jaxpr") or eqn.params["call_jaxpr"]
    return _evaluate_closed(inner, operands)


def _apply_while(eqn: JaxprEqn, operands: Sequence[Elements]) -> list[Elements]:
    """Repeat until the condition fails in every lane; finished lanes keep their values."""
    params = eqn.params
    n_cond, n_body = params["cond_nconsts"], params["body_nconsts"]
    of_cond, of_body = operands[:n_cond], operands[n_cond : n_cond + n_body]

    def is_running(leaves: Sequence[Elements]) -> jax.Array:
        (running,) = _evaluate_closed(params["cond_jaxpr"], [*of_cond, *leaves])
        lanes: jax.Array = read_elements(running).item()
        return lanes

    def body(leaves: Sequence[Elements]) -> list[Elements]:
        running = is_running(leaves)
        after = _evaluate_closed(params["body_jaxpr"], [*of_body, *leaves])
        old, rebuild = flatten(list(leaves))
        new = flatten(after)[0]
        pairs = zip(new, old, strict=True)
        return rebuild([jnp.where(running, x, y) for x, y in pairs])

    row, rebuild = _broadcast_start(body, [*operands[n_cond + n_body :]])
    end = jax.lax.while_loop(
        lambda row: any_lane(is_running(rebuild(row))),
        lambda row: _spread_row(flatten(body(rebuild(row)))[0], row),
        row,
    )
    return rebuild(end)


def _apply_scan(eqn: JaxprEqn, operands: Sequence[Elements]) -> list[Elements]:
    """Apply a loop of fixed length that neither reads nor returns rows: ``fori_loop``."""
    params = eqn.params
    inner = params["jaxpr"].jaxpr
    outer_vars = [*eqn.invars, *eqn.outvars]
    inner_vars = [*inner.invars, *inner.outvars]
    if any(
        aval_of(x).shape != aval_of(y).shape for x, y in zip(outer_vars, inner_vars, strict=True)
    ):
        raise UnsupportedOperationError(eqn, "only loops without rows")
    n_const = len(eqn.invars) - len(eqn.outvars)
    const = operands[:n_const]

    def body(leaves: Sequence[Elements]) -> list[Elements]:
        return _evaluate_closed(params["jaxpr"], [*const, *leaves])

    row, rebuild = _broadcast_start(body, [*operands[n_const:]])
    end = jax.lax.fori_loop(
        0, params["length"], lambda _, row: _spread_row(flatten(body(rebuild(row)))[0], row), row
    )
    return rebuild(end)


def _broadcast_start(
    body: Callable[[Sequence[Elements]], list[Elements]], start: list[Elements]
) -> tuple[list[jax.Array], Callable[[Sequence[jax.Array]], list[Elements]]]:
    """Return start of a loop with lanes as wide as the loop makes them: one number or all lanes."""
    row, rebuild = flatten(start)
    row = [jnp.asarray(x) for x in row]
    while True:
        after = jax.eval_shape(lambda row: flatten(body(rebuild(row)))[0], row)
        shapes = [np.broadcast_shapes(x.shape, y.shape) for x, y in zip(row, after, strict=True)]
        if all(x.shape == shape for x, shape in zip(row, shapes, strict=True)):
            return row, rebuild
        row = [jnp.broadcast_to(x, shape) for x, shape in zip(row, shapes, strict=True)]


def _spread_row(row: Sequence[jax.Array], old: Sequence[jax.Array]) -> list[jax.Array]:
    return [broadcast_like(x, y) for x, y in zip(row, old, strict=True)]


RULES: dict[str, PrimitiveRule] = {
    **SHAPING,
    "jit": _apply_call,
    "pjit": _apply_call,
    "custom_jvp_call": _apply_call,
    "custom_vjp_call": _apply_call,
    "while": _apply_while,
    "scan": _apply_scan,
}
