"""HTML page of the gallery: films, the commands that make them, and outcomes of their runs."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from angler_mjx.report.plotting import style
from angler_mjx.runs.storage.folder import Run
from angler_mjx.studies.gallery.films import Film

_STYLE = """
body { max-width: 60rem; margin: 2rem auto; padding: 0 1rem; line-height: 1.5;
  font-family: system-ui, sans-serif; color: #12303c; background: #ffffff; }
video { width: 100%; background: #0a1e2a; }
pre { overflow-x: auto; padding: 0.7rem; background: #eef3f5; font-size: 0.85rem; }
table { border-collapse: collapse; }
th, td { padding: 0.2rem 1.2rem 0.2rem 0; text-align: left; border-bottom: 1px solid #c9d6db; }
td + td { font-variant-numeric: tabular-nums; }
"""


@dataclass(frozen=True, kw_only=True)
class Section:
    """A film as the page shows it."""

    film: Film
    run: Run
    world: int
    """Index of the world that is shown."""
    poster_s: float
    duration_s: float
    """Recorded time of the world, s."""
    video_bytes: int


def format_page(sections: Sequence[Section]) -> str:
    """Return the HTML text of the page, which needs only the videos and pictures beside it."""
    entries = "\n".join(
        f'<li><a href="#{escape(section.film.name)}">{escape(section.film.title)}</a></li>'
        for section in sections
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>Films of simulated fleets</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n"
        "<h1>Films of simulated fleets</h1>\n"
        "<p>Each film shows one world of a run: the first of the worlds in which the most robots "
        "arrived. The tables count the robots of all worlds of the run, the others' included. "
        "Intervals are of 95 %, by world. Commands are run in the folder of this page. "
        "Coloured lines are the paths so far, arrows the water's velocity at the robots "
        "(0.25 m/s is a metre).</p>\n"
        f"<ul>\n{entries}\n</ul>\n"
        + "\n".join(_format_section(section) for section in sections)
        + "\n</body>\n</html>\n"
    )


def _format_section(section: Section) -> str:
    film, run = section.film, section.run
    summary, name = run.summary, escape(film.name)
    width, height = film.view.size_px
    commands = "\n".join(film.list_commands(section.world, section.poster_s))
    version = escape(run.environment["versions"]["angler-mjx"])
    facts = (
        f"{escape(run.scenario.description)}. World {section.world} of {summary['worlds']}, "
        f"seed {summary['seed']}, engine {escape(summary['engine'])}, "
        f"{section.duration_s:.0f} s at {film.view.speed:g} times the speed, "
        f"{section.video_bytes / 1e6:.1f} MB. Flown with angler-mjx {version}"
        f"{_format_commit(run)} on {escape(str(run.environment['backend']))}."
    )
    return (
        f'<h2 id="{name}">{escape(film.title)}</h2>\n<p>{escape(film.text)}</p>\n'
        f'<video controls preload="none" width="{width}" height="{height}" '
        f'poster="{name}.png" src="{name}.mp4" style="height: auto"></video>\n'
        f"<p>{facts}</p>\n{_format_outcomes(summary)}\n<pre>{escape(commands)}</pre>"
    )


def _format_commit(run: Run) -> str:
    commit = run.environment.get("commit")
    return f" (commit {escape(str(commit)[:8])})" if commit else ""


def _format_outcomes(summary: dict[str, Any]) -> str:
    """Return the table of the outcomes that occurred, and of completed tasks."""
    rows = [
        (_describe_outcome(name, summary), row, "robot")
        for name, row in summary["outcomes"].items()
        if row["count"] > 0
    ]
    if "task" in summary:
        rows.insert(0, ("task completed", summary["task"]["completed"], "world"))
    cells = "\n".join(
        f"<tr><td>{escape(text)}</td><td>{_format_count(row['count'], noun)}</td>"
        f"<td>{100 * row['rate']:.1f} %</td>"
        f"<td>{100 * row['low']:.1f} to {100 * row['high']:.1f} %</td></tr>"
        for text, row, noun in rows
    )
    return (
        "<table>\n<tr><th>outcome</th><th>number</th><th>rate</th><th>95 % interval</th></tr>\n"
        f"{cells}\n</table>"
    )


def _describe_outcome(name: str, summary: dict[str, Any]) -> str:
    if name == "reached" and "task" in summary:
        return "finished its part"
    return style.OUTCOME_TEXT[name]


def _format_count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
