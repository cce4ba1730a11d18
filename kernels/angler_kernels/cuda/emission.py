"""CUDA C of a traced kernel: a thread for each lane, and a local variable for each result.

A kernel is traced with lanes [n] and with references to flat arrays. In C, lanes are numbers of one
thread. Lanes are independent: kernels reduce them only to skip or to end what no lane needs, and
mask what is left (`angler_kernels.lanes.any_lane`), so that each thread decides for its own lane.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal, Var

from angler_kernels.lanes.trees import UnsupportedOperationError, naming_source

TYPES = {
    np.dtype(np.float32): "float",
    np.dtype(np.float64): "double",
    np.dtype(np.int32): "int",
    np.dtype(np.uint32): "unsigned",
    np.dtype(np.int8): "signed char",
    np.dtype(np.uint8): "unsigned char",
    np.dtype(np.bool_): "bool",
}
"""C types of numbers."""

PRELUDE = """\
#define DEVICE __device__ __forceinline__
DEVICE float max_(float a, float b) {
  float c; asm("max.NaN.f32 %0, %1, %2;" : "=f"(c) : "f"(a), "f"(b)); return c; }
DEVICE float min_(float a, float b) {
  float c; asm("min.NaN.f32 %0, %1, %2;" : "=f"(c) : "f"(a), "f"(b)); return c; }
DEVICE float reciprocal_(float a) {
  float c; asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(c) : "f"(a)); return c; }
DEVICE float multiply_add_(float a, float b, float c) { return __fmaf_rn(a, b, c); }
template <class T> DEVICE T max_(T a, T b) { return a != a || a > b ? a : b; }
template <class T> DEVICE T min_(T a, T b) { return a != a || a < b ? a : b; }
template <class T> DEVICE T sign_(T a) { return a > 0 ? T(1) : a < 0 ? T(-1) : a; }
"""
"""What every kernel's source begins with."""

_OPERATORS = {
    "add": "+",
    "sub": "-",
    "mul": "*",
    "div": "/",
    "and": "&",
    "or": "|",
    "xor": "^",
    "lt": "<",
    "le": "<=",
    "gt": ">",
    "ge": ">=",
    "eq": "==",
    "ne": "!=",
    "shift_left": "<<",
    "shift_right_arithmetic": ">>",
}
_FUNCTIONS = {
    "max": "max_",
    "min": "min_",
    "sign": "sign_",
    "abs": "abs",
    "multiply_add": "multiply_add_",
    "approximate_reciprocal": "reciprocal_",
    "population_count": "__popc",
    "clz": "__clz",
} | {
    name: name
    for name in (
        *("floor", "ceil", "sqrt", "rsqrt", "cbrt", "exp", "exp2", "log", "log1p", "expm1", "pow"),
        *("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "erf"),
    )
}
_REDUCTIONS = {"reduce_max", "reduce_min", "reduce_or", "reduce_and"}
_UNCHANGED = {
    "broadcast_in_dim",
    "reshape",
    "squeeze",
    "copy",
    "copy_p",
    "stop_gradient",
    "optimization_barrier",
    "new_ref",
    "freeze",
}
_CALLS = {"jit": "jaxpr", "pjit": "jaxpr", "custom_jvp_call": "call_jaxpr"}


@dataclass(frozen=True, kw_only=True)
class KernelArray:
    """Flat array of a kernel."""

    name: str
    """Of its pointer."""
    dtype: np.dtype
    size: int
    is_written: bool


@dataclass(frozen=True, kw_only=True)
class KernelCode:
    """Source of a kernel."""

    text: str
    operations: int
    """Statements that compute something."""


def emit_kernel(
    name: str,
    closed: ClosedJaxpr,
    arrays: Sequence[KernelArray],
    *,
    lanes: int,
) -> KernelCode:
    """Return CUDA C of a kernel whose grid has rows along y.

    Pointers are the arrays', in their order; before those that are written, the same again as
    operands of the call, which are the same memory.

    Args:
        name: of the function.
        closed: jaxpr of the lanes' numbers [lanes], the row [], and ``arrays``.
        arrays: those of the kernel, written ones last.
        lanes: of the traced kernel.

    Raises:
        UnsupportedOperationError: the kernel has an operation for which there is no rule.
    """
    emitter = _Emitter(lanes=lanes)
    emitter.emit("const int lane = blockIdx.x * blockDim.x + threadIdx.x;")
    emitter.emit("const int row = blockIdx.y;")
    emitter.run(closed, ["lane", "row", *(array.name for array in arrays)])
    constant = [x for x in arrays if not x.is_written]
    written = [x for x in arrays if x.is_written]
    pointers = [f"const {TYPES[x.dtype]}* __restrict__ {x.name}" for x in constant]
    pointers += [f"const {TYPES[x.dtype]}* {x.name}_operand" for x in written]
    pointers += [f"{TYPES[x.dtype]}* __restrict__ {x.name}" for x in written]
    head = f'extern "C" __global__ void {name}(\n    ' + ",\n    ".join(pointers) + ") {"
    text = "\n".join([PRELUDE + head, *emitter.lines, "}", ""])
    return KernelCode(text=text, operations=emitter.operations)


@dataclass(kw_only=True)
class _Emitter:
    """Statements of a kernel, in order."""

    lanes: int
    lines: list[str] = field(default_factory=list)
    operations: int = 0
    _n_names: int = 0
    _depth: int = 1

    def emit(self, text: str) -> None:
        """Add a line."""
        self.lines.append("  " * self._depth + text)

    def run(self, closed: ClosedJaxpr, inputs: Sequence[str]) -> list[str]:
        """Emit all of a jaxpr; return its results."""
        values: dict[Var, str] = dict(zip(closed.jaxpr.invars, inputs, strict=True))
        for var, const in zip(closed.jaxpr.constvars, closed.consts, strict=True):
            number = np.asarray(const)
            if number.size != 1:
                raise ValueError(f"a kernel uses a constant array {number.shape}: pass it instead")
            values[var] = write_number(number.reshape(())[()], number.dtype)
        return self._run_equations(closed.jaxpr, values)

    def _run_equations(self, jaxpr: Jaxpr, values: dict[Var, str]) -> list[str]:
        def read(x: Var | Literal) -> str:
            return write_number(x.val, array_of(x).dtype) if isinstance(x, Literal) else values[x]

        for eqn in jaxpr.eqns:
            with naming_source(eqn):
                results = self._run_equation(eqn, [read(x) for x in eqn.invars])
            values.update(zip(eqn.outvars, results, strict=True))
        return [read(x) for x in jaxpr.outvars]

    def _run_equation(self, eqn: JaxprEqn, operands: list[str]) -> list[str]:
        name = eqn.primitive.name
        if name in _UNCHANGED:
            return [operands[0]]
        if name in _CALLS:
            inner = eqn.params[_CALLS[name]]
            return self.run(
                inner if isinstance(inner, ClosedJaxpr) else ClosedJaxpr(inner, []), operands
            )
        if name in _REDUCTIONS:
            return [self._reduce(eqn, operands[0])]
        structured = _STRUCTURED.get(name)
        if structured is not None:
            return structured(self, eqn, operands)
        return [self._declare_elementwise(eqn, operands)]

    def _declare_elementwise(self, eqn: JaxprEqn, operands: Sequence[str]) -> str:
        """Declare the result of an operation on each lane by itself."""
        name, out = eqn.primitive.name, eqn.outvars[0]
        if name in _OPERATORS:
            template: Callable[[JaxprEqn, Sequence[str]], str] = _write_operator
        elif name in _FUNCTIONS:
            template = _write_function
        else:
            expression = _EXPRESSIONS.get(name)
            if expression is None:
                raise UnsupportedOperationError(eqn, "no CUDA C for")
            template = expression
        return self._declare(out, template(eqn, operands))

    def _declare(self, var: Var, value: str) -> str:
        name = self._make_name()
        self.operations += 1
        self.emit(f"const {type_name(var)} {name} = {value};")
        return name

    def _make_name(self) -> str:
        self._n_names += 1
        return f"v{self._n_names}"

    def _declare_variables(self, variables: Sequence[Var]) -> list[str]:
        """Declare variables that are assigned later."""
        names = [self._make_name() for _ in variables]
        for var, name in zip(variables, names, strict=True):
            self.emit(f"{type_name(var)} {name};")
        return names

    def _assign(self, names: Sequence[str], values: Sequence[str]) -> None:
        """Assign to variables, all at once."""
        assigned = []
        for name, value in zip(names, values, strict=True):
            if value in names and value != name:
                copy = self._make_name()
                self.emit(f"const auto {copy} = {value};")
                assigned.append((name, copy))
            elif value != name:
                assigned.append((name, value))
        for name, value in assigned:
            self.emit(f"{name} = {value};")

    def _reduce(self, eqn: JaxprEqn, operand: str) -> str:
        """Return the thread's own number of lanes that are reduced; see the top of the module."""
        if array_of(eqn.invars[0]).size != self.lanes:
            raise UnsupportedOperationError(eqn, "kernels only reduce all lanes:")
        return operand

    def _load(self, eqn: JaxprEqn, x: list[str]) -> list[str]:
        return [self._declare(eqn.outvars[0], f"{x[0]}[{_index(eqn, x, 1)}]")]

    def _store(self, eqn: JaxprEqn, x: list[str]) -> list[str]:
        self.emit(f"{x[0]}[{_index(eqn, x, 2)}] = {x[1]};")
        return ["0"]

    def _branch(self, eqn: JaxprEqn, x: list[str]) -> list[str]:
        branches = eqn.params["branches"]
        names = self._declare_variables(eqn.outvars)
        for k, branch in enumerate(branches):
            test = f"if ({x[0]} {'<=' if k == 0 else '=='} {k}) "
            is_last = k == len(branches) - 1
            self.emit(("else " if k else "") + ("" if is_last and k else test) + "{")
            self._depth += 1
            self._assign(names, self.run(branch, x[1:]))
            self._depth -= 1
            self.emit("}")
        return names

    def _start_loop(self, eqn: JaxprEqn, start: Sequence[str]) -> list[str]:
        names = self._declare_variables(eqn.outvars)
        self._assign(names, start)
        return names

    def _loop_while(self, eqn: JaxprEqn, x: list[str]) -> list[str]:
        n_cond, n_body = eqn.params["cond_nconsts"], eqn.params["body_nconsts"]
        of_cond, of_body = x[:n_cond], x[n_cond : n_cond + n_body]
        names = self._start_loop(eqn, x[n_cond + n_body :])
        self.emit("while (true) {")
        self._depth += 1
        (running,) = self.run(eqn.params["cond_jaxpr"], [*of_cond, *names])
        self.emit(f"if (!{running}) break;")
        self._assign(names, self.run(eqn.params["body_jaxpr"], [*of_body, *names]))
        self._depth -= 1
        self.emit("}")
        return names

    def _loop_times(self, eqn: JaxprEqn, x: list[str]) -> list[str]:
        """Repeat a fixed number of times, without rows that are read or returned."""
        inner, n_const = eqn.params["jaxpr"], len(eqn.invars) - len(eqn.outvars)
        pairs = zip(eqn.outvars, inner.jaxpr.outvars, strict=True)
        if any(array_of(a).shape != array_of(b).shape for a, b in pairs):
            raise UnsupportedOperationError(eqn, "only loops without rows")
        names, count = self._start_loop(eqn, x[n_const:]), self._make_name()
        self.emit(f"for (int {count} = 0; {count} < {eqn.params['length']}; ++{count}) {{")
        self._depth += 1
        self._assign(names, self.run(inner, [*x[:n_const], *names]))
        self._depth -= 1
        self.emit("}")
        return names

    def _raise_to_integer(self, eqn: JaxprEqn, x: list[str]) -> list[str]:
        """Multiply squares, as XLA does."""
        power, out = int(eqn.params["y"]), eqn.outvars[0]
        base, value, left = x[0], "", abs(power)
        one = write_number(1, array_of(out).dtype)
        while left:
            if left & 1:
                value = self._declare(out, f"{value} * {base}") if value else base
            left >>= 1
            if left:
                base = self._declare(out, f"{base} * {base}")
        value = value or one
        return [self._declare(out, f"{one} / {value}") if power < 0 else value]


_STRUCTURED: dict[str, Callable[[_Emitter, JaxprEqn, list[str]], list[str]]] = {
    "get": _Emitter._load,
    "swap": _Emitter._store,
    "cond": _Emitter._branch,
    "while": _Emitter._loop_while,
    "scan": _Emitter._loop_times,
    "integer_pow": _Emitter._raise_to_integer,
}


def array_of(var: Var | Literal) -> jax.core.ShapedArray:
    """Return shape and type of a variable."""
    aval = var.aval
    assert isinstance(aval, jax.core.ShapedArray)
    return aval


def type_name(var: Var | Literal) -> str:
    """Return the C type of a variable."""
    return TYPES[np.dtype(array_of(var).dtype)]


def write_number(value: object, dtype: np.dtype) -> str:
    """Return a number as C reads it back to the last bit."""
    number = np.asarray(value, dtype)[()]
    if dtype == np.bool_:
        return "true" if number else "false"
    if np.issubdtype(dtype, np.integer):
        if number < 0:  # in C, a sign is an operation
            return f"({int(number) + 1} - 1)"
        return f"{int(number)}u" if dtype == np.uint32 else f"{int(number)}"
    if np.isfinite(number):
        text = float(number).hex() + ("f" if dtype == np.float32 else "")
        return f"({text})" if np.signbit(number) else text
    if dtype == np.float32:
        return f"__int_as_float({int(number.view(np.int32))})"
    return f"__longlong_as_double({int(number.view(np.int64))}ll)"


def _index(eqn: JaxprEqn, operands: Sequence[str], first: int) -> str:
    """Return the index of a load or store."""
    (indexer,) = jax.tree.unflatten(eqn.params["tree"], operands[first:])
    (index,) = indexer.indices
    return str(index)


def _write_operator(eqn: JaxprEqn, x: Sequence[str]) -> str:
    return f"{x[0]} {_OPERATORS[eqn.primitive.name]} {x[1]}"


def _write_function(eqn: JaxprEqn, x: Sequence[str]) -> str:
    return f"{_FUNCTIONS[eqn.primitive.name]}({', '.join(x)})"


def _write_select(_: JaxprEqn, x: Sequence[str]) -> str:
    which, *cases = x
    if len(cases) == 2:
        return f"{which} ? {cases[1]} : {cases[0]}"
    value = cases[-1]
    for k in reversed(range(len(cases) - 1)):
        value = f"{which} == {k} ? {cases[k]} : ({value})"
    return value


def _write_cast(eqn: JaxprEqn, x: Sequence[str]) -> str:
    target = type_name(eqn.outvars[0])
    return f"{x[0]} != 0" if target == "bool" else f"({target}){x[0]}"


def _write_bits(eqn: JaxprEqn, x: Sequence[str]) -> str:
    source, target = type_name(eqn.invars[0]), type_name(eqn.outvars[0])
    if target == "float":
        return f"__int_as_float((int){x[0]})"
    return f"({target})__float_as_int({x[0]})" if source == "float" else f"({target}){x[0]}"


def _write_remainder(eqn: JaxprEqn, x: Sequence[str]) -> str:
    is_float = array_of(eqn.outvars[0]).dtype.kind == "f"
    return f"fmod({x[0]}, {x[1]})" if is_float else f"{x[0]} % {x[1]}"


def _write_rounding(eqn: JaxprEqn, x: Sequence[str]) -> str:
    return f"{'rint' if int(eqn.params['rounding_method']) == 1 else 'round'}({x[0]})"


_EXPRESSIONS: dict[str, Callable[[JaxprEqn, Sequence[str]], str]] = {
    "neg": lambda _, x: f"-{x[0]}",
    "not": lambda eqn, x: f"{'!' if type_name(eqn.outvars[0]) == 'bool' else '~'}{x[0]}",
    "square": lambda _, x: f"{x[0]} * {x[0]}",
    "is_finite": lambda _, x: f"{x[0]} - {x[0]} == 0",
    "clamp": lambda _, x: f"min_(max_({x[1]}, {x[0]}), {x[2]})",
    "select_n": _write_select,
    "convert_element_type": _write_cast,
    "bitcast_convert_type": _write_bits,
    "rem": _write_remainder,
    "round": _write_rounding,
    "shift_right_logical": lambda eqn, x: (
        f"({type_name(eqn.outvars[0])})((unsigned){x[0]} >> {x[1]})"
    ),
}
