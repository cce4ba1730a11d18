"""What was found: deviations that tests wrote, results of studies, and the files that keep them."""

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pydantic import Field

from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel, parse_model
from angler_mjx.runs.storage.atomic_files import replace_file
from angler_mjx.testing.validation.host import describe_host


class MeasurementMetadata(FileModel):
    """Where and when."""

    versions: dict[str, str | None]
    python: str
    platform: str
    cpu_count: int | None
    backend: str
    device: str
    commit: str | None
    processor: str = ""
    xla_flags: str = ""
    ardusub: bool = False
    at_utc: str
    exit_status: int = 0


class Deviation(FileModel):
    """The greatest value that the tests found for one term."""

    key: str
    value: float | str
    """A text where it is no number: nan, inf."""
    bound: float
    tests: tuple[str, ...]


class MeasuredDeviations(FileModel):
    """A file that ``pytest --deviations`` wrote."""

    about: MeasurementMetadata
    deviations: tuple[Deviation, ...]


class StudyNumber(FileModel):
    """One number of a study."""

    value: float
    unit: str
    worse: str
    """Name of a [worse.NAME] of the terms."""


class TermResult(FileModel):
    """What a study wrote: numbers that are compared, and the text that stands on the page."""

    about: MeasurementMetadata
    numbers: dict[str, StudyNumber]
    text: str


class Expectation(FileModel):
    """A number as it was when it was stored."""

    value: float
    at_utc: str
    commit: str | None


class Expected(FileModel):
    """The file of expectations."""

    numbers: dict[str, Expectation] = Field(default_factory=dict)


class ValidationResult(FileModel):
    """``validation.json``: all that the page is made from."""

    tests: dict[str, Deviation] = Field(default_factory=dict)
    about: dict[str, MeasurementMetadata] = Field(default_factory=dict)
    """Of each key of ``tests``."""
    studies: dict[str, TermResult] = Field(default_factory=dict)


def read_model[M: FileModel](model: type[M], path: Path) -> M:
    """Read a JSON file.

    Raises:
        ConfigError: it cannot be read, or does not hold what it should.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: cannot be read ({error})") from error
    if not isinstance(data, dict):
        raise ConfigError(f"{path}: holds no object")
    return parse_model(model, data, source=str(path))


def read_model_or_empty[M: FileModel](model: type[M], path: Path) -> M:
    """As `read_model`; an empty one where there is no file yet."""
    return read_model(model, path) if path.exists() else model()


def write_json(path: Path, data: dict[str, Any]) -> None:
    """Write a JSON file whole or not at all."""
    text = json.dumps(data, indent=1, allow_nan=False, ensure_ascii=False, sort_keys=True)
    with replace_file(path, flag="--out", force=True) as writing:
        writing.write_text(text + "\n", encoding="utf-8")


def merge_results(
    old: ValidationResult, measured: MeasuredDeviations | None, results: dict[str, TermResult]
) -> ValidationResult:
    """What was found before with what was found now in its place."""
    deviations = measured.deviations if measured else ()
    about = {d.key: measured.about for d in deviations} if measured else {}
    return ValidationResult(
        tests={**old.tests, **{d.key: d for d in deviations}},
        about={**old.about, **about},
        studies={**old.studies, **results},
    )


def save_result(path: Path, numbers: dict[str, StudyNumber], text: str) -> None:
    """Write what a study found, with where and when.

    Args:
        path: its ``--json``.
        numbers: what is compared with what was expected, by key.
        text: Markdown that stands on the page.
    """
    about = {**describe_host(), "at_utc": datetime.now(UTC).isoformat(timespec="seconds")}
    numbers_by_key = {key: number.model_dump() for key, number in numbers.items()}
    write_json(path, {"about": about, "numbers": numbers_by_key, "text": text})
