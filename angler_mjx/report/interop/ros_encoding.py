"""Messages as bytes of CDR and back: the only encoder, of bags and of live topics.

An encoder is compiled once for a type. Numbers between two strings or sequences are one pack of
`struct`, in eight variants for the alignment of their begin.
"""

import re
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

from mcap_ros2._dynamic import generate_dynamic

from angler_mjx.report.interop.ros_definitions import message_definition
from angler_mjx.report.interop.ros_types import ALL_FIELDS

type Encoder = Callable[[Mapping[str, object]], bytes]
type Decoder = Callable[[bytes], Any]

HEADER = b"\x00\x01\x00\x00"
"""Head of a message: CDR, little endian."""

_CODES = {
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
    "char": "B",
    "bool": "?",
    "byte": "B",
}
"""Codes of `struct` by type of ROS."""
_NOTHING: Mapping[str, Any] = {}


@dataclass(frozen=True)
class _Numbers:
    """Numbers in a row: their count, and their pack by the position's remainder by 8."""

    count: int
    packs: tuple[Callable[..., bytes], ...]


@dataclass(frozen=True)
class _Text:
    """String."""


@dataclass(frozen=True)
class _TextSequence:
    """Sequence of strings."""


@dataclass(frozen=True)
class _NumberSequence:
    """Sequence of numbers."""

    code: str
    size: int


@dataclass(frozen=True)
class _Sequence:
    """Sequence of messages."""

    element: "_Layout"


type _Part = _Numbers | _Text | _TextSequence | _NumberSequence | _Sequence


@dataclass(frozen=True)
class _Field:
    """Field of a message: a nested message, a value, or an array of a fixed length."""

    name: str
    nested: "tuple[_Field, ...] | None" = None
    default: Any = None
    length: int = 0


@dataclass(frozen=True)
class _Layout:
    """Fields of a message, and its parts on the wire."""

    fields: tuple[_Field, ...]
    parts: tuple[_Part, ...]

    def write(self, message: Mapping[str, Any], out: bytearray) -> None:
        """Append a message; the start of ``out`` is that of the alignment."""
        values: list[Any] = []
        _collect(self.fields, message, values)
        i = 0
        for part in self.parts:
            if isinstance(part, _Numbers):
                out += part.packs[len(out) % 8](*values[i : i + part.count])
                i += part.count
                continue
            value = values[i]
            i += 1
            if isinstance(part, _Text):
                _write_text(value, out)
                continue
            _write_count(len(value), out)
            if isinstance(part, _TextSequence):
                for text in value:
                    _write_text(text, out)
            elif isinstance(part, _Sequence):
                for item in value:
                    part.element.write(item, out)
            elif len(value):
                out += bytes(-len(out) % part.size)
                out += struct.pack(f"<{len(value)}{part.code}", *value)


def _write_count(count: int, out: bytearray) -> None:
    out += bytes(-len(out) % 4)
    out += struct.pack("<I", count)


def _write_text(text: str, out: bytearray) -> None:
    data = text.encode() + b"\0"
    _write_count(len(data), out)
    out += data


def _collect(fields: Sequence[_Field], message: Mapping[str, Any], values: list[Any]) -> None:
    """Append the values of a message in the order of its parts."""
    for field in fields:
        value = message.get(field.name)
        if field.nested is not None:
            _collect(field.nested, value or _NOTHING, values)
        elif field.length:
            row = () if value is None else value[: field.length]
            values.extend(row)
            values.extend([field.default] * (field.length - len(row)))
        else:
            values.append(field.default if value is None else value)


@cache
def find_encoder(name: str) -> Encoder:
    """Return the encoder of a message; missing fields are 0 or empty.

    Args:
        name: package/Name, one of `ros_types.ALL_FIELDS`.
    """
    layout = _find_layout(name)

    def encode(message: Mapping[str, Any]) -> bytes:
        body = bytearray()
        layout.write(message, body)
        return HEADER + body

    return encode


@cache
def _find_layout(name: str) -> _Layout:
    parts: list[_Part] = []
    codes: list[str] = []
    fields = _list_fields(name, parts, codes)
    _end_numbers(parts, codes)
    return _Layout(fields, tuple(parts))


def _list_fields(name: str, parts: list[_Part], codes: list[str]) -> tuple[_Field, ...]:
    """Return the fields of a message, and extend the parts of the message that it is nested in.

    Args:
        name: package/Name.
        parts: parts so far.
        codes: of the numbers that are in no part yet.
    """
    fields = []
    for line in ALL_FIELDS[name].splitlines():
        if "=" in line:  # a constant
            continue
        kind, field, *default = line.split()
        base, _, length = kind.rstrip("]").partition("[")
        if length:  # of numbers; no type here has a fixed number of messages
            codes += [_CODES[base]] * int(length)
            fields.append(_Field(field, default=0, length=int(length)))
        elif kind.endswith("]"):
            _end_numbers(parts, codes)
            parts.append(_find_sequence(base))
            fields.append(_Field(field, default=()))
        elif kind == "string":
            _end_numbers(parts, codes)
            parts.append(_Text())
            fields.append(_Field(field, default=""))
        elif base in _CODES:
            codes.append(_CODES[base])
            fields.append(_Field(field, default=float(default[0]) if default else 0))
        else:
            fields.append(_Field(field, nested=_list_fields(base, parts, codes)))
    return tuple(fields)


def _find_sequence(base: str) -> _Part:
    """Return the part of a sequence of a type."""
    if base == "string":
        return _TextSequence()
    if base in _CODES:
        return _NumberSequence(_CODES[base], struct.calcsize(f"<{_CODES[base]}"))
    return _Sequence(_find_layout(base))


def _end_numbers(parts: list[_Part], codes: list[str]) -> None:
    """Make a part of the numbers that are in none yet."""
    if not codes:
        return
    packs = tuple(struct.Struct(_align(codes, begin)).pack for begin in range(8))
    parts.append(_Numbers(len(codes), packs))
    codes.clear()


def _align(codes: Sequence[str], begin: int) -> str:
    """Return the format of numbers that begin at a position, each at a multiple of its size."""
    form, position = "<", begin
    for code in codes:
        size = struct.calcsize(f"<{code}")
        padding = -position % size
        form += "x" * padding + code
        position += padding + size
    return form


def _join_words(name: str) -> str:
    """Return the name of a part of a service or action as that of a message, as in ``A_Request``.

    The library takes names of messages alone, which have no underscores.
    """
    package, _, short = name.partition("/")
    return f"{package}/{short.replace('_', '')}"


_FIELDS = {
    _join_words(name): re.sub(r"\w+/\w+", lambda match: _join_words(match[0]), text)
    for name, text in ALL_FIELDS.items()
}
"""Fields by names without underscores."""


@cache
def find_decoder(name: str) -> Decoder:
    """Return the decoder of a message into an object with its fields as attributes.

    It raises an exception of any type for bytes that are not such a message.

    Args:
        name: package/Name, one of `ros_types.ALL_FIELDS`.
    """
    joined = _join_words(name)
    full = joined.replace("/", "/msg/")
    decode: Decoder = generate_dynamic(full, message_definition(joined, _FIELDS))[full]
    return decode
