"""Computed parts of docs/generated/validation.md; the text between them is unchanged."""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from angler_mjx.errors import ConfigError
from angler_mjx.testing.validation.results import (
    Deviation,
    MeasurementMetadata,
    TermResult,
    ValidationResult,
    format_provenance,
)
from angler_mjx.testing.validation.terms import PagePart, StoredTerm, StudyTerm, Term, Terms

PAGE_PATH = Path("docs/generated/validation.md")
TERM_PARTS: tuple[PagePart, ...] = ("terms", "links", "energy", "control", "engines", "clearance")

_NOT_YET = "*Not measured yet.*"


def part_markers(name: str) -> tuple[str, str]:
    """Return the lines before and after a computed part."""
    return f"<!-- validation:{name} begin -->", f"<!-- validation:{name} end -->"


def replace_part(text: str, name: str, body: str, source: str) -> str:
    """Return a text with a new body between the marks of a part.

    Raises:
        ConfigError: the text has no such marks, or has them twice.
    """
    begin, end = part_markers(name)
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise ConfigError(f"{source}: needs the lines {begin} and {end} once, in this order")
    head, tail = text.index(begin) + len(begin), text.index(end)
    return f"{text[:head]}\n{body}\n{text[tail:]}"


def build_parts(
    terms: Terms, result: ValidationResult, stored: Mapping[str, TermResult], speed: str
) -> dict[str, str]:
    """Return the body of each computed part, by name.

    Args:
        terms: the validated terms.
        result: results, new or earlier.
        stored: results from elsewhere, by name.
        speed: the table of speeds.
    """
    bodies: dict[str, str] = {
        part: format_table([term for term in terms.term if term.part == part], result)
        for part in TERM_PARTS
    }
    for study in terms.study:
        bodies[study.name] = _format_result(result.studies.get(study.name), _format_command(study))
    for stored_term in terms.stored:
        bodies[stored_term.name] = _format_result(
            stored.get(stored_term.name), _format_stored_command(stored_term)
        )
    bodies["speed"] = speed
    return bodies


def rewrite_page(text: str, bodies: Mapping[str, str], source: str) -> str:
    """Return the page with all its parts replaced.

    Raises:
        ConfigError: the parts and the marks of the page do not match.
    """
    marked_names = set(re.findall(r"<!-- validation:(\S+) begin -->", text))
    if unknown := marked_names - set(bodies):
        raise ConfigError(f"{source}: nothing is computed for {', '.join(sorted(unknown))}")
    for name, body in bodies.items():
        text = replace_part(text, name, body, source)
    return text


def format_table(rows: Sequence[Term], result: ValidationResult) -> str:
    """Return the rows of one part: quantity, reference, bound and deviation."""
    head = ["what", "compared with", "unit", "bound", "found", "reason of the bound", "test"]
    lines = [head, ["---", "---", "---", "---:", "---:", "---", "---"]]
    newest = _find_newest(result.about[row.key] for row in rows if row.key in result.about)
    older = dict[str, str]()
    for row in rows:
        deviation = result.tests.get(row.key)
        mark = _footnote_mark(result.about.get(row.key), newest, older)
        lines.append(
            [
                row.what,
                row.reference,
                row.unit,
                "-" if deviation is None else format_number(deviation.bound),
                "-" if deviation is None else f"{_format_value(deviation)}{mark}",
                row.reason,
                f"`{row.test.removeprefix('tests/')}`",
            ]
        )
    body = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    if newest is None:
        return f"{body}\n\n{_NOT_YET}"
    notes = "".join(f"\n{mark} {text}." for text, mark in older.items())
    return f"{body}\n\nMeasured {format_provenance(newest)}.{notes}"


def format_number(value: float) -> str:
    """Return two digits; small numbers as 1e-13, without Python's zero in the exponent."""
    if value == 0 or 1e-3 <= abs(value) < 1e4:
        return f"{value:.2g}"
    mantissa, exponent = f"{value:.1e}".split("e")
    return f"{mantissa.removesuffix('.0')}e{int(exponent)}"


def _format_value(deviation: Deviation) -> str:
    return deviation.value if isinstance(deviation.value, str) else format_number(deviation.value)


def _find_newest(abouts: Iterable[MeasurementMetadata]) -> MeasurementMetadata | None:
    return max(abouts, key=lambda about: about.at_utc, default=None)


def _footnote_mark(
    about: MeasurementMetadata | None, newest: MeasurementMetadata | None, older: dict[str, str]
) -> str:
    """Return the number of a note where a row was measured earlier than the others."""
    if about is None or newest is None or about == newest:
        return ""
    text = format_provenance(about)
    return " " + older.setdefault(text, f"({len(older) + 1})")


def _format_result(result: TermResult | None, command: str) -> str:
    if result is None:
        return f"{_NOT_YET} {command}"
    return f"{result.text}\n\n{command} Measured {format_provenance(result.about)}."


def _format_command(study: StudyTerm) -> str:
    return f"`python -m {' '.join([study.module, *study.arguments])}`."


def _format_stored_command(stored_term: StoredTerm) -> str:
    return f"`{stored_term.command}`."
