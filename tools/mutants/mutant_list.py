"""Mutants of a stored list, applied to the present files.

A list is a file of JSON lines, each with ``room``, ``file``, ``line``, ``operator`` and ``diff``
(unified, one hunk). Tests that are written after the list was stored are measured by faults that
were not selected afterwards.
"""

import ast
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict

from tools.mutants.mutant import Mutant, build_mutant

_HEADER = re.compile(r"@@ -(\d+)")
_KEYS = ("room", "file", "line", "operator", "diff")


class ListError(ValueError):
    """Stored list that cannot be read."""


@dataclass(frozen=True, kw_only=True)
class MutantList:
    """Mutants of a list."""

    rooms: tuple[str, ...]
    """Folders of the rows, in the order of the list."""
    mutants: list[Mutant]
    gone: list[str]
    """``file:line`` of the rows whose lines no longer stand in their file."""


def load_list(root: Path, file: Path, folders: Sequence[str] | None = None) -> MutantList:
    """Apply each diff of a list to its present file.

    Args:
        root: root of the tree.
        file: list file.
        folders: rooms whose rows are taken; all of the list if left out.

    Raises:
        ListError: the list does not exist, a row is not JSON or lacks a key, or no row is of a
            room in ``folders``.
    """
    rows = [row for row in _read_rows(file) if folders is None or row["room"] in folders]
    if not rows:
        raise ListError(f"{file}: no row of {', '.join(folders or ())}; name rooms of the list")
    mutants, gone = [], []
    for row in rows:
        mutant = _apply_row(root, row)
        if mutant is None:
            gone.append(f"{row['file']}:{row['line']}")
        else:
            mutants.append(mutant)
    rooms = tuple(dict.fromkeys(row["room"] for row in rows))
    return MutantList(rooms=rooms, mutants=mutants, gone=gone)


class ListedMutant(TypedDict):
    """Row of a list."""

    room: str
    """Folder, by which lists are chosen."""
    file: str
    diff: str
    operator: str


def _read_rows(file: Path) -> list[ListedMutant]:
    """Return the rows of a list.

    Raises:
        ListError: see `load_list`.
    """
    if not file.is_file():
        raise ListError(f"{file}: there is no such list; give a file of JSON lines")
    rows = []
    for number, text in enumerate(file.read_text().splitlines(), start=1):
        try:
            row = json.loads(text)
        except json.JSONDecodeError as error:
            raise ListError(f"{file}:{number}: not JSON ({error.msg}); mend the line") from None
        if missing := [key for key in _KEYS if key not in row]:
            raise ListError(f"{file}:{number}: {missing[0]!r} is missing; add it")
        rows.append(row)
    return rows


def _apply_row(root: Path, row: ListedMutant) -> Mutant | None:
    """Return the mutant of a row, or None if its lines no longer stand in the file."""
    path = root / row["file"]
    if not path.is_file():
        return None
    before = path.read_text()
    lines = before.splitlines(keepends=True)
    header, *hunk = row["diff"].splitlines()[2:]
    leading, removed, added, trailing = _split_hunk(hunk)
    match = _HEADER.match(header)
    stored_at = int(match[1]) - 1 + len(leading) if match else -1
    position = _find_position(
        [line.rstrip("\n") for line in lines], leading, removed, trailing, stored_at
    )
    if position is None:
        return None
    after = "".join(
        [*lines[:position], *(f"{line}\n" for line in added), *lines[position + len(removed) :]]
    )
    if not _is_python(after):
        return None
    return build_mutant(
        file=row["file"],
        before=before,
        after=after,
        line=position + 1,
        operator=row["operator"],
        fault="\n".join(added),
    )


def _is_python(code: str) -> bool:
    try:
        ast.parse(code)
    except SyntaxError:
        return False
    return True


def _split_hunk(hunk: Sequence[str]) -> tuple[list[str], list[str], list[str], list[str]]:
    """Return a hunk's lines before the change, removed, added, and after the change."""
    edited = [i for i, line in enumerate(hunk) if line[:1] in ("-", "+")]
    first, last = edited[0], edited[-1]
    middle = hunk[first : last + 1]
    return (
        [line[1:] for line in hunk[:first]],
        [line[1:] for line in middle if line[:1] != "+"],
        [line[1:] for line in middle if line[:1] != "-"],
        [line[1:] for line in hunk[last + 1 :]],
    )


def _find_position(
    lines: Sequence[str],
    leading: Sequence[str],
    removed: Sequence[str],
    trailing: Sequence[str],
    stored_at: int,
) -> int | None:
    """Return the index in ``lines`` at which ``removed`` begins, with as much context as matches.

    Context is reduced line by line from outside, as ``patch`` does. Several matches with the most
    context that matches count only if one of them begins at ``stored_at``, where the list has it.
    """
    for context in range(max(len(leading), len(trailing)), -1, -1):
        head = leading[len(leading) - min(context, len(leading)) :]
        block = [*head, *removed, *trailing[:context]]
        starts = [
            i + len(head)
            for i in range(len(lines) - len(block) + 1)
            if list(lines[i : i + len(block)]) == block
        ]
        if starts:
            if len(starts) == 1:
                return starts[0]
            return stored_at if stored_at in starts else None
    return None
