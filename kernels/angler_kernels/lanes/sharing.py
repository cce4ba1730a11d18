"""Shared values of several results, computed once where a compiler would repeat them.

XLA on a CPU makes a loop of every result and repeats in each the operations that they have in
common, if these look cheap: three components of a force cost all operations that lead to them three
times. A value behind an optimisation barrier is written to memory once and read by all.

The values worth holding are found from the graph of operations. Seen from its end, a value that
several loops need is held if repeating the operations that lead to it would cost more than memory
does.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import jax
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal, Var

from angler_kernels.lanes.trees import aval_of, flatten

MEMORY_COST = 12
"""Cost of writing an array and beginning a loop for it, in operations on such an array."""

EXPENSIVE_COST = 8
"""Cost of a division, a root or a look-up, in additions."""

_EXPENSIVE = {"div", "rem", "sqrt", "rsqrt", "exp", "log", "pow", "sin", "cos", "atan2", "gather"}
_FREE = {"broadcast_in_dim", "reshape", "squeeze"}
_CALLS = {"jit", "pjit"}
_LOOPS = {"while", "scan", "cond"}
_MEMORY_OPERATIONS = (
    *_LOOPS,
    "custom",
    "scatter",
    "cum",
    "sort",
    "reduce_",
    "arg",
    "dot",
    "concatenate",
)
"""Prefixes of the names of operations that have their operands and results in memory."""

_N_PASSES = 3
"""Number of passes that thin out a choice: a held value makes those behind it cheaper."""


def compute_shared[T](function: Callable[[], T]) -> T:
    """Wrap a function with a tree of object arrays as result to compute common values once.

    The values and their derivatives are the same, up to how a compiler rounds.
    """
    rebuilds: list[Callable[[Sequence[jax.Array]], T]] = []

    def flatten_result() -> list[jax.Array]:
        row, rebuild = flatten(function())
        rebuilds.append(rebuild)
        return row

    row = _insert_barriers(jax.make_jaxpr(flatten_result)())()
    return rebuilds[0](row)


def _insert_barriers(closed: ClosedJaxpr) -> Callable[..., list[jax.Array]]:
    """Return the same function with barriers."""
    sequence = _list_operations(closed)
    hold = _choose_held_values(sequence)
    return lambda *x: _evaluate_operations(sequence, x, hold)


def _arrange_body(value: object) -> object:
    """Apply `_insert_barriers` to a parameter of a loop."""
    if isinstance(value, tuple):
        return tuple(map(_arrange_body, value))
    if isinstance(value, ClosedJaxpr):
        return jax.make_jaxpr(_insert_barriers(value))(*value.in_avals)
    return value


type _Atom = int | Literal
"""Number of a value, or a constant."""


@dataclass(frozen=True, kw_only=True)
class _Operation:
    """Equation of a jaxpr, on numbered values."""

    eqn: JaxprEqn
    operands: Sequence[_Atom]
    results: range


@dataclass(kw_only=True)
class _OperationSequence:
    """Operations of a jaxpr and of the functions that it calls, in order.

    Values are numbered: constants, arguments, then the results of all operations. Nothing is traced
    for that, which would take as long as what it is for.
    """

    constants: Sequence[jax.Array]
    n_input: int
    """Number of constants and arguments."""
    operations: list[_Operation] = field(default_factory=list)
    sizes: list[int] = field(default_factory=list)
    """Elements of each value."""
    results: Sequence[_Atom] = ()


def _list_operations(closed: ClosedJaxpr) -> _OperationSequence:
    """Return the operations of a jaxpr, those of called functions in the place of the calls."""
    jaxpr = closed.jaxpr
    inputs = [*jaxpr.constvars, *jaxpr.invars]
    sequence = _OperationSequence(
        constants=closed.consts,
        n_input=len(inputs),
        sizes=[aval_of(var).size for var in inputs],
    )
    sequence.results = _append_operations(sequence, jaxpr, range(len(inputs)))
    return sequence


def _append_operations(
    sequence: _OperationSequence, jaxpr: Jaxpr, inputs: Sequence[_Atom]
) -> list[_Atom]:
    """Append the operations of a jaxpr on values ``inputs``; return its results."""
    numbers: dict[Var, _Atom] = dict(zip([*jaxpr.constvars, *jaxpr.invars], inputs, strict=True))

    def read(atoms: Sequence[Var | Literal]) -> list[_Atom]:
        return [x if isinstance(x, Literal) else numbers[x] for x in atoms]

    for eqn in jaxpr.eqns:
        operands, name = read(eqn.invars), eqn.primitive.name
        called = eqn.params["jaxpr"] if name in _CALLS else None
        results: Sequence[_Atom]
        # A function that holds arrays of its program stays a call.
        if called is not None and not called.consts:
            results = _append_operations(sequence, called.jaxpr, operands)
        else:
            start = len(sequence.sizes)
            sequence.sizes += [aval_of(var).size for var in eqn.outvars]
            results = range(start, len(sequence.sizes))
            sequence.operations.append(_Operation(eqn=eqn, operands=operands, results=results))
        numbers.update(zip(eqn.outvars, results, strict=True))
    return read(jaxpr.outvars)


def _evaluate_operations(
    sequence: _OperationSequence, arguments: Sequence[jax.Array], hold: set[int]
) -> list[jax.Array]:
    """Evaluate with barriers behind the values to hold, and within the bodies of loops."""
    values = [*sequence.constants, *arguments]

    def read(atoms: Sequence[_Atom]) -> list[jax.Array]:
        return [x.val if isinstance(x, Literal) else values[x] for x in atoms]

    for operation in sequence.operations:
        eqn = operation.eqn
        params = eqn.params
        if eqn.primitive.name in _LOOPS:
            params = {key: _arrange_body(value) for key, value in params.items()}
        operands = read(operation.operands)
        results = eqn.primitive.bind(*operands, **eqn.primitive.get_bind_params(params))
        for i, x in zip(
            operation.results, results if eqn.primitive.multiple_results else [results], strict=True
        ):
            values.append(jax.lax.optimization_barrier(x) if i in hold else x)
    return read(sequence.results)


def _choose_held_values(sequence: _OperationSequence) -> set[int]:
    """Choose the values to hold in memory."""
    graph = _Graph(sequence)
    held = graph.choose_held(set(), set(range(len(graph.sizes))))
    for _ in range(_N_PASSES):
        held = graph.choose_held(held, held)
    return {i + sequence.n_input for i in held}


class _Graph:
    """The results of operations, numbered in order; sets of them are bits of a whole number."""

    def __init__(self, sequence: _OperationSequence) -> None:
        n_input = sequence.n_input
        self.sizes = sequence.sizes[n_input:]
        self._before: list[list[int]] = []
        self._after: list[list[int]] = [[] for _ in self.sizes]
        self._in_memory: set[int] = set()
        self._expensive = self._cheap = 0
        for operation in sequence.operations:
            name = operation.eqn.primitive.name
            is_in_memory = name.startswith(_MEMORY_OPERATIONS)
            before = self._results_of(operation.operands, n_input)
            for i in self._results_of(operation.results, n_input):
                self._before.append([] if is_in_memory else before)
                for j in self._before[i]:
                    self._after[j].append(i)
                self._in_memory.update([i, *before] if is_in_memory else ())
                if self.sizes[i] > 1 and not is_in_memory and name not in _FREE:
                    self._expensive |= (name in _EXPENSIVE) << i
                    self._cheap |= (name not in _EXPENSIVE) << i
        self._in_memory.update(self._results_of(sequence.results, n_input))

    @staticmethod
    def _results_of(atoms: Sequence[_Atom], n_input: int) -> list[int]:
        """Return those of the atoms that are results of operations, counted from the first."""
        return [x - n_input for x in atoms if not isinstance(x, Literal) and x >= n_input]

    def choose_held(self, held: set[int], candidates: set[int]) -> set[int]:
        """Choose the values of ``candidates`` worth holding where those of ``held`` are."""
        leading = self._leading_operations(held)
        loops = [0] * len(self.sizes)
        chosen: set[int] = set()
        for i in reversed(range(len(self.sizes))):
            for j in self._after[i]:
                loops[i] |= loops[j]
            times = loops[i].bit_count()
            if i in candidates and times > 1 and i not in self._in_memory and self.sizes[i] > 1:
                expensive, cheap = leading[i] & self._expensive, leading[i] & self._cheap
                cost = EXPENSIVE_COST * expensive.bit_count() + cheap.bit_count()
                if (times - 1) * cost > MEMORY_COST + times:
                    chosen.add(i)
            if i in self._in_memory or i in chosen:
                loops[i] = 1 << i
        return chosen

    def _leading_operations(self, held: set[int]) -> list[int]:
        """Count the operations that lead to each value from the nearest values in memory."""
        sets: list[int] = []
        for i, before in enumerate(self._before):
            sets.append(1 << i)
            for j in before:
                if j not in self._in_memory and j not in held:
                    sets[i] |= sets[j]
        return sets
