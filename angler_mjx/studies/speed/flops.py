"""Floating-point operations of a function, each value counted once, loops as often as they run.

XLA's own cost analysis counts the body of a loop once, however often it runs, does not see into
kernels, and counts a value again in every fusion that computes it anew. For a simulation of
many steps the first makes it far too small, and the last would make a wasteful program look near
to its device's limit. Here the function is read as it is written (its jaxpr): what nobody uses and
what was computed before is left out, and a scan counts as often as it runs.

An addition, subtraction, multiplication, division, minimum or maximum of floats is one operation,
and so is a root or a transcendental function. Comparisons, selections, integers and conversions
count nothing. A loop that runs until something happens counts once, and of two branches the cheaper
one, so the sum is then the least that there can be.
"""

import math
from collections.abc import Callable, Hashable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal, Var

_ARITHMETIC = frozenset(
    (
        *("add", "add_any", "sub", "mul", "div", "max", "min", "rem", "square", "sqrt", "rsqrt"),
        *("cbrt", "exp", "exp2", "expm1", "log", "log1p", "logistic", "pow", "erf", "erfc"),
        *("sin", "cos", "tan", "asin", "acos", "atan", "atan2"),
        *("sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
    )
)
_REDUCTIONS = frozenset(("reduce_sum", "reduce_prod", "reduce_max", "reduce_min"))
_SCANS = frozenset(("cumsum", "cumprod", "cummax", "cummin"))
_OPAQUE = frozenset(
    ("cuda_kernel", "cuda_block", "pallas_call", "ffi_call", "conv_general_dilated")
)


@dataclass(frozen=True)
class OperationCount:
    """Operations of a function."""

    flops: float | None
    """None where they cannot be counted."""
    how: str
    """How they were counted, or why they were not."""


class _OpaqueError(Exception):
    """Something that cannot be looked into."""


def count_operations(function: Callable[..., object], *arguments: object) -> OperationCount:
    """Operations of one call; nothing is compiled or computed.

    Args:
        function: to be traced.
        *arguments: arrays, or their shapes and types.
    """
    reader = _OperationCounter()
    try:
        flops = reader.flops(jax.make_jaxpr(function)(*arguments).jaxpr)
    except _OpaqueError as error:
        return OperationCount(None, f"not counted: nothing can see into {error}")
    if reader.is_lower_bound:
        return OperationCount(
            flops,
            "at least: loops that run until something happens count once, branches as the cheapest",
        )
    return OperationCount(flops, "loops as often as they run")


class _OperationCounter:
    """Walks through a function and those that it calls."""

    def __init__(self) -> None:
        self.is_lower_bound = False
        self._flops_by_id: dict[int, float] = {}
        self._kept: list[Jaxpr] = []

    def flops(self, body: Jaxpr | ClosedJaxpr) -> float:
        """Operations of a jaxpr, closed or not."""
        body = body.jaxpr if isinstance(body, ClosedJaxpr) else body
        if id(body) not in self._flops_by_id:
            # Kept alive: another one must not get its id.
            self._kept.append(body)
            self._flops_by_id[id(body)] = sum(map(self._count_calls, _needed_equations(body)))
        return self._flops_by_id[id(body)]

    def _count_calls(self, equation: JaxprEqn) -> float:
        """Operations of one equation with all that it calls."""
        name, parameters = equation.primitive.name, equation.params
        if name in _OPAQUE:
            raise _OpaqueError(name)
        match name:
            case "scan":
                return float(parameters["length"]) * self.flops(parameters["jaxpr"])
            case "while":
                self.is_lower_bound = True
                return self.flops(parameters["body_jaxpr"]) + self.flops(parameters["cond_jaxpr"])
            case "cond":
                self.is_lower_bound = True
                return min(self.flops(branch) for branch in parameters["branches"])
        inner = parameters.get("jaxpr", parameters.get("call_jaxpr"))
        if inner is not None:
            return self.flops(inner)
        return _count_equation(equation)


def _count_equation(equation: JaxprEqn) -> float:
    """Operations of an equation that calls nothing."""
    name, out = equation.primitive.name, equation.outvars[0].aval
    if not jnp.issubdtype(getattr(out, "dtype", jnp.int32), jnp.floating):
        return 0.0
    size = math.prod(_shape(equation.outvars[0]))
    if name in _ARITHMETIC:
        return float(size)
    if name == "integer_pow":
        power: int = abs(equation.params["y"])
        # By repeated squaring, and one more for the reciprocal.
        each = power.bit_length() + power.bit_count() - 2 + (equation.params["y"] < 0)
        return float(size * each)
    if name in _SCANS:
        return float(size)
    if name in _REDUCTIONS:
        return float(math.prod(_shape(equation.invars[0])) - size)
    if name == "dot_general":
        (summed, _), _ = equation.params["dimension_numbers"]
        left = _shape(equation.invars[0])
        return float(2 * size * math.prod(left[axis] for axis in summed))
    if name == "scatter-add":
        return float(math.prod(_shape(equation.invars[2])))
    return 0.0


def _shape(x: Var | Literal) -> tuple[int, ...]:
    shape: tuple[int, ...] = getattr(x.aval, "shape", ())
    return shape


def _needed_equations(body: Jaxpr) -> list[JaxprEqn]:
    """Equations of a jaxpr that are used in the end, without those that say what one before did."""
    same: dict[Var, Var] = {}
    first: dict[Hashable, list[Var]] = {}
    kept = []
    for equation in body.eqns:
        key = (
            equation.primitive.name,
            tuple(_variable_key(x, same) for x in equation.invars),
            tuple(sorted((k, _parameter_key(v)) for k, v in equation.params.items())),
        )
        if key in first and not equation.effects:
            same.update(zip(equation.outvars, first[key], strict=True))
            continue
        first[key] = equation.outvars
        kept.append(equation)
    used = {_variable_key(x, same) for x in body.outvars}
    needed = []
    for equation in reversed(kept):
        if equation.effects or any(_variable_key(x, same) in used for x in equation.outvars):
            used.update(_variable_key(x, same) for x in equation.invars)
            needed.append(equation)
    return needed


def _variable_key(x: Var | Literal, same: dict[Var, Var]) -> Hashable:
    """What stands for a variable or a literal in comparisons."""
    if isinstance(x, Literal):
        return ("literal", str(x.aval), repr(x.val))
    return id(same.get(x, x))


def _parameter_key(parameter: object) -> str:
    """What stands for a parameter in comparisons; functions are the same only if they are one."""
    if isinstance(parameter, (int, float, str, bool, tuple, type(None))) and not _holds_equations(
        parameter
    ):
        return repr(parameter)
    return f"{type(parameter).__name__} {id(parameter)}"


def _holds_equations(parameter: object) -> bool:
    """Whether there is a function in a tuple, whose text would be long."""
    return isinstance(parameter, tuple) and any(hasattr(part, "eqns") for part in parameter)
