"""Reading of TOML and JSON files into checked models; all faults of a file are reported at once.

Only this module turns pydantic errors into user messages. Values that no model can take (integers
beyond 64 bits, unlimited nesting) are detected here before validation.
"""

import json
import re
import tomllib
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, TypeAliasType, get_args

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic_core import ErrorDetails

from angler_mjx.errors import ConfigError, escape_control_characters, format_value

type JsonValue = bool | int | float | str | list[JsonValue] | dict[str, JsonValue] | None
"""A value of a JSON file, as read."""
type JsonTable = dict[str, JsonValue]
"""A table of a JSON file, as read."""

MAX_TOML_BYTES, MAX_JSON_BYTES = 1 << 19, 1 << 24
"""Max file sizes, far above those of hand-written files and fleet plans."""

FOLDER_CONTEXT = "folder"
"""Context of a check: base folder of paths in a file; the working directory if absent."""
_SOURCE_CONTEXT = "source"
"""Context of a check: name of the file, for warnings."""

_MAX_LEVELS = 32
"""Max depth of nested tables in a file; models have 8 at most."""
_MAX_FAULTS = 20
"""Max number of reported faults; a file with more is of another kind."""
_MAX_FAULTS_READ = 1000
_MAX_FAULT_CHARACTERS = 400
"""Max number of characters of a fault."""
_MAX_KEY_PARTS = 64
"""Max number of parts of a dotted key. The run time of Python's reader is quadratic in it."""

_KEY_PART = r"(?:(?<![\w-])[\w-]++|\"[^\"\n]*+\"|'[^'\n]*+')[ \t]*+\.[ \t]*+"
_LONG_DOTTED_KEY = re.compile(f"(?:{_KEY_PART}){{{_MAX_KEY_PARTS}}}")


class RenamedKeyWarning(FutureWarning):
    """A file or a caller uses an old name of a key; it is accepted until 1.0."""


class FileModel(BaseModel):
    """Base of all models of files: frozen, no unknown keys, no NaN, no inf.

    Types are strict: an integer is accepted for a float, but neither text nor true for a number.

    Attributes:
        renamed_keys: old keys and the fields' new names, accepted until 1.0 with a
            `RenamedKeyWarning`; without a warning from JSON, which programs write.
        renamed_values: for fields by name, old values and the new ones, accepted likewise.
    """

    renamed_keys: ClassVar[Mapping[str, str]] = {}
    renamed_values: ClassVar[Mapping[str, Mapping[str, str]]] = {}

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        allow_inf_nan=False,
        strict=True,
        protected_namespaces=(),
    )

    @model_validator(mode="before")
    @classmethod
    def _normalise_table(cls, data: object, info: ValidationInfo) -> object:
        """Return a table with tuples for lists and new keys, for callers in Python too."""
        if not isinstance(data, Mapping):
            return data
        return _rename_keys(
            cls, _normalise_mapping(data, 0), (info.context or {}).get(_SOURCE_CONTEXT, "")
        )

    if not TYPE_CHECKING:  # hidden from type checkers, which would accept any attribute

        def __getattr__(self, name: str) -> object:
            """Return a field by its old name, with a `RenamedKeyWarning`."""
            today = type(self).renamed_keys.get(name)
            if today is None:
                return super().__getattr__(name)
            warnings.warn(
                f"{type(self).__name__}.{name} is {today} since 0.2; the old name works until 1.0",
                RenamedKeyWarning,
                stacklevel=2,
            )
            return getattr(self, today)


def rename_keys(
    model: type[FileModel], table: Mapping[str, object], source: str
) -> dict[str, object]:
    """Return a table with new keys, also in nested tables, before other tables are merged.

    Args:
        model: model of the table.
        table: plain tables and values.
        source: name of the file, for warnings; no warnings for JSON.

    Raises:
        ValueError: a key is given by both of its names.
    """
    renamed = _rename_keys(model, dict(table), source)
    for name, field in model.model_fields.items():
        value, models = renamed.get(name), list(_file_models(field.annotation))
        for entry_model in models:
            if isinstance(value, Mapping):
                value = rename_keys(entry_model, value, source)
            elif isinstance(value, list | tuple):
                value = [
                    rename_keys(entry_model, entry, source) if isinstance(entry, Mapping) else entry
                    for entry in value
                ]
        if models and name in renamed:
            renamed[name] = value
    return renamed


def _rename_keys(
    model: type[FileModel], table: dict[str, object], source: str
) -> dict[str, object]:
    for key in model.renamed_keys.keys() & table.keys():
        name = model.renamed_keys[key]
        if name in table:
            raise ValueError(f"{key} is {name} since 0.2; give {name} alone")
        _warn_of_name(source, f"key {key} is {name} since 0.2")
        table = {name if entry == key else entry: value for entry, value in table.items()}
    for key, names in model.renamed_values.items():
        value = table.get(key)
        if isinstance(value, str) and value in names:
            _warn_of_name(source, f'{key} = "{value}" is "{names[value]}" since 0.3')
            table = {**table, key: names[value]}
    return table


def _warn_of_name(source: str, text: str) -> None:
    """Warn of an old name in a file, unless it is JSON, which programs write."""
    if not source.endswith(".json"):
        where = f"{format_path(source)}: " if source else ""
        warnings.warn(f"{where}{text}; the old name is read until 1.0", RenamedKeyWarning, 4)


def dump_for_digest(model: FileModel) -> JsonTable:
    """Return the JSON table of a model with the original names of keys, so digests stay equal."""
    table: JsonTable = model.model_dump(mode="json")
    for name in type(model).model_fields:
        value = getattr(model, name)
        if isinstance(value, FileModel):
            table[name] = dump_for_digest(value)
        elif isinstance(value, tuple) and isinstance(dumped_values := table[name], list):
            table[name] = [
                dump_for_digest(entry) if isinstance(entry, FileModel) else dumped
                for entry, dumped in zip(value, dumped_values, strict=True)
            ]
    old_names = {new: old for old, new in model.renamed_keys.items()}
    return {old_names.get(name, name): entry for name, entry in table.items()}


def _file_models(annotation: object) -> Iterator[type[FileModel]]:
    """Yield the models in a field's type."""
    if isinstance(annotation, TypeAliasType):
        annotation = annotation.__value__
    if isinstance(annotation, type) and issubclass(annotation, FileModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _file_models(argument)


def base_folder(info: ValidationInfo) -> Path:
    """Return the base folder of paths in the checked table: see `FOLDER_CONTEXT`."""
    return Path((info.context or {}).get(FOLDER_CONTEXT) or Path.cwd())


def absolute_path(file: str, info: ValidationInfo) -> str:
    """Return the absolute path of a path relative to the naming file's folder; for validators."""
    return str((base_folder(info) / file).absolute())


@dataclass(frozen=True)
class Fault:
    """A fault in a table."""

    key: tuple[str | int, ...]
    """Location: names of tables and keys, and indices from 0."""
    text: str
    """Key, value and reason, on one line."""


class FaultyError(Exception):
    """A table does not fit its model."""

    def __init__(self, faults: Sequence[Fault]) -> None:
        """Set up the error with all faults of the table."""
        super().__init__(f"{len(faults)} faults")
        self.faults = tuple(faults)


def format_path(path: Path | str) -> str:
    """Return a path for a message, on one line."""
    return escape_control_characters(str(path), keep="")


def read_text(path: Path, max_bytes: int) -> str:
    """Read a text file in UTF-8, without a byte order mark at its beginning.

    Raises:
        ConfigError: the file is missing, unreadable, not UTF-8, or larger than ``max_bytes``.
    """
    try:
        with path.open("rb") as file:
            data = file.read(max_bytes + 1)
        if len(data) > max_bytes:
            raise ConfigError(
                f"{format_path(path)}: has more than {max_bytes / 2**20:g} MiB; "
                "this is no file of the kind that is read here"
            )
        return data.decode("utf-8-sig")
    except (OSError, ValueError) as error:  # ValueError: not UTF-8, or a name with a zero byte
        if isinstance(error, ConfigError):
            raise
        raise ConfigError(f"{format_path(path)}: cannot be read ({error})") from error


def read_toml(path: Path) -> JsonTable:
    """Read a TOML file.

    Raises:
        ConfigError: the file is missing, unreadable or not TOML.
    """
    return parse_toml(read_text(path, MAX_TOML_BYTES), format_path(path))


def parse_toml(text: str, source: str) -> JsonTable:
    """Parse a text in TOML.

    Raises:
        ConfigError: it is not TOML; ``source`` is its name in the message.
    """
    if _LONG_DOTTED_KEY.search(text):
        raise ConfigError(
            f"{source}: a key has {_MAX_KEY_PARTS} parts or more; write shorter keys, in tables"
        )
    return _parse_text(source, "TOML", lambda: tomllib.loads(text))


def read_json(path: Path) -> JsonValue:
    """Read a JSON file; a repeated key in an object is refused.

    Raises:
        ConfigError: the file is missing, unreadable or not JSON.
    """
    return parse_json(read_text(path, MAX_JSON_BYTES), format_path(path))


def parse_json(text: str, source: str) -> JsonValue:
    """Parse a text in JSON; a repeated key in an object is refused.

    Raises:
        ConfigError: it is not JSON; ``source`` is its name in the message.
    """
    value: JsonValue = _parse_text(
        source, "JSON", lambda: json.loads(text, object_pairs_hook=_unique_keys)
    )
    return value


def _parse_text[T](source: str, kind: str, parser: Callable[[], T]) -> T:
    try:
        return parser()
    except _DuplicateKeyError as error:
        raise ConfigError(
            f"{source}: key {error} is there twice in one object; give it once"
        ) from error
    except RecursionError as error:
        raise ConfigError(
            f"{source}: not valid {kind}: nested too deep; {_MAX_LEVELS} levels can be read"
        ) from error
    except ValueError as error:
        # Beside syntax errors: numbers with more digits than Python converts.
        reason = str(error).partition(";")[0] if "digits" in str(error) else str(error)
        raise ConfigError(f"{source}: not valid {kind}: {reason}") from error


class _DuplicateKeyError(Exception):
    """A repeated key of an object."""


def _unique_keys(pairs: list[tuple[str, JsonValue]]) -> JsonTable:
    table = dict(pairs)
    if len(table) < len(pairs):
        unique_keys = list(table)
        # Keys of a table keep the order of their first occurrence.
        duplicate = next(
            name
            for i, (name, _) in enumerate(pairs)
            if i >= len(unique_keys) or name != unique_keys[i]
        )
        raise _DuplicateKeyError(format_value(duplicate))
    return table


def parse_model[M: FileModel](
    model: type[M], data: object, *, source: str, context: Mapping[str, object] | None = None
) -> M:
    """Check ``data`` against ``model``.

    Args:
        model: The model to build.
        data: Plain tables and values, as read from TOML and JSON.
        source: Name of the file, for the message.
        context: Context for validators.

    Raises:
        ConfigError: one message that lists every fault with its key, value and reason.
    """
    try:
        return validate_model(model, data, {**(context or {}), _SOURCE_CONTEXT: source})
    except FaultyError as error:
        raise ConfigError(format_faults(source, [fault.text for fault in error.faults])) from error


def validate_model[M: FileModel](
    model: type[M], data: object, context: Mapping[str, object] | None = None
) -> M:
    """Check ``data`` as `parse_model` does, for callers that compose the message themselves.

    Args:
        model: The model to build.
        data: Plain tables and values.
        context: Context for validators.

    Raises:
        FaultyError: with every fault.
    """
    try:
        return model.model_validate(_normalise_value(data, 0), context=dict(context or {}))
    except ValidationError as error:
        if error.error_count() > _MAX_FAULTS_READ:
            text = f"{error.error_count()} faults; this is another kind of file"
            raise FaultyError([Fault((), text)]) from error
        entries = error.errors(include_url=False)
        raise FaultyError(
            [_build_fault(entry) for entry in entries if not _is_consequent(entry)]
        ) from error


def format_faults(source: str, faults: Sequence[str]) -> str:
    """Return the message of a file's faults, one line for each."""
    head = f"{format_path(source)}: {len(faults)} fault{'s' if len(faults) != 1 else ''}"
    lines = [f"  {fault}" for fault in faults[:_MAX_FAULTS]]
    more = [f"  and {len(faults) - _MAX_FAULTS} more"] if len(faults) > _MAX_FAULTS else []
    return "\n".join([head, *lines, *more])


@dataclass(frozen=True)
class _RejectedValue:
    """A placeholder for a value that no model can take."""

    text: str
    reason: str

    def __repr__(self) -> str:
        return self.text


def _normalise_mapping(table: Mapping[str, object], level: int) -> dict[str, object]:
    """Return a table with the values of `_normalise_value`."""
    return {
        (
            escape_control_characters(key, keep="") if isinstance(key, str) else key
        ): _normalise_value(entry, level + 1)
        for key, entry in table.items()
    }


def _normalise_value(value: object, level: int) -> object:
    """Return a value with tuples for lists, and `_RejectedValue` for values no model can take."""
    match value:
        case Mapping() | list() | tuple() if level > _MAX_LEVELS:
            return _RejectedValue("...", f"nested too deep; {_MAX_LEVELS} levels can be read")
        case Mapping():
            return _normalise_mapping(value, level)
        case list() | tuple():
            return tuple(_normalise_value(entry, level + 1) for entry in value)
        case int() if value.bit_length() > 63:
            return _RejectedValue(format_value(value), "beyond 64 bits; give a smaller number")
        case str() if any("\ud800" <= char <= "\udfff" for char in value):
            return _RejectedValue(
                format_value(value), "holds half of a character (a surrogate); write it whole"
            )
        case np.generic():
            return _normalise_value(value.item(), level)
    return value


def _is_consequent(entry: ErrorDetails) -> bool:
    """Return whether an entry follows from others: pydantic drops faulty members of a tuple."""
    if entry["type"] != "too_short":
        return False
    return len(entry["input"]) >= int(entry["ctx"]["min_length"])


def _build_fault(entry: ErrorDetails) -> Fault:
    key = tuple(part for part in entry["loc"] if not str(part).startswith("function-"))
    path = "".join(
        f"[{part}]" if isinstance(part, int) else f".{escape_control_characters(part, keep='')}"
        for part in key
    )
    path = _shorten(path.lstrip(".") or "(whole file)", 120)
    value = entry["input"]
    if entry["type"] == "missing":
        return Fault(key, f"{path}: missing; add it")
    if isinstance(value, _RejectedValue):
        return Fault(key, f"{path} = {value!r}: {value.reason}")
    if entry["type"] == "extra_forbidden":
        advice = "unknown key; remove it or correct spelling and unit"
        return Fault(key, f"{path} = {format_value(value)}: {advice}")
    message = str(entry["msg"]).removeprefix("Value error, ").replace("valid tuple", "valid list")
    if entry["type"] in ("too_short", "too_long"):
        is_too_short = entry["type"] == "too_short"
        bound = entry["ctx"]["min_length" if is_too_short else "max_length"]
        message = (
            f"has {len(value)} entries; give {'at least' if is_too_short else 'at most'} {bound}"
        )
    message = "\n  ".join(_shorten(line, _MAX_FAULT_CHARACTERS) for line in message.splitlines())
    if entry["type"] == "value_error" and isinstance(value, Mapping):
        # Of a whole table: the message names its keys.
        return Fault(key, f"{path}: {message}")
    return Fault(key, f"{path} = {format_value(value)}: {message}")


def _shorten(text: str, max_characters: int) -> str:
    """Return a text of ``max_characters`` characters at most, with its middle left out."""
    half = max_characters // 2 - 3
    return text if len(text) <= max_characters else f"{text[:half]} ... {text[-half:]}"
