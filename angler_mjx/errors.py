"""Errors that angler raises at its boundary, and the format of user inputs in their messages.

Traced code raises no errors: a robot that diverges carries an outcome. These errors are raised on
the host, before or after a device call, and state the fault, its place, and a remedy.
"""

import re
import sysconfig
import traceback
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

MAX_VALUE_CHARACTERS = 60
"""Max number of characters of a value in a message."""

MAX_ERROR_CHARACTERS = 300
"""Max number of characters of an exception's text in a message."""

_UNBROKEN_TEXT = re.compile(r"\S{400,}")
"""A name or value too long to read in a message."""

_MAX_LEVELS = 3
"""Max depth of nested tables and lists in a message."""


class AnglerError(Exception):
    """Base of every error that angler raises on purpose; the CLI prints it and exits with 2."""

    def __str__(self) -> str:
        """Return the message, with control characters escaped and overlong values cut."""
        return _UNBROKEN_TEXT.sub(
            lambda word: word[0][:MAX_VALUE_CHARACTERS] + "...",
            escape_control_characters(super().__str__()),
        )


class ConfigError(AnglerError, ValueError):
    """A file, flag or argument holds a value that cannot be used."""


class UnsupportedError(AnglerError, NotImplementedError):
    """The requested feature is not supported here, but by another engine, device or extra."""


class RunError(AnglerError, RuntimeError):
    """A run cannot start or continue: folder, disk, device."""


def describe_error(
    error: BaseException, file: Path | None = None, max_characters: int = MAX_ERROR_CHARACTERS
) -> str:
    """Return type, text and place of a user code's exception, on one line.

    Args:
        error: caught exception.
        file: file of the user's code, where it is a single file.
        max_characters: characters of the exception's text.

    Returns:
        As in "KeyError: 'start' (straight.py:7)": the innermost line of the traceback in a user's
        file.
    """
    name, text = type(error).__name__, " ".join(str(error).split())[:max_characters].rstrip()
    message = f"{name}: {text}" if text else name
    line = _innermost_frame(error, file)
    return message if line is None else f"{message} ({Path(line.filename).name}:{line.lineno})"


@contextmanager
def report_user_errors(description: str, file: Path | None = None) -> Iterator[None]:
    """Turn exceptions of user code into one message.

    Args:
        description: name of the code in the message.
        file: file of the code, where it is a single file.

    Raises:
        ConfigError: the code raised an exception; gives its type, text, file and line.
    """
    try:
        yield
    except AnglerError:
        raise
    except Exception as error:  # a user's code may raise any exception
        raise ConfigError(f"{description} raised {describe_error(error, file)}") from error


def _innermost_frame(error: BaseException, file: Path | None) -> traceback.FrameSummary | None:
    """Return the innermost line in a user's file, else of any code outside angler."""
    lines = list(traceback.extract_tb(error.__traceback__))
    if isinstance(error, SyntaxError) and error.filename:
        lines.append(traceback.FrameSummary(error.filename, error.lineno, ""))
    outside_frames = [line for line in lines if not _is_of(line.filename, _ANGLER)]
    file_frames = [line for line in lines if file is not None and line.filename == str(file)]
    user_frames = [line for line in outside_frames if not _is_of(line.filename, _LIBRARIES)]
    return next(
        (frames[-1] for frames in (user_frames, file_frames, outside_frames, lines) if frames), None
    )


_LIBRARIES = tuple({sysconfig.get_path(key) for key in ("stdlib", "platstdlib", "purelib")})
_ANGLER = (str(Path(__file__).parent), "<")
"""Folders of code that is not the user's; ``<`` begins the names of code without a file."""


def _is_of(filename: str, folders: tuple[str, ...]) -> bool:
    return filename.startswith(folders)


def escape_control_characters(text: str, *, keep: str = "\n") -> str:
    """Return a text with its non-printing characters, except those to keep, escaped as by Python.

    Terminals interpret such characters, and names and values of files can hold them.
    """
    if text.isprintable():
        return text
    return "".join(
        char if char in keep or char.isprintable() else ascii(char)[1:-1] for char in text
    )


def format_value(value: object, max_characters: int = MAX_VALUE_CHARACTERS) -> str:
    """Return a value for a message, on one line, cut after ``max_characters`` characters."""
    text = "".join(_value_pieces(value, max_characters, _MAX_LEVELS))
    return text if len(text) <= max_characters else text[: max_characters - 3] + "..."


def format_bytes(n_byte: float) -> str:
    """Return a number of bytes for a message, in a suitable unit, as in "3.46 MB"."""
    for unit, n_unit_bytes in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if n_byte >= n_unit_bytes:
            return f"{n_byte / n_unit_bytes:.3g} {unit}"
    return f"{n_byte:.0f} bytes"


def _value_pieces(value: object, max_characters: int, levels: int) -> Iterator[str]:
    """Yield pieces of a value's text, little more than ``max_characters`` characters in total."""
    match value:
        case str():
            yield repr(value[: max_characters + 1])
        case int() if value.bit_length() > 190:
            yield f"(an integer of {value.bit_length()} bits)"
        case Mapping() | list() | tuple() if levels == 0:
            yield "{...}" if isinstance(value, Mapping) else "[...]"
        case Mapping():
            entries = (
                [
                    f"{format_value(key, max_characters)}: ",
                    *_value_pieces(entry, max_characters, levels - 1),
                ]
                for key, entry in value.items()
            )
            yield from _enclosed_pieces("{", entries, "}", max_characters)
        case list() | tuple():
            yield from _enclosed_pieces(
                "[",
                (_value_pieces(x, max_characters, levels - 1) for x in value),
                "]",
                max_characters,
            )
        case _:
            yield repr(value)


def _enclosed_pieces(
    begin: str, entries: Iterable[Iterable[str]], end: str, max_characters: int
) -> Iterator[str]:
    length = 0
    yield begin
    for i, entry in enumerate(entries):
        piece = (", " if i else "") + "".join(entry)
        length += len(piece)
        yield piece
        if length > max_characters:
            return
    yield end
