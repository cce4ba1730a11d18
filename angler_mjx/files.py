"""Reading TOML files into checked models, with every fault of a file reported at once.

The only place that turns a pydantic complaint into the message a person reads.
"""

import tomllib
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from angler_mjx.errors import ConfigError


class FileModel(BaseModel):
    """Base of every model that is read from a file: frozen, no unknown keys, no NaN, no inf."""

    model_config = ConfigDict(
        frozen=True, extra="forbid", allow_inf_nan=False, protected_namespaces=()
    )


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file.

    Raises:
        ConfigError: the file is missing, unreadable or not TOML.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read ({error})") from error
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: not valid TOML: {error}") from error


def parse[M: FileModel](model: type[M], data: dict[str, Any], *, source: str) -> M:
    """Check ``data`` against ``model``.

    Args:
        model: The model to build.
        data: Plain tables and values, as TOML gives them.
        source: Name of the file, for the message.

    Raises:
        ConfigError: one message that lists every fault with its key, value and reason.
    """
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise ConfigError(_explain(error, source)) from error


def _explain(error: ValidationError, source: str) -> str:
    faults = [_fault(dict(e)) for e in error.errors(include_url=False)]
    head = f"{source}: {len(faults)} fault{'s' if len(faults) > 1 else ''}"
    return "\n".join([head, *(f"  {fault}" for fault in faults)])


def _fault(entry: dict[str, Any]) -> str:
    parts = [part for part in entry["loc"] if not str(part).startswith("function-")]
    key = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in parts)
    key = key.lstrip(".") or "(whole file)"
    if entry["type"] == "extra_forbidden":
        return f"{key} = {entry['input']!r}: unknown key; remove it or correct spelling and unit"
    if entry["type"] == "missing":
        return f"{key}: missing; add it"
    message = str(entry["msg"]).removeprefix("Value error, ")
    shown = repr(entry["input"])
    shown = shown if len(shown) <= 80 else shown[:77] + "..."
    return f"{key} = {shown}: {message}"
