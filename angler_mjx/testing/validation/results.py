"""Results: deviations of the tests, results of studies, and their files."""

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

from pydantic import Field

from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel, parse_model
from angler_mjx.runs.storage.atomic_files import replace_file
from angler_mjx.testing.validation.host import describe_host


class MeasurementMetadata(FileModel):
    """Place and time of a measurement."""

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


def format_provenance(about: MeasurementMetadata) -> str:
    """Return one sentence: place, date and commit of a measurement."""
    where = about.device if about.backend != "cpu" else about.processor or "CPU"
    cores = f", {about.cpu_count} cores" if about.backend == "cpu" else ""
    commit = about.commit or "unknown"
    changed = " and changes that were not committed" if commit.endswith("-changed") else ""
    flags = f", `XLA_FLAGS={about.xla_flags}`" if about.xla_flags else ""
    return (
        f"{about.at_utc[:10]}, {where}{cores}, jax {about.versions.get('jax')}, "
        f"commit {commit.removesuffix('-changed')[:9]}{changed}{flags}"
    )


class Deviation(FileModel):
    """Max value measured by the tests for one term."""

    key: str
    value: float | str
    """Measured value; a text where it is no number: nan, inf."""
    bound: float
    tests: tuple[str, ...]


class MeasuredDeviations(FileModel):
    """File of ``pytest --deviations``."""

    about: MeasurementMetadata
    deviations: tuple[Deviation, ...]


class StudyNumber(FileModel):
    """One number of a study."""

    value: float
    unit: str
    worse: str
    """Name of the [worse.NAME] tolerance in the terms."""


class TermResult(FileModel):
    """Result of a study: numbers to compare, and its text on the page."""

    about: MeasurementMetadata
    numbers: dict[str, StudyNumber]
    text: str


class Expectation(FileModel):
    """Stored number that new results are compared with."""

    value: float
    at_utc: str
    commit: str | None


class Expected(FileModel):
    """File of expectations."""

    numbers: dict[str, Expectation] = Field(default_factory=dict)


class ValidationResult(FileModel):
    """``validation.json``: all data of the page."""

    tests: dict[str, Deviation] = Field(default_factory=dict)
    about: dict[str, MeasurementMetadata] = Field(default_factory=dict)
    """Metadata of each key of ``tests``."""
    studies: dict[str, TermResult] = Field(default_factory=dict)


def read_model[M: FileModel](model: type[M], path: Path) -> M:
    """Read a JSON file.

    Raises:
        ConfigError: it cannot be read, or its content is invalid.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: cannot be read ({error})") from error
    if not isinstance(data, dict):
        raise ConfigError(f"{path}: holds no object")
    return parse_model(model, data, source=str(path))


def read_model_or_empty[M: FileModel](model: type[M], path: Path) -> M:
    """Read as `read_model`; return an empty model where there is no file yet."""
    return read_model(model, path) if path.exists() else model()


def write_json(path: Path, data: Mapping[str, object]) -> None:
    """Write a JSON file atomically."""
    text = json.dumps(data, indent=1, allow_nan=False, ensure_ascii=False, sort_keys=True)
    with replace_file(path, flag="--out", force=True) as writing:
        writing.write_text(text + "\n", encoding="utf-8")


def merge_results(
    old: ValidationResult, measured: MeasuredDeviations | None, results: dict[str, TermResult]
) -> ValidationResult:
    """Return the old results, updated with the new ones."""
    deviations = measured.deviations if measured else ()
    about = {d.key: measured.about for d in deviations} if measured else {}
    return ValidationResult(
        tests={**old.tests, **{d.key: d for d in deviations}},
        about={**old.about, **about},
        studies={**old.studies, **results},
    )


def save_result(path: Path, numbers: dict[str, StudyNumber], text: str) -> None:
    """Write the result of a study, with its place and time.

    Args:
        path: its ``--json``.
        numbers: numbers to compare with expectations, by key.
        text: Markdown text of the page.
    """
    about = {**describe_host(), "at_utc": datetime.now(UTC).isoformat(timespec="seconds")}
    numbers_by_key = {key: number.model_dump() for key, number in numbers.items()}
    write_json(path, {"about": about, "numbers": numbers_by_key, "text": text})
