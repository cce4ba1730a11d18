"""CUDA C of a traced kernel: local variables of threads for its results.

A kernel is traced with lanes [n] and with references to flat arrays. There are two kinds:

    independent lanes   A thread for each lane. Kernels reduce lanes only to skip or to end what no
                        lane needs, and mask what is left (`angler_kernels.lanes.any_lane`), so that
                        each thread decides for its own lane.
    a block             The lanes work on one problem; each thread has one or more of them, and a
                        variable for each. Reductions are over all lanes, and numbers [] are equal
                        in all threads.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal, Var

from angler_kernels.lanes.trees import UnsupportedOperationError, naming_source

type Names = tuple[str, ...]
"""Variables of a value: one, or one for each lane of a thread."""

BARRIER = "barrier"
"""Name of the array that a kernel writes to where the lanes of a block wait for each other."""

TYPES = {
    np.dtype(np.float32): "float",
    np.dtype(np.float64): "double",
    np.dtype(np.float16): "half_",
    np.dtype(np.int32): "int",
    np.dtype(np.uint32): "unsigned",
    np.dtype(np.int8): "signed char",
    np.dtype(np.uint8): "unsigned char",
    np.dtype(np.uint16): "unsigned short",
    np.dtype(np.bool_): "bool",
}
"""C types of numbers."""

INSTRUCTIONS = """\
#define DEVICE __device__ __forceinline__
DEVICE float max_(float a, float b) {
  float c; asm("max.NaN.f32 %0, %1, %2;" : "=f"(c) : "f"(a), "f"(b)); return c; }
DEVICE float min_(float a, float b) {
  float c; asm("min.NaN.f32 %0, %1, %2;" : "=f"(c) : "f"(a), "f"(b)); return c; }
DEVICE float reciprocal_(float a) {
  float c; asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(c) : "f"(a)); return c; }
DEVICE float multiply_add_(float a, float b, float c) { return __fmaf_rn(a, b, c); }
struct half_ {
  unsigned short bits;
  DEVICE half_() {}
  DEVICE explicit half_(float a) { asm("cvt.rn.f16.f32 %0, %1;" : "=h"(bits) : "f"(a)); }
  DEVICE explicit operator float() const {
    float c; asm("cvt.f32.f16 %0, %1;" : "=f"(c) : "h"(bits)); return c; }
};
"""
"""Functions that are instructions of the device, and its numbers of 16 bits."""

PRELUDE = (
    INSTRUCTIONS
    + """\
template <class T> DEVICE T max_(T a, T b) { return a != a || a > b ? a : b; }
template <class T> DEVICE T min_(T a, T b) { return a != a || a < b ? a : b; }
template <class T> DEVICE T sign_(T a) { return a > 0 ? T(1) : a < 0 ? T(-1) : a; }
struct Max_ { template <class T> DEVICE T operator()(T a, T b) const { return max_(a, b); } };
struct Min_ { template <class T> DEVICE T operator()(T a, T b) const { return min_(a, b); } };
struct Or_ { template <class T> DEVICE T operator()(T a, T b) const { return a | b; } };
struct And_ { template <class T> DEVICE T operator()(T a, T b) const { return a & b; } };
template <class T, class F> DEVICE T reduce_(T value, F combine) {
  __shared__ T of_warps[32];
  for (int other = 16; other > 0; other /= 2)
    value = combine(value, __shfl_xor_sync(0xffffffffu, value, other));
  __syncthreads();
  if (threadIdx.x % 32 == 0) of_warps[threadIdx.x / 32] = value;
  __syncthreads();
  value = of_warps[0];
  for (int warp = 1; warp < blockDim.x / 32; ++warp) value = combine(value, of_warps[warp]);
  return value;
}
"""
)
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
_REDUCTIONS = {
    "reduce_max": "Max_",
    "reduce_min": "Min_",
    "reduce_or": "Or_",
    "reduce_and": "And_",
}
_UNCHANGED = {
    "broadcast_in_dim",
    "reshape",
    "squeeze",
    "copy",
    "copy_p",
    "stop_gradient",
    "optimization_barrier",
    "reshard",
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
    threads: int,
) -> KernelCode:
    """Return CUDA C of a kernel of independent lanes, whose grid has rows along y.

    Pointers are the arrays', in their order; before those that are written, the same again as
    operands of the call, which are the same memory.

    Args:
        name: of the function.
        closed: jaxpr of the lanes' numbers [lanes], the row [], and ``arrays``.
        arrays: those of the kernel, written ones last.
        lanes: of the traced kernel.
        threads: of a block.

    Raises:
        UnsupportedOperationError: the kernel has an operation for which there is no rule.
    """
    emitter = _Emitter(lanes=lanes)
    emitter.emit("const int lane = blockIdx.x * blockDim.x + threadIdx.x;")
    emitter.emit("const int row = blockIdx.y;")
    emitter.run(closed, [("lane",), ("row",), *((x.name,) for x in arrays)])
    written = [x for x in arrays if x.is_written]
    pointers = [_pointer(x) for x in arrays if not x.is_written]
    pointers += [f"const {TYPES[x.dtype]}* {x.name}_operand" for x in written]
    pointers += [_pointer(x) for x in written]
    return emitter.finish(name, threads, pointers)


def emit_block(
    name: str,
    closed: ClosedJaxpr,
    arrays: Sequence[KernelArray],
    *,
    lanes: int,
    threads: int,
) -> KernelCode:
    """Return CUDA C of a kernel whose lanes work together on a problem: a block for each.

    Pointers are the arrays', in their order. The source still has to define ``PROBLEM_OF_`` and an
    array's name for each array: which of the problems that stand one after another in the array is
    that of ``block``, the number of the block.

    Args:
        name: of the function.
        closed: jaxpr of ``arrays`` and the barrier.
        arrays: those of a problem, written ones last; never both read from before and written.
        lanes: number of lanes, a multiple of ``threads``.
        threads: of a block, a multiple of 32.

    Raises:
        UnsupportedOperationError: the kernel has an operation for which there is no rule.
    """
    emitter = _BlockEmitter(
        lanes=lanes, lanes_per_thread=lanes // threads, arrays={x.name: x for x in arrays}
    )
    for k, variable in enumerate(emitter.lane):
        emitter.emit(f"const int {variable} = threadIdx.x + {k} * blockDim.x;")
    emitter.emit("const int block = blockIdx.x;")
    for array in arrays:
        emitter.emit(f"{array.name} += (long long)(PROBLEM_OF_{array.name}) * {array.size};")
    emitter.run(closed, [*((x.name,) for x in arrays), (BARRIER,)])
    return emitter.finish(name, threads, [_pointer(x) for x in arrays])


def _pointer(array: KernelArray) -> str:
    kind = TYPES[array.dtype] if array.is_written else f"const {TYPES[array.dtype]}"
    return f"{kind}* __restrict__ {array.name}"


@dataclass(kw_only=True)
class _Emitter:
    """Statements of a kernel of independent lanes, in order."""

    lanes: int
    lanes_per_thread: int = 1
    lines: list[str] = field(default_factory=list)
    operations: int = 0
    _n_names: int = 0
    _depth: int = 1

    def finish(self, name: str, threads: int, pointers: Sequence[str]) -> KernelCode:
        """Return the source of a function of the statements so far, for blocks of ``threads``."""
        head = f'extern "C" __global__ __launch_bounds__({threads}) void {name}(\n    '
        head += ",\n    ".join(pointers) + ") {"
        text = "\n".join([PRELUDE + head, *self.lines, "}", ""])
        return KernelCode(text=text, operations=self.operations)

    def emit(self, text: str) -> None:
        """Add a line."""
        self.lines.append("  " * self._depth + text)

    def run(self, closed: ClosedJaxpr, inputs: Sequence[Names]) -> list[Names]:
        """Emit all of a jaxpr; return its results."""
        values: dict[Var, Names] = dict(zip(closed.jaxpr.invars, inputs, strict=True))
        for var, const in zip(closed.jaxpr.constvars, closed.consts, strict=True):
            number = np.asarray(const)
            if number.size != 1:
                raise ValueError(f"a kernel uses a constant array {number.shape}: pass it instead")
            values[var] = (write_number(number.reshape(())[()], number.dtype),)
        return self._run_equations(closed.jaxpr, values)

    def _run_equations(self, jaxpr: Jaxpr, values: dict[Var, Names]) -> list[Names]:
        def read(x: Var | Literal) -> Names:
            return (
                (write_number(x.val, array_of(x).dtype),) if isinstance(x, Literal) else values[x]
            )

        for eqn in jaxpr.eqns:
            with naming_source(eqn):
                results = self._run_equation(eqn, [read(x) for x in eqn.invars])
            values.update(zip(eqn.outvars, results, strict=True))
        return [read(x) for x in jaxpr.outvars]

    def _run_equation(self, eqn: JaxprEqn, operands: list[Names]) -> list[Names]:
        name = eqn.primitive.name
        if name in _UNCHANGED:
            return [operands[0]]
        if name in _CALLS:
            inner = eqn.params[_CALLS[name]]
            return self.run(
                inner if isinstance(inner, ClosedJaxpr) else ClosedJaxpr(inner, []), operands
            )
        if name in _REDUCTIONS:
            return [self.reduce(eqn, operands[0])]
        structured = _STRUCTURED.get(name)
        if structured is not None:
            return structured(self, eqn, operands)
        return [self._declare_elementwise(eqn, operands)]

    def _declare_elementwise(self, eqn: JaxprEqn, operands: Sequence[Names]) -> Names:
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
        count = self._count_variables(out)
        return tuple(
            self._declare(out, template(eqn, [_of_lane(x, k) for x in operands]))
            for k in range(count)
        )

    def _count_variables(self, var: Var) -> int:
        return self.lanes_per_thread if array_of(var).size == self.lanes > 1 else 1

    def _declare(self, var: Var, value: str) -> str:
        name = self._make_name()
        self.operations += 1
        self.emit(f"const {type_name(var)} {name} = {value};")
        return name

    def _make_name(self) -> str:
        self._n_names += 1
        return f"v{self._n_names}"

    def _declare_variables(self, variables: Sequence[Var]) -> list[Names]:
        """Declare variables that are assigned later."""
        names = []
        for var in variables:
            names.append(tuple(self._make_name() for _ in range(self._count_variables(var))))
            self.emit(f"{type_name(var)} {', '.join(names[-1])};")
        return names

    def _assign(self, names: Sequence[Names], values: Sequence[Names]) -> None:
        """Assign to variables, all at once."""
        pairs = [
            (x, _of_lane(value, k))
            for variable, value in zip(names, values, strict=True)
            for k, x in enumerate(variable)
        ]
        targets = {target for target, _ in pairs}
        held = []
        for target, value in pairs:
            if value in targets and value != target:
                copy = self._make_name()
                self.emit(f"const auto {copy} = {value};")
                held.append((target, copy))
            elif value != target:
                held.append((target, value))
        for target, value in held:
            self.emit(f"{target} = {value};")

    def reduce(self, eqn: JaxprEqn, operand: Names) -> Names:
        """Return the thread's own number of lanes that are reduced; see the top of the module."""
        if array_of(eqn.invars[0]).size != self.lanes:
            raise UnsupportedOperationError(eqn, "kernels only reduce all lanes:")
        return operand

    def load(self, eqn: JaxprEqn, x: list[Names]) -> list[Names]:
        """Load the numbers of the thread's lanes."""
        index, out, (array,) = _index(eqn, x, 1), eqn.outvars[0], x[0]
        count = self._count_variables(out)
        return [tuple(self._declare(out, f"{array}[{_of_lane(index, k)}]") for k in range(count))]

    def store(self, eqn: JaxprEqn, x: list[Names]) -> list[Names]:
        """Store the numbers of the thread's lanes."""
        self.emit(f"{x[0][0]}[{_index(eqn, x, 2)[0]}] = {x[1][0]};")
        return [("0",)]

    def number_lanes(self, eqn: JaxprEqn) -> Names:
        """Return the numbers of the lanes of a block; independent lanes get theirs as input."""
        raise UnsupportedOperationError(eqn, "no CUDA C for")

    def _branch(self, eqn: JaxprEqn, x: list[Names]) -> list[Names]:
        branches = eqn.params["branches"]
        names = self._declare_variables(eqn.outvars)
        for k, branch in enumerate(branches):
            test = f"if ({x[0][0]} {'<=' if k == 0 else '=='} {k}) "
            is_last = k == len(branches) - 1
            self.emit(("else " if k else "") + ("" if is_last and k else test) + "{")
            self._depth += 1
            self._assign(names, self.run(branch, x[1:]))
            self._depth -= 1
            self.emit("}")
        return names

    def _start_loop(self, eqn: JaxprEqn, start: Sequence[Names]) -> list[Names]:
        names = self._declare_variables(eqn.outvars)
        self._assign(names, start)
        return names

    def _loop_while(self, eqn: JaxprEqn, x: list[Names]) -> list[Names]:
        n_cond, n_body = eqn.params["cond_nconsts"], eqn.params["body_nconsts"]
        of_cond, of_body = x[:n_cond], x[n_cond : n_cond + n_body]
        names = self._start_loop(eqn, x[n_cond + n_body :])
        self.emit("while (true) {")
        self._depth += 1
        ((running,),) = self.run(eqn.params["cond_jaxpr"], [*of_cond, *names])
        self.emit(f"if (!{running}) break;")
        self._assign(names, self.run(eqn.params["body_jaxpr"], [*of_body, *names]))
        self._depth -= 1
        self.emit("}")
        return names

    def _loop_times(self, eqn: JaxprEqn, x: list[Names]) -> list[Names]:
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

    def _raise_to_integer(self, eqn: JaxprEqn, x: list[Names]) -> list[Names]:
        """Multiply squares, as XLA does."""
        power, out = int(eqn.params["y"]), eqn.outvars[0]
        one, names = write_number(1, array_of(out).dtype), []
        for number in x[0]:
            base, value, left = number, "", abs(power)
            while left:
                if left & 1:
                    value = self._declare(out, f"{value} * {base}") if value else base
                left >>= 1
                if left:
                    base = self._declare(out, f"{base} * {base}")
            value = value or one
            names.append(self._declare(out, f"{one} / {value}") if power < 0 else value)
        return [tuple(names)]


@dataclass(kw_only=True)
class _BlockEmitter(_Emitter):
    """Statements of a kernel whose lanes work together."""

    arrays: dict[str, KernelArray]

    @property
    def lane(self) -> Names:
        """Return the numbers of the thread's lanes."""
        return tuple(f"lane{k}" for k in range(self.lanes_per_thread))

    def reduce(self, eqn: JaxprEqn, operand: Names) -> Names:
        """Reduce all lanes of the block to a number that every thread gets."""
        super().reduce(eqn, operand)
        out, combine = eqn.outvars[0], f"{_REDUCTIONS[eqn.primitive.name]}()"
        kind = "int" if type_name(out) == "bool" else type_name(out)
        total = f"({kind}){operand[0]}"
        for other in operand[1:]:
            total = f"{combine}({total}, ({kind}){other})"
        return (self._declare(out, f"reduce_({total}, {combine})"),)

    def load(self, eqn: JaxprEqn, x: list[Names]) -> list[Names]:
        """Load; a number that lanes may write is read by all of them before any goes on."""
        values = super().load(eqn, x)
        if array_of(eqn.outvars[0]).shape == () and self.arrays[x[0][0]].is_written:
            self.emit("__syncthreads();")
        return values

    def store(self, eqn: JaxprEqn, x: list[Names]) -> list[Names]:
        """Store; what lies behind the end of an array is dropped, as JAX does."""
        index, value, (array,) = _index(eqn, x, 2), x[1], x[0]
        if array == BARRIER:
            self.emit("__syncthreads();")
            return [("0",)]
        size = self.arrays[array].size
        for k in range(max(len(index), len(value))):
            at = _of_lane(index, k)
            self.emit(f"if ((unsigned)({at}) < {size}u) {array}[{at}] = {_of_lane(value, k)};")
        return [("0",)]

    def number_lanes(self, eqn: JaxprEqn) -> Names:
        """Return the numbers of the lanes, in the type of the equation."""
        if eqn.params["shape"] != (self.lanes,):
            raise UnsupportedOperationError(eqn, "kernels only number their lanes:")
        return tuple(f"({type_name(eqn.outvars[0])}){lane}" for lane in self.lane)


_STRUCTURED: dict[str, Callable[[_Emitter, JaxprEqn, list[Names]], list[Names]]] = {
    "get": lambda emitter, eqn, x: emitter.load(eqn, x),
    "swap": lambda emitter, eqn, x: emitter.store(eqn, x),
    "cond": _Emitter._branch,
    "while": _Emitter._loop_while,
    "scan": _Emitter._loop_times,
    "iota": lambda emitter, eqn, _: [emitter.number_lanes(eqn)],
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
    if dtype == np.float16:
        return f"half_({write_number(number, np.dtype(np.float32))})"
    if np.isfinite(number):
        text = float(number).hex() + ("f" if dtype == np.float32 else "")
        return f"({text})" if np.signbit(number) else text
    if dtype == np.float32:
        return f"__int_as_float({int(number.view(np.int32))})"
    return f"__longlong_as_double({int(number.view(np.int64))}ll)"


def _of_lane(names: Names, k: int) -> str:
    return names[k] if len(names) > 1 else names[0]


def _index(eqn: JaxprEqn, operands: Sequence[Names], first: int) -> Names:
    """Return the index of a load or store: lanes or a number."""
    (indexer,) = jax.tree.unflatten(eqn.params["tree"], [list(x) for x in operands[first:]])
    (index,) = indexer.indices
    return tuple(index) if isinstance(index, list) else (str(index),)


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
