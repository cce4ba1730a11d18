"""Page of a benchmark: one file with its statistics, charts and origin."""

import json
import re
from importlib import resources
from pathlib import Path

from angler_mjx.errors import RunError
from angler_mjx.files import format_path
from angler_mjx.runs.storage.atomic_files import write_text
from angler_mjx.studies.benchmark.report import figures, page_data, paired, reading

NAME, PAIRS = "report.html", "comparisons.csv"
_SCRIPTS = (
    "charts.js",
    "maps.js",
    "choice.js",
    "answer.js",
    "sections.js",
    "cells.js",
    "page.js",
)
"""Scripts of the page, in this order; the last one starts it."""
_PLACEHOLDER = re.compile(r"@@(TITLE|STYLE|DATA|SCRIPT)@@")


def write_report(folder: Path) -> Path:
    """Plot the figures of a benchmark, compare its planners, and write its page.

    Args:
        folder: its results; need not be complete.

    Returns:
        The page.

    Raises:
        ConfigError: the folder holds no results of a benchmark.
        RunError: a file cannot be written.
    """
    results = reading.read_results(folder)
    figures.plot_figures(results)
    path = folder / NAME
    try:
        write_text(folder / PAIRS, paired.format_pairs_csv(results))
        write_text(path, render_page(results))
    except OSError as error:
        raise RunError(
            f"{format_path(folder)}: cannot be written ({error.strerror or error})"
        ) from error
    return path


def render_page(results: reading.Results) -> str:
    """Return the text of the page.

    Args:
        results: of a benchmark.
    """
    page_json = json.dumps(
        page_data.build_page_data(results), separators=(",", ":"), ensure_ascii=False
    )
    parts = {
        "TITLE": _escape_html(str(results.about.get("name", "benchmark"))),
        "STYLE": _read_asset("page.css"),
        # Inside a script only what begins a tag could end it.
        "DATA": page_json.replace("<", "\\u003c"),
        "SCRIPT": "\n".join(_read_asset(name) for name in _SCRIPTS),
    }
    return _PLACEHOLDER.sub(lambda matched: parts[matched[1]], _read_asset("page.html"))


def _escape_html(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;")


def _read_asset(name: str) -> str:
    file = resources.files("angler_mjx.studies.benchmark.report") / "web" / name
    return file.read_text(encoding="utf-8")
