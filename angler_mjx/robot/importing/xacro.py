"""Expansion of xacro files without ROS; every element keeps the line it came from.

The language is that of xacro 2: properties, macros with defaults and blocks, conditions, includes,
arguments and expressions. Packages are folders (`packages`); expressions are a safe part of Python.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from angler_mjx.errors import format_value
from angler_mjx.robot.importing import expressions
from angler_mjx.robot.importing.notes import Location
from angler_mjx.robot.importing.packages import Packages
from angler_mjx.robot.importing.xml_tree import Element, read_xml
from angler_mjx.robot.importing.yaml_files import read_yaml

PREFIX = "xacro:"
MAX_CALLS = 40
"""Max depth of macro calls and includes."""
MAX_ELEMENTS = 200_000
"""Max number of elements of an expanded file; that of a vehicle has some thousands."""

_PARAMETER = re.compile(
    r"\s*(?P<name>[^\s:=]+?)\s*:?=\s*(?P<forward>\^\|?)?"
    r"(?P<default>(?:'[^']*'|\"[^\"]*\"|[^\s'\"])*)(?=\s|$)"
)
_TOKEN = re.compile(r"\$\$+[{(]|\$\{|\$\(")
_COMMAND = re.compile(r"\s*(\w+)\s*(.*?)\s*$", re.S)


@dataclass(frozen=True, kw_only=True)
class _Raw:
    """Text of a property that was not evaluated yet."""

    text: str
    element: Element


@dataclass(eq=False)
class _Scope:
    """Properties and macros by name; unknown ones are looked up in the caller's scope."""

    parent: "_Scope | None" = None
    values: dict[str, object] = field(default_factory=dict)
    blocks: dict[str, list[Element]] = field(default_factory=dict)
    macros: dict[str, "_Macro"] = field(default_factory=dict)
    evaluating: set[str] = field(default_factory=set)

    def find(self, table: str, name: str) -> "_Scope | None":
        """Return the nearest scope whose table (values, blocks, macros) has a name."""
        scope: _Scope | None = self
        while scope is not None and name not in getattr(scope, table):
            scope = scope.parent
        return scope

    @property
    def top(self) -> "_Scope":
        """Return the outermost scope."""
        return self if self.parent is None else self.parent.top


@dataclass(frozen=True, kw_only=True)
class _Parameter:
    """Parameter of a macro; blocks have a name that begins with a star."""

    name: str
    default: str | None
    is_forwarded: bool


@dataclass(frozen=True, kw_only=True)
class _Macro:
    """Macro: its parameters in order, and the element of its definition."""

    parameters: tuple[_Parameter, ...]
    element: Element


@dataclass
class _Expansion:
    """Expansion of one file and its includes."""

    packages: Packages
    arguments: dict[str, str]
    count: int = 0
    chain: list[str] = field(default_factory=list)
    """Macros and files under expansion, outermost first."""
    missing: list[Element] = field(default_factory=list)

    def expand_children(
        self, element: Element, scope: _Scope, caller: Location | None
    ) -> list[Element]:
        """Return the expanded children of an element."""
        result: list[Element] = []
        for child in element.children:
            result += self.expand(child, scope, caller)
        return result

    def expand(self, element: Element, scope: _Scope, caller: Location | None) -> list[Element]:
        """Return what an element expands to, in ``scope``, within the macro call at ``caller``."""
        if not element.tag.startswith(PREFIX):
            return [self._copy(element, scope, caller)]
        name = element.tag.removeprefix(PREFIX)
        match name:
            case "property":
                self._define_property(element, scope, caller)
            case "macro":
                self._define_macro(element, scope)
            case "arg":
                text = element.attributes.get("default")
                key = _required(element, "name")
                if text is not None and key not in self.arguments:
                    self.arguments[key] = str(self.evaluate_text(text, scope, element))
            case "include":
                return self._include(element, scope, caller)
            case "if" | "unless":
                value = self.evaluate_text(_required(element, "value"), scope, element)
                if _as_bool(value, element) is (name == "if"):
                    return self.expand_children(element, scope, caller)
            case "insert_block":
                return self._insert_block(element, scope)
            case "element" | "attribute":
                element.fail(
                    f"<{element.tag}> is not expanded here; expand the file by xacro first"
                )
            case "call":
                macro = str(self.evaluate_text(_required(element, "macro"), scope, element))
                return self._call(element, macro, scope, caller)
            case _:
                return self._call(element, name, scope, caller)
        return []

    def _copy(self, element: Element, scope: _Scope, caller: Location | None) -> Element:
        """Return an element with evaluated attributes, text and children."""
        self.count += 1
        if self.count > MAX_ELEMENTS:
            element.fail(f"the file expands to more than {MAX_ELEMENTS} elements; shorten it")
        attributes = {
            name: str(self.evaluate_text(text, scope, element)) if "$" in text else text
            for name, text in element.attributes.items()
        }
        text = element.text
        if "$" in text:
            text = str(self.evaluate_text(text, scope, element))
        location = element.location
        if location.caller is None and caller is not None:
            location = replace(location, caller=caller)
        made = Element(tag=element.tag, attributes=attributes, location=location, text=text)
        made.children = self.expand_children(element, scope, caller)
        return made

    def _define_property(self, element: Element, scope: _Scope, caller: Location | None) -> None:
        attributes, name = element.attributes, _required(element, "name")
        name = str(self.evaluate_text(name, scope, element))
        target = {"parent": scope.parent or scope, "global": scope.top}.get(
            attributes.get("scope", ""), scope
        )
        if attributes.get("remove", "").lower() == "true":
            target.values.pop(name, None)
        elif "value" in attributes:
            raw = _Raw(text=attributes["value"], element=element)
            target.values[name] = raw
            if target is not scope or attributes.get("lazy_eval", "").lower() == "false":
                target.values[name] = self.evaluate_text(raw.text, scope, element)
        elif "default" in attributes:
            if scope.find("values", name) is None:
                target.values[name] = _Raw(text=attributes["default"], element=element)
        else:
            target.blocks["**" + name] = self.expand_children(element, scope, caller)

    def _define_macro(self, element: Element, scope: _Scope) -> None:
        name = _required(element, "name").removeprefix(PREFIX)
        parameters = _parse_parameters(element.attributes.get("params", ""), element)
        scope.macros[name] = _Macro(parameters=tuple(parameters), element=element)

    def _include(self, element: Element, scope: _Scope, caller: Location | None) -> list[Element]:
        text = str(self.evaluate_text(_required(element, "filename"), scope, element))
        if "ns" in element.attributes:
            element.fail("includes with a namespace (ns) are not expanded; remove ns")
        path = self.packages.locate(text, element)
        if not path.is_file():
            if element.attributes.get("optional", "").lower() == "true":
                return []
            element.fail(f"filename = {format_value(text)}: there is no file {path}; correct it")
        self._enter(str(path), element)
        root = read_xml(path)
        result = self.expand_children(root, scope, caller)
        self.chain.pop()
        return result

    def _enter(self, label: str, element: Element) -> None:
        """Note what is expanded.

        Raises:
            ConfigError: it is expanded already without end.
        """
        is_file = "/" in label and label in self.chain
        if is_file or len(self.chain) >= MAX_CALLS:
            loop = [Path(part).name for part in self.chain[-5:]]
            element.fail(
                "expands itself without end (" + " -> ".join([*loop, Path(label).name]) + "); "
                "break the cycle"
            )
        self.chain.append(label)

    def _insert_block(self, element: Element, scope: _Scope) -> list[Element]:
        name = str(self.evaluate_text(_required(element, "name"), scope, element))
        for key in ("*" + name, "**" + name):
            holder = scope.find("blocks", key)
            if holder is not None:
                return [_clone(block) for block in holder.blocks[key]]
        element.fail(f"there is no block {format_value(name)}; pass it to the macro")

    def _call(
        self, element: Element, name: str, scope: _Scope, caller: Location | None
    ) -> list[Element]:
        holder = scope.find("macros", name)
        if holder is None:
            element.fail(
                f"there is no macro {format_value(name)}; define or include it before this line"
            )
        macro = holder.macros[name]
        inner = _Scope(parent=scope)
        names = {parameter.name for parameter in macro.parameters}
        for key, text in element.attributes.items():
            if element.tag == PREFIX + "call" and key == "macro":
                continue
            if key not in names:
                element.fail(
                    f"macro {format_value(name)} ({macro.element.location}) has no parameter "
                    f"{format_value(key)}; remove it"
                )
            inner.values[key] = self.evaluate_text(text, scope, element)
        blocks = self.expand_children(element, scope, caller)
        for parameter in macro.parameters:
            if parameter.name.startswith("*"):
                if not blocks:
                    element.fail(
                        f"macro {format_value(name)} needs a block for {parameter.name}; "
                        "write it inside"
                    )
                block = blocks.pop(0)
                stars = parameter.name
                inner.blocks[stars] = block.children if stars.startswith("**") else [block]
            elif parameter.name not in inner.values:
                inner.values[parameter.name] = self._default(element, name, parameter, scope)
        if blocks:
            blocks[0].fail(f"macro {format_value(name)} takes no further block; remove it")
        self._enter(name, element)
        location = element.location
        if location.caller is None and caller is not None:
            location = replace(location, caller=caller)
        result = self.expand_children(macro.element, inner, location)
        self.chain.pop()
        return result

    def _default(
        self, element: Element, macro: str, parameter: _Parameter, scope: _Scope
    ) -> object:
        if parameter.is_forwarded and scope.find("values", parameter.name) is not None:
            return self._find_value(parameter.name, scope)
        if parameter.default is None:
            element.fail(
                f"macro {format_value(macro)} needs {format_value(parameter.name)}; add it"
            )
        return self.evaluate_text(parameter.default, scope, element)

    def _find_value(self, name: str, scope: _Scope) -> object:
        """Return the value of a property, evaluated where it was defined.

        Raises:
            KeyError: there is none.
        """
        holder = scope.find("values", name)
        if holder is None:
            raise KeyError(name)
        value = holder.values[name]
        if isinstance(value, _Raw):
            if name in holder.evaluating:
                value.element.fail("the property is defined by itself; break the cycle")
            holder.evaluating.add(name)
            value = self.evaluate_text(value.text, holder, value.element)
            holder.evaluating.discard(name)
            holder.values[name] = value
        return _as_literal(value)

    def evaluate_text(self, text: str, scope: _Scope, element: Element) -> object:
        """Return a text with its ``${...}`` and ``$(...)`` evaluated.

        A text that is one expression gives its value, any other one a text.
        """
        if "$" not in text:
            return text
        pieces: list[object] = []
        at = 0
        while token := _TOKEN.search(text, at):
            pieces.append(text[at : token.start()])
            if token[0].startswith("$$"):
                pieces.append(token[0][1:])
                at = token.end()
                continue
            end = _find_end(text, token.end(), token[0][1])
            if end < 0:
                element.fail(f"{format_value(text)}: the bracket of {token[0]} is not closed")
            inside = text[token.end() : end]
            evaluate = self._evaluate_expression if token[0] == "${" else self._substitute
            pieces.append(evaluate(inside, scope, element))
            at = end + 1
        pieces.append(text[at:])
        filled = [piece for piece in pieces if piece != "" or not isinstance(piece, str)]
        if len(filled) == 1:
            return filled[0]
        return "".join(map(_as_text, filled))

    def _evaluate_expression(self, text: str, scope: _Scope, element: Element) -> object:
        functions = {
            name: lambda file: self._load_yaml(file, element)
            for name in ("load_yaml", "xacro.load_yaml")
        }
        functions["xacro.arg"] = lambda name: self._argument(name, element)
        functions["radians"] = lambda x: x * 0.017453292519943295
        if "$(" in text:
            text = str(self.evaluate_text(text, scope, element))
        try:
            return expressions.evaluate(text, lambda name: self._find_value(name, scope), functions)
        except expressions.ExpressionError as error:
            element.fail(f"${{{format_value(text)[1:-1]}}} {error}; correct it")

    def _substitute(self, text: str, scope: _Scope, element: Element) -> object:
        command = _COMMAND.match(text)
        name, rest = (command[1], command[2]) if command else ("", "")
        if name == "eval":
            names = {**self.arguments}

            def find_name(key: str) -> object:
                return _as_literal(names[key])

            try:
                return expressions.evaluate(
                    rest, find_name, {"arg": lambda key: self._argument(key, element)}
                )
            except expressions.ExpressionError as error:
                element.fail(f"$(eval {format_value(rest)[1:-1]}) {error}; correct it")
        rest = str(self.evaluate_text(rest, scope, element))
        match name:
            case "arg":
                return self._argument(rest, element)
            case "find":
                return str(self.packages.find_package(rest, element))
            case "dirname":
                return str(element.location.file.parent)
            case "optenv":
                return " ".join(rest.split()[1:])
        element.fail(
            f"$({format_value(text)[1:-1]}): only arg, find, eval, dirname and optenv are "
            "expanded; write the value"
        )

    def _argument(self, name: str, element: Element) -> str:
        if name not in self.arguments:
            element.fail(
                f"argument {format_value(name)} has no default; give --xacro-args {name}:=VALUE"
            )
        return self.arguments[name]

    def _load_yaml(self, file: str, element: Element) -> object:
        path = self.packages.locate(str(file), element)
        if not path.is_file():
            element.fail(f"load_yaml({format_value(file)}): there is no file {path}; correct it")
        return read_yaml(path)


def expand_xacro(root: Element, packages: Packages, arguments: Mapping[str, str]) -> Element:
    """Return the expanded tree of a xacro file.

    Args:
        root: its root, as read.
        packages: folders from which files may be read.
        arguments: values of ``$(arg ...)`` by name.

    Raises:
        ConfigError: a fault of the file; names file, line and element.
    """
    expansion = _Expansion(packages, dict(arguments), chain=[str(root.location.file)])
    made = expansion.expand(root, _Scope(), None)
    return made[0]


def uses_xacro(root: Element) -> bool:
    """Return whether a tree holds elements or expressions of xacro."""
    texts = (root.text, *root.attributes.values())
    return (
        root.tag.startswith(PREFIX)
        or any("${" in text or "$(" in text for text in texts)
        or any(map(uses_xacro, root.children))
    )


def _parse_parameters(text: str, element: Element) -> list[_Parameter]:
    result, rest = list[_Parameter](), text.strip()
    while rest:
        match = _PARAMETER.match(rest)
        if match:
            default = match["default"]
            if len(default) > 1 and default[0] == default[-1] and default[0] in "'\"":
                default = default[1:-1]
            elif not default and match["forward"]:
                default = None
            result.append(
                _Parameter(name=match["name"], default=default, is_forwarded=bool(match["forward"]))
            )
            rest = rest[match.end() :].strip()
        else:
            name, _, rest = (
                rest.partition(" ") if " " in rest.split("\n")[0] else rest.partition("\n")
            )
            words = f"{name} {rest}".split(None, 1)
            result.append(_Parameter(name=words[0], default=None, is_forwarded=False))
            rest = words[1] if len(words) > 1 else ""
    names = [parameter.name for parameter in result]
    if len(set(names)) < len(names):
        element.fail(f"params = {format_value(text)}: a name occurs twice")
    return result


def _find_end(text: str, at: int, bracket: str) -> int:
    """Return the position of the bracket that closes the one before ``at``, or -1."""
    closing, depth, quote = {"{": "}", "(": ")"}[bracket], 1, ""
    for i in range(at, len(text)):
        char = text[i]
        if quote:
            quote = "" if char == quote else quote
        elif char in "'\"" and text.find(char, i + 1) > 0:
            quote = char
        elif char == bracket:
            depth += 1
        elif char == closing:
            depth -= 1
            if depth == 0:
                return i
    return -1


def _required(element: Element, name: str) -> str:
    value = element.attributes.get(name)
    if value is None:
        element.fail(f'attribute "{name}" is missing; add it')
    return value


def _as_text(value: object) -> str:
    return value if isinstance(value, str) else str(value)


def _as_literal(value: object) -> object:
    """Return the number or truth value that a text states, else the text."""
    if not isinstance(value, str):
        return value
    text = value.strip()
    if len(text) > 1 and text[0] == text[-1] == "'":
        return text[1:-1]
    if "_" in text:
        return value
    for convert in (int, float):
        try:
            return convert(text)
        except ValueError:
            pass
    return {"true": True, "True": True, "false": False, "False": False}.get(text, value)


def _as_bool(value: object, element: Element) -> bool:
    literal = _as_literal(value)
    if isinstance(literal, bool | int | float):
        return bool(literal)
    element.fail(f"value = {format_value(value)}: write true or false, or a number")


def _clone(element: Element) -> Element:
    return Element(
        tag=element.tag,
        attributes=dict(element.attributes),
        location=element.location,
        text=element.text,
        children=[_clone(child) for child in element.children],
    )
