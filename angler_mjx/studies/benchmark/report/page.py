"""The page of a benchmark: one file that holds its numbers, its charts and how it was made."""

import json
import re
from importlib import resources
from pathlib import Path

from angler_mjx.errors import RunError
from angler_mjx.files import named
from angler_mjx.runs.storage.atomic import write_text
from angler_mjx.studies.benchmark.report import embedded, figures, paired, reading

NAME, PAIRS = "report.html", "comparisons.csv"
_SCRIPTS = (
    "statistics.js",
    "charts.js",
    "maps.js",
    "choice.js",
    "answer.js",
    "sections.js",
    "cells.js",
    "page.js",
)
"""In this order: the last one begins."""
_MARK = re.compile(r"@@(TITLE|STYLE|DATA|SCRIPT)@@")


def make(folder: Path) -> Path:
    """Draw the figures of a benchmark, compare its planners, and write its page.

    Args:
        folder: its results; need not be complete.

    Returns:
        The page.

    Raises:
        ConfigError: the folder is none.
        RunError: a file cannot be written.
    """
    results = reading.read(folder)
    figures.make(results)
    path = folder / NAME
    try:
        write_text(folder / PAIRS, paired.table(results))
        write_text(path, text(results))
    except OSError as error:
        raise RunError(f"{named(folder)}: cannot be written ({error.strerror or error})") from error
    return path


def text(results: reading.Results) -> str:
    """The page.

    Args:
        results: of a benchmark.
    """
    held = json.dumps(embedded.data(results), separators=(",", ":"), ensure_ascii=False)
    parts = {
        "TITLE": _plain(str(results.about.get("name", "benchmark"))),
        "STYLE": _shipped("page.css"),
        # Inside a script only what begins a tag could end it.
        "DATA": held.replace("<", "\\u003c"),
        "SCRIPT": "\n".join(_shipped(name) for name in _SCRIPTS),
    }
    return _MARK.sub(lambda found: parts[found[1]], _shipped("page.html"))


def _plain(words: str) -> str:
    return words.replace("&", "&amp;").replace("<", "&lt;")


def _shipped(name: str) -> str:
    file = resources.files("angler_mjx.studies.benchmark.report") / "web" / name
    return file.read_text(encoding="utf-8")
