"""Operators of faults: chosen ones of Cosmic Ray, and those for branch-free code.

Code for JAX decides with ``jnp.where``, ``minimum`` and ``any`` rather than with ``if``; Cosmic Ray
knows none of these. Operators are left out whose faults hardly compile (``x >> y`` for floats,
``is`` for arrays) or show nothing about the tests (removed decorators): caught at once, they would
only raise the fraction.
"""

from collections.abc import Iterator

import parso
from cosmic_ray.operators.operator import Example, Operator
from cosmic_ray.plugins import get_operator
from parso.python.tree import Name
from parso.tree import BaseNode, NodeOrLeaf

_ARITHMETIC = ("Add", "Sub", "Mul", "Div", "FloorDiv", "Mod", "Pow")
_BITS = ("BitOr", "BitAnd", "BitXor")
_SHIFTS = ("LShift", "RShift")
_ORDER = ("Eq", "NotEq", "Lt", "LtE", "Gt", "GtE")

_COUNTERPART_PAIRS = [
    *[("minimum", "maximum"), ("min", "max"), ("argmin", "argmax"), ("cummin", "cummax")],
    *[("any", "all"), ("logical_and", "logical_or"), ("sin", "cos"), ("floor", "ceil")],
    *[("zeros", "ones"), ("zeros_like", "ones_like"), ("sum", "max"), ("cumsum", "cumprod")],
]
COUNTERPARTS = {a: b for pair in _COUNTERPART_PAIRS for a, b in (pair, pair[::-1])} | {
    "max": "min",
    "sum": "max",
}
"""Functions of `jax.numpy` with the same arguments and another meaning."""

_MODULES = {"jnp", "np", "lax"}

type Position = tuple[tuple[int, int], tuple[int, int]]


class SwapTwin(Operator):
    """``jnp.minimum`` becomes ``jnp.maximum``, and so on."""

    def mutation_positions(self, node: NodeOrLeaf) -> Iterator[Position]:
        """Yield the positions of such a function's name."""
        if isinstance(node, Name) and node.value in COUNTERPARTS and _is_numpy_attribute(node):
            yield node.start_pos, node.end_pos

    def mutate(self, node: Name, index: int) -> Name:
        """Replace the name by the counterpart's."""
        node.value = COUNTERPARTS[node.value]
        return node

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Return examples, as Cosmic Ray requires."""
        return (Example("jnp.minimum(a, b)", "jnp.maximum(a, b)"),)


class SwapWhere(Operator):
    """``jnp.where(c, a, b)`` takes a where it took b."""

    def mutation_positions(self, node: NodeOrLeaf) -> Iterator[Position]:
        """Yield the positions of calls with three arguments."""
        if node.type == "arglist" and len(_positional_arguments(node)) == 3:
            name = node.get_previous_sibling().get_previous_leaf()
            if isinstance(name, Name) and name.value == "where" and _is_numpy_attribute(name):
                yield name.start_pos, name.end_pos

    def mutate(self, node: BaseNode, index: int) -> BaseNode:
        """Negate the condition."""
        condition = node.children[0].get_code().strip()
        node.children[0] = parso.parse(f"jnp.logical_not({condition})")
        return node

    @classmethod
    def examples(cls) -> tuple[Example, ...]:
        """Return examples, as Cosmic Ray requires."""
        return (Example("jnp.where(c, a, b)", "jnp.where(jnp.logical_not(c), a, b)"),)


def _is_numpy_attribute(name: Name) -> bool:
    dot = name.get_previous_leaf()
    if dot is None or dot.value != ".":
        return False
    return dot.get_previous_leaf().value in _MODULES


def _positional_arguments(arguments: BaseNode) -> list[NodeOrLeaf]:
    """Return the positional arguments."""
    rows = [child for child in arguments.children if child.type not in ("operator", "argument")]
    return rows if len(rows) * 2 - 1 <= len(arguments.children) else []


def _replacement_names(prefix: str, names: tuple[str, ...]) -> list[str]:
    return [f"{prefix}_{a}_{b}" for a in names for b in names if a != b]


def build_families() -> dict[str, dict[str, Operator]]:
    """Build families of operators: of all faults of a family at a position, one is sampled."""
    replace = "ReplaceBinaryOperator"
    binary = [
        name
        for group in (_ARITHMETIC, _BITS, _SHIFTS)
        for name in _replacement_names(replace, group)
    ]
    unary = [f"ReplaceUnaryOperator_Delete_{name}" for name in ("USub", "Invert", "Not")]
    order = _replacement_names("ReplaceComparisonOperator", _ORDER)
    identity = _replacement_names("ReplaceComparisonOperator", ("Is", "IsNot"))
    names_by_family = {
        "arithmetic": binary,
        "sign": unary,
        "comparison": [*order, *identity],
        "number": ["NumberReplacer"],
        "truth": ["ReplaceTrueWithFalse", "ReplaceFalseWithTrue"],
        "logic": ["ReplaceAndWithOr", "ReplaceOrWithAnd", "AddNot"],
        "loop": ["ReplaceBreakWithContinue", "ReplaceContinueWithBreak", "ZeroIterationForLoop"],
        "exception": ["ExceptionReplacer"],
    }
    operators_by_family = {
        family: {name: get_operator(f"core/{name}")() for name in names}
        for family, names in names_by_family.items()
    }
    return operators_by_family | {
        "twin": {"SwapTwin": SwapTwin()},
        "where": {"SwapWhere": SwapWhere()},
    }
