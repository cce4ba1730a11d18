"""Operations on whole lanes, omitted where constants determine the result."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import JaxprEqn, Primitive

from angler_kernels.lanes.table import LaneValue
from angler_kernels.lanes.trees import aval_of


@dataclass(frozen=True, kw_only=True)
class Instructions:
    """Instructions that a compiler does not choose by itself."""

    reciprocal: Callable[[jax.Array], jax.Array]
    """1 / x of float32 lanes."""
    multiply_add: Callable[[jax.Array, jax.Array, jax.Array], jax.Array]
    """Returns a b + c of float32 lanes, rounded once."""


@dataclass(frozen=True, kw_only=True)
class _Product:
    """LaneValue that are ``sign * a * b``."""

    lanes: jax.Array
    """Kept, so that no other lanes get its identity."""
    a: LaneValue
    b: LaneValue
    sign: int


@dataclass(frozen=True, kw_only=True)
class _Target:
    instructions: Instructions
    products: dict[int, _Product] = field(default_factory=dict)


_target: ContextVar[_Target | None] = ContextVar("target", default=None)


@contextmanager
def use_instructions(instructions: Instructions) -> Iterator[None]:
    """Divide float32 lanes by reciprocals and fuse sums of products, within the context.

    For compilers whose division takes care of denormal numbers that bodies in water never see, and
    that keep multiplication and addition apart.
    """
    token = _target.set(_Target(instructions=instructions))
    try:
        yield
    finally:
        _target.reset(token)


_CONSTANT: dict[str, np.ufunc] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "neg": np.negative,
    "lt": np.less,
    "le": np.less_equal,
    "gt": np.greater,
    "ge": np.greater_equal,
    "eq": np.equal,
    "ne": np.not_equal,
    "and": np.bitwise_and,
    "or": np.bitwise_or,
    "max": np.maximum,
    "min": np.minimum,
    "abs": np.abs,
}


def fold_operation(eqn: JaxprEqn, operands: Sequence[LaneValue]) -> LaneValue:
    """Apply one operation to one element.

    Args:
        eqn: the jaxpr's equation.
        operands: lanes, or numpy numbers that are the same for all.

    Returns:
        LaneValue or a numpy number.
    """
    name = eqn.primitive.name
    constant = [isinstance(x, np.generic) for x in operands]
    if all(constant):
        return _evaluate_constants(eqn, operands)
    folded = _fold_constants(name, operands, constant)
    if folded is not None:
        return folded
    return _bind_operation(eqn.primitive, eqn.params, operands)


def apply_binary(primitive: Primitive, a: LaneValue, b: LaneValue) -> LaneValue:
    """Apply a binary operation that needs no parameter."""
    folded = _fold_constants(primitive.name, (a, b), [isinstance(x, np.generic) for x in (a, b)])
    if folded is not None:
        return folded
    if isinstance(a, np.generic) and isinstance(b, np.generic):
        constant: LaneValue = _CONSTANT[primitive.name](a, b)
        return constant
    return _bind_operation(primitive, {}, (a, b))


def _evaluate_constants(eqn: JaxprEqn, operands: Sequence[LaneValue]) -> LaneValue:
    name, dtype = eqn.primitive.name, aval_of(eqn.outvars[0]).dtype
    value: LaneValue
    if name in _CONSTANT:
        value = _CONSTANT[name](*operands).astype(dtype)
    elif name == "convert_element_type":
        value = operands[0].astype(dtype)
    else:
        with jax.ensure_compile_time_eval():
            result = eqn.primitive.bind(*(jnp.asarray(x) for x in operands), **eqn.params)
            value = np.asarray(result, dtype).ravel()[0]
    return value


_NEUTRAL_CONSTANTS: set[tuple[str, object]] = {("add", 0), ("sub", 0), ("mul", 1), ("div", 1)}
"""Operations with a second constant whose result is their first operand."""

_ABSORBING_CONSTANTS: set[tuple[str, object]] = {("mul", 0), ("div", 0)}
"""Operations with a first constant whose result is that constant."""


def _fold_constants(
    name: str, x: Sequence[LaneValue], constant: Sequence[bool]
) -> LaneValue | None:
    """Return the result that a constant operand alone determines; None if there is none."""
    if name == "select_n" and constant[0]:
        return x[1 + int(x[0])]
    if name not in ("add", "sub", "mul", "div", "and", "or") or not any(constant):
        return None
    c, other = (x[0], x[1]) if constant[0] else (x[1], x[0])
    if isinstance(c, np.bool_):
        return other if bool(c) == (name == "and") else c
    commutes = name in ("add", "mul")
    if (name, c) in _NEUTRAL_CONSTANTS and (constant[1] or commutes):
        return other
    if (name, c) in _ABSORBING_CONSTANTS and (constant[0] or commutes):
        return c
    if name == "sub" and c == 0 and constant[0]:
        return _negate(other)
    return None


def _negate(x: LaneValue) -> LaneValue:
    """Return ``-x`` of a number."""
    if isinstance(x, np.bool_):
        raise TypeError("a truth value has no sign")
    return -x


def _bind_operation(
    primitive: Primitive, params: Mapping[str, object], operands: Sequence[LaneValue]
) -> LaneValue:
    target = _target.get()
    if target is None or any(x.dtype != np.float32 for x in operands):
        return _bind_plain(primitive, params, operands)
    name = primitive.name
    if name == "div" and isinstance(operands[1], jax.Array) and operands[1].shape != ():
        return _bind_quotient(target.instructions, operands[0], operands[1])
    if name in ("add", "sub") and (fused := _fuse_product(target, name, *operands)) is not None:
        return fused
    result = _bind_plain(primitive, params, operands)
    _record_product(target, name, params, operands, result)
    return result


def _bind_plain(
    primitive: Primitive, params: Mapping[str, object], operands: Sequence[LaneValue]
) -> jax.Array:
    result: jax.Array = primitive.bind(*_broadcast_operands(*operands), **params)
    return result


def _broadcast_operands(*operands: LaneValue) -> list[jax.Array]:
    """Broadcast all operands to the widest."""
    lanes = np.broadcast_shapes(*(np.shape(x) for x in operands))
    return [
        x if np.shape(x) == lanes and isinstance(x, jax.Array) else jnp.broadcast_to(x, lanes)
        for x in operands
    ]


def _bind_quotient(instructions: Instructions, a: LaneValue, b: jax.Array) -> LaneValue:
    """Return ``a / b`` by a reciprocal."""
    inverse = instructions.reciprocal(b)
    return (
        inverse if isinstance(a, np.generic) and a == 1 else apply_binary(jax.lax.mul_p, inverse, a)
    )


def _fuse_product(target: _Target, name: str, x: LaneValue, y: LaneValue) -> jax.Array | None:
    """Return ``x + y`` or ``x - y`` where one of them is a product; None where none is."""
    flip = -1 if name == "sub" else 1
    if (product := target.products.get(id(y))) is not None:
        sign, rest = flip * product.sign, x
    elif (product := target.products.get(id(x))) is not None:
        sign, rest = product.sign, (_negate(y) if flip < 0 else y)
    else:
        return None
    a, b, c = _broadcast_operands(product.a if sign > 0 else _negate(product.a), product.b, rest)
    return target.instructions.multiply_add(a, b, c)


def _record_product(
    target: _Target,
    name: str,
    params: Mapping[str, object],
    operands: Sequence[LaneValue],
    result: jax.Array,
) -> None:
    """Record the factors of a product, in case it is added to something."""
    if np.shape(result) == ():
        return
    sign = 1
    if name == "mul":
        a, b = operands
    elif name == "square" or (name == "integer_pow" and params["y"] == 2):
        a = b = operands[0]
    elif name == "neg" and (product := target.products.get(id(operands[0]))) is not None:
        a, b, sign = product.a, product.b, -product.sign
    else:
        return
    target.products[id(result)] = _Product(lanes=result, a=a, b=b, sign=sign)
