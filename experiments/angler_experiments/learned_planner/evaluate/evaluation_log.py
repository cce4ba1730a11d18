"""Log of rows in a JSON file: rows of the file are not flown again."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import NotRequired, TypedDict

import jax

from angler_mjx.errors import ConfigError
from angler_mjx.runs.storage.atomic_files import write_atomically

_HEAD = (
    "| sea | planner | samples | have a path, % | arrive, % (95 %) "
    "| path / line | paths end, s | worlds/s |"
)


class EvaluationKey(TypedDict):
    """Everything that a row depends on."""

    sea: str
    planner: str
    worlds: int
    samples: NotRequired[int]
    checkpoint: NotRequired[str]
    """Hash of the network."""
    learned_from: NotRequired[int]
    """Number of worlds of the training."""
    steps: NotRequired[int]
    """Steps of the training."""


class EvaluatedRate(TypedDict):
    """Rate with its 95 % interval."""

    rate: float
    low: float
    high: float


class EvaluationRow(TypedDict):
    """Row of the log; the fields of a `CourseRow` that tables and figures use."""

    key: EvaluationKey
    found: EvaluatedRate
    arrived: EvaluatedRate
    planning_s: float
    detour: float | None
    planned_s: float | None
    loss: NotRequired[float]
    """Validation loss of the network."""


class EvaluationLog:
    """File of rows, each with a key of all that it depends on."""

    def __init__(self, file: Path | None) -> None:
        """Read the file, where there is one.

        Raises:
            ConfigError: the file has no rows.
        """
        self._file = file
        self.rows: list[EvaluationRow] = []
        if file is not None and file.exists():
            try:
                self.rows = json.loads(file.read_text())["rows"]
            except (ValueError, KeyError, TypeError) as error:
                raise ConfigError(
                    f"{file}: holds no rows ({error}); remove it, or give another --out"
                ) from error

    def find(self, key: EvaluationKey) -> EvaluationRow | None:
        """Return the row of a key, if there is one."""
        return next((row for row in self.rows if row["key"] == key), None)

    def add(self, key: EvaluationKey, row: Mapping[str, object]) -> EvaluationRow:
        """Append a row; it is on the disk when this returns."""
        device = jax.devices()[0].device_kind
        text = json.dumps({"key": key, "device": device, **row})
        entry: EvaluationRow = json.loads(text)
        self.rows.append(entry)
        if self._file is not None:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            with write_atomically(self._file) as temporary:
                temporary.write_text(json.dumps({"rows": self.rows}, indent=1) + "\n")
        return entry


def format_rate(rate: EvaluatedRate) -> str:
    """Format a rate with its interval, in per cent."""
    return f"{100 * rate['rate']:.1f} ({100 * rate['low']:.1f} to {100 * rate['high']:.1f})"


def format_head() -> str:
    """Format the head of the table of `format_row`."""
    return f"{_HEAD}\n{'|---' * (_HEAD.count('|') - 1)}|"


def format_row(row: EvaluationRow) -> str:
    """Format a row of a table for people."""
    key = row["key"]
    samples_text = f"{key['samples']}" if "samples" in key else ""
    return (
        f"| {key['sea']} | {key['planner']} | {samples_text} | {100 * row['found']['rate']:.1f} | "
        f"{format_rate(row['arrived'])} | {_format_number(row['detour'])} | "
        f"{_format_number(row['planned_s'])} | "
        f"{key['worlds'] / row['planning_s']:.3g} |"
    )


def _format_number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
