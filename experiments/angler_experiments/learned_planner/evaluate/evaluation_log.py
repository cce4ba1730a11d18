"""Log of rows in a JSON file: rows of the file are not flown again."""

import json
from pathlib import Path
from typing import Any

import jax

from angler_mjx.errors import ConfigError
from angler_mjx.runs.storage.atomic_files import write_atomically

_HEAD = (
    "| sea | planner | samples | have a path, % | arrive, % (95 %) "
    "| path / line | paths end, s | worlds/s |"
)


class EvaluationLog:
    """File of rows, each with a key of all that it depends on."""

    def __init__(self, file: Path | None) -> None:
        """Read the file, where there is one.

        Raises:
            ConfigError: the file has no rows.
        """
        self._file = file
        self.rows: list[dict[str, Any]] = []
        if file is not None and file.exists():
            try:
                self.rows = json.loads(file.read_text())["rows"]
            except (ValueError, KeyError, TypeError) as error:
                raise ConfigError(
                    f"{file}: holds no rows ({error}); remove it, or give another --out"
                ) from error

    def find(self, key: dict[str, Any]) -> dict[str, Any] | None:
        """Return the row of a key, if there is one."""
        return next((row for row in self.rows if row["key"] == key), None)

    def add(self, key: dict[str, Any], row: dict[str, Any]) -> dict[str, Any]:
        """Append a row; it is on the disk when this returns."""
        device = jax.devices()[0].device_kind
        entry = {"key": key, "device": device, **row}
        self.rows.append(entry)
        if self._file is not None:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            with write_atomically(self._file) as temporary:
                temporary.write_text(json.dumps({"rows": self.rows}, indent=1) + "\n")
        return entry


def format_rate(rate: dict[str, Any]) -> str:
    """Format a rate with its interval, in per cent."""
    return f"{100 * rate['rate']:.1f} ({100 * rate['low']:.1f} to {100 * rate['high']:.1f})"


def format_head() -> str:
    """Format the head of the table of `format_row`."""
    return f"{_HEAD}\n{'|---' * (_HEAD.count('|') - 1)}|"


def format_row(row: dict[str, Any]) -> str:
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
