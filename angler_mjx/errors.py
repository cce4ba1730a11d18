"""The errors that angler raises at its boundary, and how they show what a person gave.

Inside traced code nothing raises: a robot that diverges carries an outcome. Everything here is
raised on the host, before or after a device call, and says what was wrong, where, and what to do.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

SHOWN = 60
"""Characters of a value that a message repeats."""

_ENDLESS = re.compile(r"\S{400,}")
"""A name or value that a message repeats and that nobody would read."""

_LEVELS = 3
"""Of tables and lists within one another that a message repeats."""


class AnglerError(Exception):
    """Base of every error that angler raises on purpose; the CLI prints it and exits with 2."""

    def __str__(self) -> str:
        """The message; control characters in it are escaped, and what has no end is cut."""
        return _ENDLESS.sub(lambda word: word[0][:SHOWN] + "...", escaped(super().__str__()))


class ConfigError(AnglerError, ValueError):
    """A file, flag or argument holds something that cannot be used."""


class UnsupportedError(AnglerError, NotImplementedError):
    """What was asked for exists elsewhere: another engine, device or extra."""


class RunError(AnglerError, RuntimeError):
    """A run cannot start or go on: folder, disk, device."""


def escaped(text: str, *, keep: str = "\n") -> str:
    """A text whose characters that do not print (but for those to keep) are written as Python does.

    A terminal takes orders by such characters, and the names and values of files can hold them.
    """
    if text.isprintable():
        return text
    return "".join(
        char if char in keep or char.isprintable() else ascii(char)[1:-1] for char in text
    )


def shown(value: Any, most: int = SHOWN) -> str:
    """A value for a message, on one line, cut where it is longer than ``most`` characters."""
    text = "".join(_pieces(value, most, _LEVELS))
    return text if len(text) <= most else text[: most - 3] + "..."


def size(n_byte: float) -> str:
    """A number of bytes for a message, in the unit that fits it, as in "3.46 MB"."""
    for unit, of in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if n_byte >= of:
            return f"{n_byte / of:.3g} {unit}"
    return f"{n_byte:.0f} bytes"


def _pieces(value: Any, most: int, levels: int) -> Iterator[str]:
    """Pieces of a value's text, of which little more than ``most`` characters are made."""
    match value:
        case str():
            yield repr(value[: most + 1])
        case int() if value.bit_length() > 190:
            yield f"(an integer of {value.bit_length()} bits)"
        case Mapping() | list() | tuple() if levels == 0:
            yield "{...}" if isinstance(value, Mapping) else "[...]"
        case Mapping():
            entries = (
                [f"{shown(key, most)}: ", *_pieces(entry, most, levels - 1)]
                for key, entry in value.items()
            )
            yield from _within("{", entries, "}", most)
        case list() | tuple():
            yield from _within("[", (_pieces(x, most, levels - 1) for x in value), "]", most)
        case _:
            yield repr(value)


def _within(begin: str, entries: Iterable[Iterable[str]], end: str, most: int) -> Iterator[str]:
    length = 0
    yield begin
    for i, entry in enumerate(entries):
        piece = (", " if i else "") + "".join(entry)
        length += len(piece)
        yield piece
        if length > most:
            return
    yield end
