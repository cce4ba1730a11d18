"""Shared values of several results, computed once where a compiler would repeat them.

XLA on a CPU makes a loop of every result and repeats in each the operations that they have in
common, if these look cheap: three components of a force cost all operations that lead to them three
times. A value behind an optimisation barrier is written to memory once and read by all.

The values worth holding are found from the graph of operations. Seen from its end, a value that
several loops need is held if repeating the operations that lead to it would cost more than memory
does.
"""

from collections.abc import Callable, Sequence

import jax
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, Var

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
    plain = jax.make_jaxpr(lambda *x: _evaluate_jaxpr(closed, x, None))(*closed.in_avals)
    hold = _choose_held_variables(plain.jaxpr)
    return lambda *x: _evaluate_jaxpr(plain, x, hold)


def _arrange_body(value: object) -> object:
    """Apply `_insert_barriers` to a parameter of a loop."""
    if isinstance(value, tuple):
        return tuple(map(_arrange_body, value))
    if isinstance(value, ClosedJaxpr):
        return jax.make_jaxpr(_insert_barriers(value))(*value.in_avals)
    return value


def _evaluate_jaxpr(
    closed: ClosedJaxpr, args: Sequence[jax.Array], hold: set[Var] | None
) -> list[jax.Array]:
    """Evaluate with barriers behind the variables to hold.

    Where the variables are not chosen yet (None), called functions are inlined and the bodies of
    loops arranged.
    """
    jaxpr = closed.jaxpr
    values: dict[Var, jax.Array] = dict(zip(jaxpr.constvars, closed.consts, strict=True))
    values.update(zip(jaxpr.invars, args, strict=True))
    for eqn in jaxpr.eqns:
        operands = [x.val if isinstance(x, Literal) else values[x] for x in eqn.invars]
        params, name = eqn.params, eqn.primitive.name
        if hold is None and name in _CALLS:
            results = _evaluate_jaxpr(params["jaxpr"], operands, None)
        else:
            if hold is None and name in _LOOPS:
                params = {key: _arrange_body(value) for key, value in params.items()}
            results = eqn.primitive.bind(*operands, **eqn.primitive.get_bind_params(params))
            results = results if eqn.primitive.multiple_results else [results]
        for var, x in zip(eqn.outvars, results, strict=True):
            values[var] = jax.lax.optimization_barrier(x) if hold and var in hold else x
    return [x.val if isinstance(x, Literal) else values[x] for x in jaxpr.outvars]


def _choose_held_variables(jaxpr: Jaxpr) -> set[Var]:
    """Choose the variables to hold in memory."""
    graph = _Graph(jaxpr)
    held = graph.choose_held(set(), set(range(len(graph.out))))
    for _ in range(_N_PASSES):
        held = graph.choose_held(held, held)
    return {graph.out[i] for i in held}


class _Graph:
    """The values of a jaxpr as numbers in their order; sets of them are bits of a whole number."""

    def __init__(self, jaxpr: Jaxpr) -> None:
        index_of: dict[Var, int] = {}
        self.out: list[Var] = []
        self._before: list[list[int]] = []
        self._after: list[list[int]] = []
        self._in_memory: set[int] = set()
        self._expensive = self._cheap = 0
        for eqn in jaxpr.eqns:
            name = eqn.primitive.name
            is_in_memory = name.startswith(_MEMORY_OPERATIONS)
            before = [
                index_of[x] for x in eqn.invars if not isinstance(x, Literal) and x in index_of
            ]
            for var in eqn.outvars:
                i = index_of[var] = len(self.out)
                self.out.append(var)
                self._before.append([] if is_in_memory else before)
                self._after.append([])
                for j in self._before[i]:
                    self._after[j].append(i)
                self._in_memory.update([i, *before] if is_in_memory else ())
                if aval_of(var).size > 1 and not is_in_memory and name not in _FREE:
                    self._expensive |= (name in _EXPENSIVE) << i
                    self._cheap |= (name not in _EXPENSIVE) << i
        ends = [x for x in jaxpr.outvars if not isinstance(x, Literal)]
        self._in_memory.update(index_of[x] for x in ends if x in index_of)

    def choose_held(self, held: set[int], candidates: set[int]) -> set[int]:
        """Choose the values of ``candidates`` worth holding where those of ``held`` are."""
        leading = self._leading_operations(held)
        loops = [0] * len(self.out)
        chosen: set[int] = set()
        for i in reversed(range(len(self.out))):
            for j in self._after[i]:
                loops[i] |= loops[j]
            times = loops[i].bit_count()
            if (
                i in candidates
                and times > 1
                and i not in self._in_memory
                and aval_of(self.out[i]).size > 1
            ):
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
