"""One operation on whole lanes, left out where constants say what comes of it."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

type Reciprocal = Callable[[jax.Array], jax.Array]

_reciprocal: ContextVar[Reciprocal | None] = ContextVar("reciprocal", default=None)


@contextmanager
def reciprocals(by: Reciprocal) -> Iterator[None]:
    """Within it, float32 lanes are divided by multiplying with a reciprocal of ``by``'s making.

    For compilers whose own division takes care of denormal numbers that bodies in water never see.
    """
    token = _reciprocal.set(by)
    try:
        yield
    finally:
        _reciprocal.reset(token)


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


def fold(eqn: Any, operands: Sequence[Any]) -> Any:
    """One operation on one element.

    Args:
        eqn: the jaxpr's equation.
        operands: lanes, or numpy numbers that are the same for all.

    Returns:
        Lanes or a numpy number.
    """
    name = eqn.primitive.name
    constant = [isinstance(x, np.generic) for x in operands]
    if all(constant):
        return _all_constant(eqn, operands)
    known = _with_constants(name, operands, constant)
    if known is not None:
        return known
    return _bind(eqn.primitive, eqn.params, operands)


def two(primitive: Any, a: Any, b: Any) -> Any:
    """One of the two-operand operations in which no parameter is needed."""
    known = _with_constants(primitive.name, (a, b), [isinstance(x, np.generic) for x in (a, b)])
    if known is not None:
        return known
    if isinstance(a, np.generic) and isinstance(b, np.generic):
        return _CONSTANT[primitive.name](a, b)
    return _bind(primitive, {}, (a, b))


def _all_constant(eqn: Any, operands: Sequence[Any]) -> Any:
    name, dtype = eqn.primitive.name, eqn.outvars[0].aval.dtype
    if name in _CONSTANT:
        return _CONSTANT[name](*operands).astype(dtype)
    if name == "convert_element_type":
        return operands[0].astype(dtype)
    with jax.ensure_compile_time_eval():
        value = eqn.primitive.bind(*(jnp.asarray(x) for x in operands), **eqn.params)
        return np.asarray(value, dtype)[()]


_LEAVES_OTHER = {("add", 0), ("sub", 0), ("mul", 1), ("div", 1)}
"""Operations with a second constant that give their first operand."""

_DECIDES = {("mul", 0), ("div", 0)}
"""Operations with a first constant that give that constant."""


def _with_constants(name: str, x: Sequence[Any], constant: Sequence[bool]) -> Any:
    """What follows from a constant operand alone; None if nothing does."""
    if name == "select_n" and constant[0]:
        return x[1 + int(x[0])]
    if name not in ("add", "sub", "mul", "div", "and", "or") or not any(constant):
        return None
    c, other = (x[0], x[1]) if constant[0] else (x[1], x[0])
    if isinstance(c, np.bool_):
        return other if bool(c) == (name == "and") else c
    commutes = name in ("add", "mul")
    if (name, c) in _LEAVES_OTHER and (constant[1] or commutes):
        return other
    if (name, c) in _DECIDES and (constant[0] or commutes):
        return c
    return -other if (name, c) == ("sub", 0) and constant[0] else None


def _bind(primitive: Any, params: dict[str, Any], operands: Sequence[Any]) -> Any:
    if primitive.name == "div" and (quotient := _quotient(*operands)) is not None:
        return quotient
    lanes = np.broadcast_shapes(*(np.shape(x) for x in operands))
    spread = [
        x if np.shape(x) == lanes and isinstance(x, jax.Array) else jnp.broadcast_to(x, lanes)
        for x in operands
    ]
    return primitive.bind(*spread, **params)


def _quotient(a: Any, b: Any) -> Any:
    """``a / b`` by the reciprocal in force; None where there is none."""
    by = _reciprocal.get()
    if by is None or b.dtype != np.float32 or np.shape(b) == ():
        return None
    one = isinstance(a, np.generic) and a == 1
    return by(b) if one else by(b) * a
