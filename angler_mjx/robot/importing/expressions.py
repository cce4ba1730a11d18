"""Expressions of xacro: a safe part of Python, without access to objects, files or the system."""

import ast
import math
import operator
from collections.abc import Callable, Mapping
from typing import Any

type Value = str | int | float | bool | list["Value"] | dict[str, "Value"] | None

MAX_CHARACTERS, MAX_DIGITS = 10_000, 4000
"""Max length of a text or list, and of an integer in bits."""
_MAX_NODES, _MAX_STEPS = 500, 100_000
"""Max number of nodes of an expression, and of their evaluations: comprehensions repeat them."""

_OPERATORS: Mapping[type[ast.AST], Callable[..., object]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
    ast.Not: operator.not_,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
    ast.In: lambda a, b: a in b,
    ast.NotIn: lambda a, b: a not in b,
}
_MATHS: Mapping[str, object] = {
    name: getattr(math, name) for name in dir(math) if not name.startswith("_")
}
_NAMES: Mapping[str, object] = {
    **{name: value for name, value in _MATHS.items() if name not in ("factorial", "comb", "perm")},
    **{f.__name__: f for f in (abs, min, max, round, len, int, float, bool, sum, sorted)},
    "str": str,
    "range": lambda *args: _limited(list(range(*args[:3]))) if _is_short(args) else _refuse(),
    "list": list,
    "dict": dict,
    "True": True,
    "False": False,
    "true": True,
    "false": False,
    "math": "math",
}
_METHODS: Mapping[type, frozenset[str]] = {
    str: frozenset(
        {"split", "strip", "lower", "upper", "title", "find", "replace", "startswith", "endswith"}
    ),
    dict: frozenset(["keys", "values", "items", "get"]),
}


class ExpressionError(ValueError):
    """An expression cannot be evaluated; the text says why."""


def evaluate(
    text: str, find_name: Callable[[str], object], functions: Mapping[str, Callable[..., object]]
) -> object:
    """Evaluate an expression.

    Args:
        text: of Python: numbers, texts, lists, dicts, operators, mathematics.
        find_name: returns the value of a name; raises KeyError for unknown ones.
        functions: further functions by name; may hold a dot.

    Raises:
        ExpressionError: bad syntax, an unknown name, or an operation that is not permitted.
    """
    try:
        tree = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        reason = error.msg if isinstance(error, SyntaxError) else str(error)
        raise ExpressionError(f"is no expression ({reason})") from error
    if sum(1 for _ in ast.walk(tree)) > _MAX_NODES:
        raise ExpressionError(f"has more than {_MAX_NODES} parts")
    try:
        return _Evaluation(find_name, functions).value(tree.body, {})
    except ExpressionError:
        raise
    except (ArithmeticError, TypeError, ValueError, LookupError, AttributeError) as error:
        detail = " ".join(str(error).split()) or type(error).__name__
        raise ExpressionError(f"cannot be computed ({detail})") from error


class _Evaluation:
    """Values of the nodes of one expression."""

    def __init__(
        self, find_name: Callable[[str], object], functions: Mapping[str, Callable[..., object]]
    ) -> None:
        self._find_name, self._functions = find_name, functions
        self._steps = 0

    def value(self, node: ast.AST, local: Mapping[str, object]) -> object:
        """Return the value of a node.

        Args:
            node: of the expression.
            local: names bound by comprehensions around it.
        """
        self._steps += 1
        if self._steps > _MAX_STEPS:
            raise ExpressionError(f"takes more than {_MAX_STEPS} steps")
        match node:
            case ast.Constant(value=bool() | int() | float() | str() | None):
                return node.value
            case ast.Name(id=name):
                return self._name(name, local)
            case ast.BinOp(left=left, op=op, right=right):
                return self._operate(op, self.value(left, local), self.value(right, local))
            case ast.UnaryOp(op=op, operand=operand):
                return self._operate(op, self.value(operand, local))
            case ast.BoolOp(op=op, values=values):
                result: object = None
                for part in values:
                    result = self.value(part, local)
                    if bool(result) is isinstance(op, ast.Or):
                        return result
                return result
            case ast.Compare(left=left, ops=ops, comparators=others):
                items = [self.value(item, local) for item in (left, *others)]
                return all(
                    self._operate(op, a, b)
                    for op, a, b in zip(ops, items[:-1], items[1:], strict=True)
                )
            case ast.IfExp(test=test, body=body, orelse=other):
                return self.value(body if self.value(test, local) else other, local)
            case ast.List(elts=parts) | ast.Tuple(elts=parts):
                return [self.value(part, local) for part in parts]
            case ast.Dict(keys=keys, values=values) if None not in keys:
                pairs = zip(keys, values, strict=True)
                return {self.value(k, local): self.value(v, local) for k, v in pairs if k}
            case ast.Subscript(value=container, slice=index):
                return self._entry(self.value(container, local), index, local)
            case ast.Attribute(value=ast.Name(id="math"), attr=name) if name in _MATHS:
                return _NAMES[name]
            case ast.Attribute(value=container, attr=name):
                return self._attribute(self.value(container, local), name)
            case ast.ListComp(elt=item, generators=[ast.comprehension() as loop]):
                return self._comprehend(item, loop, local)
            case ast.Call(func=function, args=args, keywords=[]):
                return self._call(function, [self.value(arg, local) for arg in args], local)
        raise ExpressionError(f"{ast.unparse(node)[:60]!r} is not permitted in expressions")

    def _name(self, name: str, local: Mapping[str, object]) -> object:
        if name in local:
            return local[name]
        try:
            return self._find_name(name)
        except KeyError:
            if name in _NAMES:
                return _NAMES[name]
            raise ExpressionError(f"name {name!r} is not defined") from None

    def _operate(self, op: ast.AST, *operands: object) -> object:
        function = _OPERATORS.get(type(op))
        if function is None:
            raise ExpressionError(f"operator {type(op).__name__} is not permitted")
        if isinstance(op, ast.Pow | ast.Mult):
            _check_growth(op, *operands)
        if isinstance(op, ast.Mod) and isinstance(operands[0], str):
            raise ExpressionError("texts are not formatted by %; join them by +")
        return _limited(function(*operands))

    def _entry(self, container: object, index: ast.AST, local: Mapping[str, object]) -> object:
        if not isinstance(container, str | list | dict):
            raise ExpressionError(f"{type(container).__name__} has no entries")
        key: Any = (
            self.value(index, local)
            if not isinstance(index, ast.Slice)
            else slice(
                *(end and self.value(end, local) for end in (index.lower, index.upper, index.step))
            )
        )
        entries: Any = container
        return entries[key]

    def _attribute(self, container: object, name: str) -> object:
        if isinstance(container, dict) and name in container:
            return container[name]
        if name in _METHODS.get(type(container), ()):
            return getattr(container, name)
        raise ExpressionError(f".{name} is not permitted on {type(container).__name__}")

    def _comprehend(
        self, item: ast.AST, loop: ast.comprehension, local: Mapping[str, object]
    ) -> list[object]:
        if not isinstance(loop.target, ast.Name):
            raise ExpressionError("a list comprehension has one name")
        values = []
        items = self.value(loop.iter, local)
        if not isinstance(items, str | list | dict):
            raise ExpressionError(f"{type(items).__name__} is no list")
        for entry in items:
            scope = {**local, loop.target.id: entry}
            if all(self.value(test, scope) for test in loop.ifs):
                values.append(self.value(item, scope))
        return values

    def _call(self, function: ast.AST, args: list[object], local: Mapping[str, object]) -> object:
        dotted = ast.unparse(function)
        if dotted in self._functions:
            return self._functions[dotted](*args)
        called = self.value(function, local)
        if not callable(called):
            raise ExpressionError(f"{dotted!r} is no function")
        if called in (str.replace, pow) or getattr(called, "__name__", "") in ("replace", "pow"):
            _check_growth(ast.Pow(), *args[:2])
        if called in (list, sorted, sum, dict) and not isinstance(args[0], list | dict | str):
            raise ExpressionError(f"{dotted} takes a list")
        result = called(*args)
        listed = isinstance(result, type({}.keys()) | type({}.values()) | type({}.items()))
        return _limited(list(result) if listed else result)


def _check_growth(op: ast.AST, *operands: Any) -> None:
    """Raise ExpressionError if a product or power of these would be too large to hold."""
    a, b = (*operands, 1)[:2]
    for x, y in ((a, b), (b, a)):
        if isinstance(x, str | list) and isinstance(y, int) and len(x) * y > MAX_CHARACTERS:
            raise ExpressionError("gives too long a text")
        if isinstance(x, str) and isinstance(y, str) and len(x) * len(y) > MAX_CHARACTERS:
            raise ExpressionError("gives too long a text")
    is_power = isinstance(op, ast.Pow) and isinstance(a, int) and isinstance(b, int)
    if is_power and abs(int(a)).bit_length() * abs(int(b)) > MAX_DIGITS:
        raise ExpressionError("gives too large a number")


def _limited(value: object) -> object:
    if isinstance(value, str | list | dict) and len(value) > MAX_CHARACTERS:
        raise ExpressionError("gives too long a text or list")
    if isinstance(value, int) and value.bit_length() > MAX_DIGITS:
        raise ExpressionError("gives too large a number")
    return value


def _is_short(args: tuple[object, ...]) -> bool:
    return all(isinstance(arg, int) and abs(arg) <= MAX_CHARACTERS for arg in args)


def _refuse() -> None:
    raise ExpressionError(f"range() of at most {MAX_CHARACTERS} numbers is permitted")
