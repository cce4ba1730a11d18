"""Reading TOML and JSON files into checked models, with every fault of a file reported at once.

The only place that turns a pydantic complaint into the message a person reads. What no model can
take (integers beyond 64 bits, tables within tables without end) is found here before any model
sees it.
"""

import json
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError, ValidationInfo, model_validator

from angler_mjx.errors import ConfigError, escaped, shown

TOML_BYTES, JSON_BYTES = 1 << 19, 1 << 24
"""Largest files that are read: what a person writes is far smaller, and so is a fleet's plan."""

FOLDER = "folder"
"""Context of a check: where paths in a file begin; the working directory if it is not there."""

_DEEPEST = 32
"""Tables within tables that a file may hold; models have 8 at most."""
_FAULTS = 20
"""Faults of a file that are told; a file with more is another kind of file."""
_FAULTS_READ = 1000
_LINE = 400
"""Characters of a fault."""
_PARTS = 64
"""Parts of a dotted key. Python's reader takes time with the square of their number."""

_PART = r"(?:(?<![\w-])[\w-]++|\"[^\"\n]*+\"|'[^'\n]*+')[ \t]*+\.[ \t]*+"
_DOTTED = re.compile(f"(?:{_PART}){{{_PARTS}}}")


class FileModel(BaseModel):
    """Base of every model that is read from a file: frozen, no unknown keys, no NaN, no inf.

    Types are strict: an integer will do for a float, but neither text nor true for a number.
    """

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        allow_inf_nan=False,
        strict=True,
        protected_namespaces=(),
    )

    @model_validator(mode="before")
    @classmethod
    def _plain(cls, data: Any) -> Any:
        """Lists are tuples here, for those who build a model in Python too."""
        return _tamed(data, 0) if isinstance(data, Mapping) else data


def folder_of(info: ValidationInfo) -> Path:
    """Where paths begin in the table that is checked: see `FOLDER`."""
    return Path((info.context or {}).get(FOLDER) or Path.cwd())


def absolute(file: str, info: ValidationInfo) -> str:
    """A path from the folder of the file that names it, made absolute; for validators."""
    return str((folder_of(info) / file).absolute())


@dataclass(frozen=True)
class Fault:
    """One thing that is wrong with a table."""

    key: tuple[str | int, ...]
    """Where: names of tables and keys, and indices from 0."""
    text: str
    """Key, value and reason, on one line."""


class FaultyError(Exception):
    """A table that is no model."""

    def __init__(self, faults: Sequence[Fault]) -> None:
        """Everything that is wrong with it."""
        super().__init__(f"{len(faults)} faults")
        self.faults = tuple(faults)


def named(path: Path | str) -> str:
    """A path for a message: on one line whatever its characters are."""
    return escaped(str(path), keep="")


def read_text(path: Path, most_bytes: int) -> str:
    """Read a text file in UTF-8; a byte order mark at its beginning is no part of the text.

    Raises:
        ConfigError: the file is missing, unreadable, not UTF-8, or larger than ``most_bytes``.
    """
    try:
        with path.open("rb") as file:
            data = file.read(most_bytes + 1)
        if len(data) > most_bytes:
            raise ConfigError(
                f"{named(path)}: has more than {most_bytes / 2**20:g} MiB; "
                "this is no file of the kind that is read here"
            )
        return data.decode("utf-8-sig")
    except (OSError, ValueError) as error:  # ValueError: not UTF-8, or a name with a zero byte
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(f"{named(path)}: cannot be read ({error})") from error


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        ConfigError: the file is missing, unreadable or not TOML.
    """
    return toml_of(read_text(path, TOML_BYTES), named(path))


def toml_of(text: str, source: str) -> dict[str, Any]:
    """What a text in TOML holds.

    Raises:
        ConfigError: it is not TOML; ``source`` is what the message calls it.
    """
    if _DOTTED.search(text):
        raise ConfigError(
            f"{source}: a key has {_PARTS} parts or more; write shorter keys, in tables"
        )
    table: dict[str, Any] = _understood(source, "TOML", lambda: tomllib.loads(text))
    return table


def read_json(path: Path) -> Any:
    """Read a JSON file; a key that stands twice in an object is refused.

    Raises:
        ConfigError: the file is missing, unreadable or not JSON.
    """
    return json_of(read_text(path, JSON_BYTES), named(path))


def json_of(text: str, source: str) -> Any:
    """What a text in JSON holds; a key that stands twice in an object is refused.

    Raises:
        ConfigError: it is not JSON; ``source`` is what the message calls it.
    """
    return _understood(source, "JSON", lambda: json.loads(text, object_pairs_hook=_once))


def _understood(source: str, kind: str, read: Callable[[], Any]) -> Any:
    try:
        return read()
    except _TwiceError as error:
        raise ConfigError(
            f"{source}: key {error} is there twice in one object; give it once"
        ) from error
    except RecursionError as error:
        raise ConfigError(
            f"{source}: not valid {kind}: nested too deep; {_DEEPEST} levels can be read"
        ) from error
    except ValueError as error:
        # Beside faults of the language: numbers with more digits than Python converts.
        reason = str(error).partition(";")[0] if "digits" in str(error) else str(error)
        raise ConfigError(f"{source}: not valid {kind}: {reason}") from error


class _TwiceError(Exception):
    """A key that an object has twice."""


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        left = list(table)
        # The keys of a table stand in the order in which they first came.
        twice = next(name for i, (name, _) in enumerate(pairs) if i >= len(left) or name != left[i])
        raise _TwiceError(shown(twice))
    return table


def parse[M: FileModel](
    model: type[M], data: Any, *, source: str, context: Mapping[str, Any] | None = None
) -> M:
    """Check ``data`` against ``model``.

    Args:
        model: The model to build.
        data: Plain tables and values, as TOML and JSON give them.
        source: Name of the file, for the message.
        context: For validators.

    Raises:
        ConfigError: one message that lists every fault with its key, value and reason.
    """
    try:
        return check(model, data, context)
    except FaultyError as error:
        raise ConfigError(listed(source, [fault.text for fault in error.faults])) from error


def check[M: FileModel](model: type[M], data: Any, context: Mapping[str, Any] | None = None) -> M:
    """As `parse`, for callers that put the message together themselves.

    Args:
        model: The model to build.
        data: Plain tables and values.
        context: For validators.

    Raises:
        FaultyError: with every fault.
    """
    try:
        return model.model_validate(_tamed(data, 0), context=dict(context or {}))
    except ValidationError as error:
        if error.error_count() > _FAULTS_READ:
            text = f"{error.error_count()} faults; this is another kind of file"
            raise FaultyError([Fault((), text)]) from error
        entries = [dict(entry) for entry in error.errors(include_url=False)]
        raise FaultyError([_fault(entry) for entry in entries if not _bogus(entry)]) from error


def listed(source: str, faults: Sequence[str]) -> str:
    """The message of a file's faults: a line for each."""
    head = f"{named(source)}: {len(faults)} fault{'s' if len(faults) != 1 else ''}"
    lines = [f"  {fault}" for fault in faults[:_FAULTS]]
    more = [f"  and {len(faults) - _FAULTS} more"] if len(faults) > _FAULTS else []
    return "\n".join([head, *lines, *more])


@dataclass(frozen=True)
class _Refused:
    """Stands for a value that no model may see."""

    text: str
    reason: str

    def __repr__(self) -> str:
        return self.text


def _tamed(value: Any, level: int) -> Any:
    """The same with tuples for lists, and with `_Refused` for what no model can take."""
    match value:
        case Mapping() | list() | tuple() if level > _DEEPEST:
            return _Refused("...", f"nested too deep; {_DEEPEST} levels can be read")
        case Mapping():
            return {
                (escaped(key, keep="") if isinstance(key, str) else key): _tamed(entry, level + 1)
                for key, entry in value.items()
            }
        case list() | tuple():
            return tuple(_tamed(entry, level + 1) for entry in value)
        case int() if value.bit_length() > 63:
            return _Refused(shown(value), "beyond 64 bits; give a smaller number")
        case str() if any("\ud800" <= char <= "\udfff" for char in value):
            return _Refused(shown(value), "holds half of a character (a surrogate); write it whole")
        case np.generic():
            return _tamed(value.item(), level)
    return value


def _bogus(entry: Mapping[str, Any]) -> bool:
    """Whether an entry follows from others: a tuple lacks its faulty members to pydantic."""
    if entry["type"] != "too_short":
        return False
    return len(entry["input"]) >= int(entry["ctx"]["min_length"])


def _fault(entry: dict[str, Any]) -> Fault:
    key = tuple(part for part in entry["loc"] if not str(part).startswith("function-"))
    path = "".join(
        f"[{part}]" if isinstance(part, int) else f".{escaped(part, keep='')}" for part in key
    )
    path = _cut(path.lstrip(".") or "(whole file)", 120)
    value = entry["input"]
    if entry["type"] == "missing":
        return Fault(key, f"{path}: missing; add it")
    if isinstance(value, _Refused):
        return Fault(key, f"{path} = {value!r}: {value.reason}")
    if entry["type"] == "extra_forbidden":
        remedy = "unknown key; remove it or correct spelling and unit"
        return Fault(key, f"{path} = {shown(value)}: {remedy}")
    message = str(entry["msg"]).removeprefix("Value error, ").replace("valid tuple", "valid list")
    if entry["type"] in ("too_short", "too_long"):
        least = entry["type"] == "too_short"
        bound = entry["ctx"]["min_length" if least else "max_length"]
        message = f"has {len(value)} entries; give {'at least' if least else 'at most'} {bound}"
    message = "\n  ".join(_cut(line, _LINE) for line in message.splitlines())
    if entry["type"] == "value_error" and isinstance(value, Mapping):
        # Of a whole table: the message says which of its keys.
        return Fault(key, f"{path}: {message}")
    return Fault(key, f"{path} = {shown(value)}: {message}")


def _cut(text: str, most: int) -> str:
    """A text of ``most`` characters at most, its middle left out."""
    half = most // 2 - 3
    return text if len(text) <= most else f"{text[:half]} ... {text[-half:]}"
