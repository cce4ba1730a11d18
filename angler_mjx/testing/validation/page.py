"""The parts of docs/validation.md that are computed; what stands between them stays as it is."""

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from angler_mjx.errors import ConfigError
from angler_mjx.testing.validation.host import said
from angler_mjx.testing.validation.results import (
    Deviation,
    MeasurementMetadata,
    TermResult,
    ValidationResult,
)
from angler_mjx.testing.validation.terms import Part, StoredTerm, StudyTerm, Term, Terms

PAGE = Path("docs/validation.md")
PARTS: tuple[Part, ...] = ("terms", "energy", "control", "engines", "clearance")

_NOT_YET = "*Not measured yet.*"


def marks(name: str) -> tuple[str, str]:
    """The lines before and after a computed part."""
    return f"<!-- validation:{name} begin -->", f"<!-- validation:{name} end -->"


def replaced(text: str, name: str, body: str, source: str) -> str:
    """A text with another body between the marks of a part.

    Raises:
        ConfigError: the text has no such marks, or has them twice.
    """
    begin, end = marks(name)
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise ConfigError(f"{source}: needs the lines {begin} and {end} once, in this order")
    head, tail = text.index(begin) + len(begin), text.index(end)
    return f"{text[:head]}\n{body}\n{text[tail:]}"


def parts(
    terms: Terms, found: ValidationResult, stored: Mapping[str, TermResult], speed: str
) -> dict[str, str]:
    """Body of each computed part, by name.

    Args:
        terms: what is validated.
        found: what was found, now or earlier.
        stored: results from elsewhere, by name.
        speed: the table of speeds.
    """
    bodies: dict[str, str] = {
        part: table([term for term in terms.term if term.part == part], found) for part in PARTS
    }
    for study in terms.study:
        bodies[study.name] = _result(found.studies.get(study.name), _command(study))
    for one in terms.stored:
        bodies[one.name] = _result(stored.get(one.name), _stored(one))
    bodies["speed"] = speed
    return bodies


def rewritten(text: str, bodies: Mapping[str, str], source: str) -> str:
    """The page with all its parts replaced.

    Raises:
        ConfigError: a part has no place on the page, or a place no part.
    """
    places = set(re.findall(r"<!-- validation:(\S+) begin -->", text))
    if nameless := places - set(bodies):
        raise ConfigError(f"{source}: nothing is computed for {', '.join(sorted(nameless))}")
    for name, body in bodies.items():
        text = replaced(text, name, body, source)
    return text


def table(rows: Sequence[Term], found: ValidationResult) -> str:
    """Rows of one part: what, against what, how near it may and how near it came."""
    head = ["what", "compared with", "unit", "bound", "found", "reason of the bound", "test"]
    lines = [head, ["---", "---", "---", "---:", "---:", "---", "---"]]
    newest = _newest(found.about[row.key] for row in rows if row.key in found.about)
    older = dict[str, str]()
    for row in rows:
        one = found.tests.get(row.key)
        mark = _mark(found.about.get(row.key), newest, older)
        lines.append(
            [
                row.what,
                row.reference,
                row.unit,
                "-" if one is None else number(one.bound),
                "-" if one is None else f"{_value(one)}{mark}",
                row.reason,
                f"`{row.test.removeprefix('tests/')}`",
            ]
        )
    body = "\n".join(f"| {' | '.join(line)} |" for line in lines)
    if newest is None:
        return f"{body}\n\n{_NOT_YET}"
    notes = "".join(f"\n{mark} {text}." for text, mark in older.items())
    return f"{body}\n\nMeasured {said(newest.model_dump())}.{notes}"


def number(value: float) -> str:
    """Two digits; small ones as 1e-13, without the zero that Python puts into an exponent."""
    if value == 0 or 1e-3 <= abs(value) < 1e4:
        return f"{value:.2g}"
    mantissa, exponent = f"{value:.1e}".split("e")
    return f"{mantissa.removesuffix('.0')}e{int(exponent)}"


def _value(one: Deviation) -> str:
    return one.value if isinstance(one.value, str) else number(one.value)


def _newest(abouts: Iterable[MeasurementMetadata]) -> MeasurementMetadata | None:
    return max(abouts, key=lambda about: about.at_utc, default=None)


def _mark(
    about: MeasurementMetadata | None, newest: MeasurementMetadata | None, older: dict[str, str]
) -> str:
    """A number of a note where a row was measured earlier than the others."""
    if about is None or newest is None or about == newest:
        return ""
    text = said(about.model_dump())
    return " " + older.setdefault(text, f"({len(older) + 1})")


def _result(result: TermResult | None, command: str) -> str:
    if result is None:
        return f"{_NOT_YET} {command}"
    return f"{result.text}\n\n{command} Measured {said(result.about.model_dump())}."


def _command(study: StudyTerm) -> str:
    return f"`python -m {' '.join([study.module, *study.arguments])}`."


def _stored(one: StoredTerm) -> str:
    return f"`{one.command}`."
