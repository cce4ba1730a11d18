"""Evaluate a function of one body on many bodies, with one array for every element of its arrays.

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
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from angler_kernels.lanes.folding import fold
from angler_kernels.lanes.shaping import SHAPING, Rule, from_array
from angler_kernels.lanes.table import LookupTable
from angler_kernels.lanes.trees import Elements, any_lane, flatten, split, spread


def apply(function: Callable[..., Any], *args: Any) -> Any:
    """Evaluate ``function`` of one body on lanes.

    Args:
        function: of one body, in JAX; see the list of rules below for what it may use.
        *args: pytrees as the function takes them, each leaf [...] an object array [...] of lanes
            (from `split`), a `LookupTable`, or a number that is the same for all.

    Returns:
        The function's result, each leaf [...] an object array [...] of lanes.
    """
    leaves, tree = jax.tree.flatten(args)
    elements = [leaf if isinstance(leaf, LookupTable) else _elements(leaf) for leaf in leaves]
    shapes = [jax.ShapeDtypeStruct(leaf.shape, _dtype(leaf)) for leaf in elements]
    closed, out = jax.make_jaxpr(function, return_shape=True)(*jax.tree.unflatten(tree, shapes))
    return jax.tree.unflatten(jax.tree.structure(out), _follow(closed, elements))


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
    if isinstance(leaf, LookupTable):
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
            return from_array(np.asarray(var.val, aval.dtype))
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
    try:
        shape = np.broadcast_shapes(*(var.aval.shape for var in eqn.invars))
    except ValueError:
        return False
    if shape != eqn.outvars[0].aval.shape:
        return False
    return shape == () or _takes_numbers(
        eqn.primitive, tuple(var.aval.dtype for var in eqn.invars), tuple(eqn.params.items())
    )


@cache
def _takes_numbers(primitive: Any, dtypes: tuple[Any, ...], params: tuple[Any, ...]) -> bool:
    """Whether an operation is one on numbers too."""
    numbers = [jax.ShapeDtypeStruct((), dtype) for dtype in dtypes]
    try:
        jax.eval_shape(partial(primitive.bind, **dict(params)), *numbers)
    except (TypeError, ValueError, IndexError):
        return False
    return True


def _closed_over(value: Any) -> Elements:
    """What a function holds beside its arguments: numbers, or arrays that are the same for all."""
    if isinstance(value, jax.core.Tracer):
        return split(value, 0)
    return from_array(np.asarray(value))


def _elementwise(eqn: Any, operands: Sequence[Elements]) -> Elements:
    """One operation on each element; operands are broadcast as numpy would."""
    out = np.empty(eqn.outvars[0].aval.shape, object)
    whole = (x.whole() if isinstance(x, LookupTable) else x for x in operands)
    operands = [np.broadcast_to(x, out.shape) for x in whole]
    for index in np.ndindex(*out.shape):
        out[index] = fold(eqn, [operand[index] for operand in operands])
    return out


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


RULES: dict[str, Rule] = {
    **SHAPING,
    "jit": _call,
    "pjit": _call,
    "custom_jvp_call": _call,
    "custom_vjp_call": _call,
    "while": _while,
    "scan": _scan,
}
