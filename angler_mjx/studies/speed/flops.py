"""Floating-point operations of a function, each value counted once, loops as often as they run.

XLA's own cost analysis counts the body of a loop once, however often it runs, does not see into
Pallas kernels, and counts a value again in every fusion that computes it anew. For a simulation of
many steps the first makes it far too small, and the last would make a wasteful program look near
to its device's limit. Here the function is read as it is written (its jaxpr): what nobody uses and
what was computed before is left out, and a scan counts as often as it runs.

An addition, subtraction, multiplication, division, minimum or maximum of floats is one operation,
and so is a root or a transcendental function. Comparisons, selections, integers and conversions
count nothing. A loop that runs until something happens counts once, and of two branches the cheaper
one, so the sum is then the least that there can be.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

_ARITHMETIC = frozenset(
    (
        *("add", "add_any", "sub", "mul", "div", "max", "min", "rem", "square", "sqrt", "rsqrt"),
        *("cbrt", "exp", "exp2", "expm1", "log", "log1p", "logistic", "pow", "erf", "erfc"),
        *("sin", "cos", "tan", "asin", "acos", "atan", "atan2"),
        *("sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
    )
)
_REDUCTIONS = frozenset(("reduce_sum", "reduce_prod", "reduce_max", "reduce_min"))
_RUNNING = frozenset(("cumsum", "cumprod", "cummax", "cummin"))
_OPAQUE = frozenset(("pallas_call", "triton_call", "ffi_call", "conv_general_dilated"))


@dataclass(frozen=True)
class OperationCount:
    """Operations of a function."""

    flops: float | None
    """None where they cannot be counted."""
    how: str
    """How they were counted, or why they were not."""


class _OpaqueError(Exception):
    """Something that cannot be looked into."""


def count(function: Callable[..., Any], *arguments: Any) -> OperationCount:
    """Operations of one call; nothing is compiled or computed.

    Args:
        function: to be traced.
        *arguments: arrays, or their shapes and types.
    """
    reader = _Reader()
    try:
        flops = reader.flops(jax.make_jaxpr(function)(*arguments).jaxpr)
    except _OpaqueError as error:
        return OperationCount(None, f"not counted: nothing can see into {error}")
    if reader.at_least:
        return OperationCount(
            flops,
            "at least: loops that run until something happens count once, branches as the cheapest",
        )
    return OperationCount(flops, "loops as often as they run")


class _Reader:
    """Walks through a function and those that it calls."""

    def __init__(self) -> None:
        self.at_least = False
        self._known: dict[int, float] = {}
        self._kept: list[Any] = []

    def flops(self, body: Any) -> float:
        """Operations of a jaxpr, closed or not."""
        body = getattr(body, "jaxpr", body)
        if id(body) not in self._known:
            # Kept alive: another one must not get its id.
            self._kept.append(body)
            self._known[id(body)] = sum(map(self._of, _needed(body)))
        return self._known[id(body)]

    def _of(self, equation: Any) -> float:
        """Operations of one equation with all that it calls."""
        name, given = equation.primitive.name, equation.params
        if name in _OPAQUE:
            raise _OpaqueError(name)
        match name:
            case "scan":
                return float(given["length"]) * self.flops(given["jaxpr"])
            case "while":
                self.at_least = True
                return self.flops(given["body_jaxpr"]) + self.flops(given["cond_jaxpr"])
            case "cond":
                self.at_least = True
                return min(self.flops(branch) for branch in given["branches"])
        inner = given.get("jaxpr", given.get("call_jaxpr"))
        if inner is not None:
            return self.flops(inner)
        return _simple(equation)


def _simple(equation: Any) -> float:
    """Operations of an equation that calls nothing."""
    name, out = equation.primitive.name, equation.outvars[0].aval
    if not jnp.issubdtype(getattr(out, "dtype", jnp.int32), jnp.floating):
        return 0.0
    size: int = math.prod(out.shape)
    if name in _ARITHMETIC:
        return float(size)
    if name == "integer_pow":
        power: int = abs(equation.params["y"])
        # By repeated squaring, and one more for the reciprocal.
        each = power.bit_length() + power.bit_count() - 2 + (equation.params["y"] < 0)
        return float(size * each)
    if name in _RUNNING:
        return float(size)
    if name in _REDUCTIONS:
        return float(math.prod(equation.invars[0].aval.shape) - size)
    if name == "dot_general":
        (summed, _), _ = equation.params["dimension_numbers"]
        left = equation.invars[0].aval.shape
        return float(2 * size * math.prod(left[axis] for axis in summed))
    if name == "scatter-add":
        return float(math.prod(equation.invars[2].aval.shape))
    return 0.0


def _needed(body: Any) -> list[Any]:
    """Equations of a jaxpr that are used in the end, without those that say what one before did."""
    same: dict[Any, Any] = {}
    first: dict[Any, list[Any]] = {}
    kept = []
    for equation in body.eqns:
        key = (
            equation.primitive.name,
            tuple(_name(x, same) for x in equation.invars),
            tuple(sorted((k, _value(v)) for k, v in equation.params.items())),
        )
        if key in first and not equation.effects:
            same.update(zip(equation.outvars, first[key], strict=True))
            continue
        first[key] = equation.outvars
        kept.append(equation)
    used = {_name(x, same) for x in body.outvars}
    needed = []
    for equation in reversed(kept):
        if equation.effects or any(_name(x, same) in used for x in equation.outvars):
            used.update(_name(x, same) for x in equation.invars)
            needed.append(equation)
    return needed


def _name(x: Any, same: dict[Any, Any]) -> Any:
    """What stands for a variable or a literal in comparisons."""
    if hasattr(x, "val"):
        return ("literal", str(x.aval), repr(x.val))
    return id(same.get(x, x))


def _value(parameter: Any) -> str:
    """What stands for a parameter in comparisons; functions are the same only if they are one."""
    if isinstance(parameter, (int, float, str, bool, tuple, type(None))) and not _holds(parameter):
        return repr(parameter)
    return f"{type(parameter).__name__} {id(parameter)}"


def _holds(parameter: Any) -> bool:
    """Whether there is a function in a tuple, whose text would be long."""
    return isinstance(parameter, tuple) and any(hasattr(part, "eqns") for part in parameter)
