"""Tables in Markdown, placed between two marks of a document."""

import os
from collections.abc import Container, Iterable, Sequence
from pathlib import Path

from angler_mjx.errors import ConfigError


def format_table(
    head: Sequence[str], rows: Iterable[Sequence[str]], *, text: Container[int] = (0,)
) -> str:
    """Return a table in Markdown.

    Args:
        head: name of each column.
        rows: cells of each row.
        text: columns of text; the others are numbers, to the right.
    """
    rule = ["---" if i in text else "---:" for i in range(len(head))]
    lines = [head, rule, *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def require_marks(document: Path, begin: str, end: str) -> None:
    """Refuse a document that `replace_section` could not write into.

    Raises:
        ConfigError: as `replace_section`.
    """
    _split_document(document, begin, end)


def replace_section(document: Path, begin: str, body: str, end: str) -> None:
    """Replace the text between two marks of a document.

    Args:
        document: document with the marks.
        begin: the mark before.
        body: new text between the marks.
        end: the mark behind.

    Raises:
        ConfigError: the document cannot be read or written, or has no marks.
    """
    before, after = _split_document(document, begin, end)
    try:
        document.write_text(f"{before}{begin}\n{body}\n{end}{after}", encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"--out {document}: {error.strerror or error}") from error


def image_link(document: Path, figure: Path) -> str:
    """Return a Markdown line that shows a figure, with its file name as the text."""
    title = figure.stem.replace("_", " ")
    return f"![{title}]({os.path.relpath(figure, document.parent)})"


def _split_document(document: Path, begin: str, end: str) -> tuple[str, str]:
    """Return the text before the first mark and the text behind the second."""
    try:
        old = document.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"--out {document}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"--out {document}: cannot be read ({error})") from error
    before, mark, rest = old.partition(begin)
    _, last, after = rest.partition(end)
    if not mark or not last:
        raise ConfigError(f"--out {document}: has no place for tables ({begin} ... {end})")
    return before, after
