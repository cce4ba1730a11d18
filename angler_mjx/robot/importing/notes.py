"""List of what an import dropped, assumed, snapped or converted, with the lines it came from."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

type NoteKind = Literal["dropped", "assumed", "snapped", "converted"]

MAX_LINES = 4
"""Max number of lines that a printed note names."""


@dataclass(frozen=True, kw_only=True)
class Location:
    """Line of a file, and the macro call that repeats it."""

    file: Path
    line: int
    caller: "Location | None" = None
    """Line of the macro call; None outside macros."""

    def __str__(self) -> str:
        """Return "urdf/heavy.xacro:57", with the outermost macro call where there is one."""
        outer = self.caller
        while outer is not None and outer.caller is not None:
            outer = outer.caller
        text = f"{self.file_label}:{self.line}"
        return text if outer is None else f"{text} (called at {outer.file_label}:{outer.line})"

    @property
    def file_label(self) -> str:
        """Return the last two parts of the file's path: many files are named model.sdf."""
        return "/".join(self.file.absolute().parts[-2:])


@dataclass(frozen=True, kw_only=True)
class Note:
    """Difference between a foreign file and what was imported."""

    kind: NoteKind
    text: str
    locations: tuple[object, ...]
    """Lines or keys that it came from; empty for what no line states."""

    def __str__(self) -> str:
        """Return the note on one line, with at most `MAX_LINES` locations."""
        lines = list(dict.fromkeys(map(str, self.locations)))
        if not lines:
            return f"{self.kind}: {self.text}"
        more = f" and {len(lines) - MAX_LINES} more" if len(lines) > MAX_LINES else ""
        return f"{self.kind}: {self.text} [{', '.join(lines[:MAX_LINES])}{more}]"


@dataclass
class Notes:
    """Notes of an import, in order; notes of equal text are joined."""

    _entries: dict[tuple[NoteKind, str], list[object]] = field(default_factory=dict)

    def add(self, kind: NoteKind, text: str, *locations: object) -> None:
        """Add a note on these lines: of `Location`, or of another class that prints as one."""
        entry = self._entries.setdefault((kind, text), [])
        entry.extend(location for location in locations if location is not None)

    def __iter__(self) -> Iterator[Note]:
        """Yield the notes in the order of their first line."""
        for (kind, text), locations in self._entries.items():
            yield Note(kind=kind, text=text, locations=tuple(locations))
