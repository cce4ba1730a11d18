"""Operations on whole lanes, omitted where constants determine the result."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


@dataclass(frozen=True, kw_only=True)
class Instructions:
    """Instructions that a compiler does not choose by itself."""

    reciprocal: Callable[[jax.Array], jax.Array]
    """1 / x of float32 lanes."""
    multiply_add: Callable[[jax.Array, jax.Array, jax.Array], jax.Array]
    """Returns a b + c of float32 lanes, rounded once."""


@dataclass(frozen=True, kw_only=True)
class _Product:
    """Lanes that are ``sign * a * b``."""

    lanes: jax.Array
    """Kept, so that no other lanes get its identity."""
    a: jax.Array
    b: jax.Array
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


_CONSTANT: dict[str, Callable[..., Any]] = {
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


def fold_operation(eqn: Any, operands: Sequence[Any]) -> Any:
    """Apply one operation to one element.

    Args:
        eqn: the jaxpr's equation.
        operands: lanes, or numpy numbers that are the same for all.

    Returns:
        Lanes or a numpy number.
    """
    name = eqn.primitive.name
    constant = [isinstance(x, np.generic) for x in operands]
    if all(constant):
        return _evaluate_constants(eqn, operands)
    folded = _fold_constants(name, operands, constant)
    if folded is not None:
        return folded
    return _bind_operation(eqn.primitive, eqn.params, operands)


def apply_binary(primitive: Any, a: Any, b: Any) -> Any:
    """Apply a binary operation that needs no parameter."""
    folded = _fold_constants(primitive.name, (a, b), [isinstance(x, np.generic) for x in (a, b)])
    if folded is not None:
        return folded
    if isinstance(a, np.generic) and isinstance(b, np.generic):
        return _CONSTANT[primitive.name](a, b)
    return _bind_operation(primitive, {}, (a, b))


def _evaluate_constants(eqn: Any, operands: Sequence[Any]) -> Any:
    name, dtype = eqn.primitive.name, eqn.outvars[0].aval.dtype
    if name in _CONSTANT:
        return _CONSTANT[name](*operands).astype(dtype)
    if name == "convert_element_type":
        return operands[0].astype(dtype)
    with jax.ensure_compile_time_eval():
        value = eqn.primitive.bind(*(jnp.asarray(x) for x in operands), **eqn.params)
        return np.asarray(value, dtype)[()]


_NEUTRAL_CONSTANTS = {("add", 0), ("sub", 0), ("mul", 1), ("div", 1)}
"""Operations with a second constant whose result is their first operand."""

_ABSORBING_CONSTANTS = {("mul", 0), ("div", 0)}
"""Operations with a first constant whose result is that constant."""


def _fold_constants(name: str, x: Sequence[Any], constant: Sequence[bool]) -> Any:
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
    return -other if (name, c) == ("sub", 0) and constant[0] else None


def _bind_operation(primitive: Any, params: dict[str, Any], operands: Sequence[Any]) -> Any:
    target = _target.get()
    if target is None or any(x.dtype != np.float32 for x in operands):
        return _bind_plain(primitive, params, operands)
    name = primitive.name
    if name == "div" and np.shape(operands[1]) != ():
        return _bind_quotient(target.instructions, *operands)
    if name in ("add", "sub") and (fused := _fuse_product(target, name, *operands)) is not None:
        return fused
    result = _bind_plain(primitive, params, operands)
    _record_product(target, name, params, operands, result)
    return result


def _bind_plain(primitive: Any, params: dict[str, Any], operands: Sequence[Any]) -> Any:
    return primitive.bind(*_broadcast_operands(*operands), **params)


def _broadcast_operands(*operands: Any) -> list[jax.Array]:
    """Broadcast all operands to the widest."""
    lanes = np.broadcast_shapes(*(np.shape(x) for x in operands))
    return [
        x if np.shape(x) == lanes and isinstance(x, jax.Array) else jnp.broadcast_to(x, lanes)
        for x in operands
    ]


def _bind_quotient(instructions: Instructions, a: Any, b: Any) -> Any:
    """Return ``a / b`` by a reciprocal."""
    inverse = instructions.reciprocal(b)
    return (
        inverse if isinstance(a, np.generic) and a == 1 else apply_binary(jax.lax.mul_p, inverse, a)
    )


def _fuse_product(target: _Target, name: str, x: Any, y: Any) -> Any:
    """Return ``x + y`` or ``x - y`` where one of them is a product; None where none is."""
    flip = -1 if name == "sub" else 1
    if (product := target.products.get(id(y))) is not None:
        sign, rest = flip * product.sign, x
    elif (product := target.products.get(id(x))) is not None:
        sign, rest = product.sign, (-y if flip < 0 else y)
    else:
        return None
    a, b, c = _broadcast_operands(product.a if sign > 0 else -product.a, product.b, rest)
    return target.instructions.multiply_add(a, b, c)


def _record_product(
    target: _Target, name: str, params: dict[str, Any], operands: Sequence[Any], result: Any
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
