"""Text of a vehicle file from its tables."""

import json
from collections.abc import Mapping
from typing import Any

WIDTH = 100


def format_tables(tables: Mapping[str, Any]) -> str:
    """Return the TOML text of tables, values before tables, in their order."""
    lines: list[str] = []
    _add_table(tables, (), lines)
    return "\n".join(lines).strip() + "\n"


def _add_table(table: Mapping[str, Any], path: tuple[str, ...], lines: list[str]) -> None:
    nested = {key: value for key, value in table.items() if _is_nested(key, value)}
    for key, value in table.items():
        if key not in nested:
            lines.append(f"{key} = {_format(value)}")
    for key, value in nested.items():
        inner = (*path, key)
        for entry in value if isinstance(value, list) else [value]:
            brackets = ("[[", "]]") if isinstance(value, list) else ("[", "]")
            if isinstance(value, list) or any(not _is_nested(k, v) for k, v in entry.items()):
                lines += ["", brackets[0] + ".".join(inner) + brackets[1]]
            _add_table(entry, inner, lines)


def _is_nested(key: str, value: object) -> bool:
    """Return whether a value is a table of its own; rows of few values stand in lists."""
    if isinstance(value, Mapping):
        return True
    return key in ("links", "joints") and isinstance(value, list)


def _format(value: object) -> str:
    match value:
        case bool():
            return str(value).lower()
        case str():
            return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
        case float() | int():
            return repr(value)
        case list():
            inline = "[" + ", ".join(map(_format, value)) + "]"
            if len(inline) <= WIDTH and not any(isinstance(x, Mapping) for x in value):
                return inline
            return "[\n" + "".join(f"  {_format(x)},\n" for x in value) + "]"
        case Mapping():
            pairs = ", ".join(f"{key} = {_format(entry)}" for key, entry in value.items())
            return "{ " + pairs + " }"
    raise TypeError(type(value).__name__)
