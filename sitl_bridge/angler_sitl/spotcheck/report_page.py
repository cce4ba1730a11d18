"""Report of a spot check: ``report.md``, ``gaps.csv`` and figures."""

import csv
import io
import math
from collections.abc import Sequence
from pathlib import Path

from angler_mjx.report.plotting.style import save_figure
from angler_mjx.report.viewing.markdown_tables import format_table
from angler_mjx.runs.storage.atomic_files import write_text
from angler_mjx.runs.storage.results import OUTCOMES
from angler_sitl.spotcheck import figures, gaps
from angler_sitl.spotcheck.flight import RECORDED, FlightRow
from angler_sitl.spotcheck.gaps import GapSummary
from angler_sitl.spotcheck.results import SpotcheckResult

REPORT, GAPS, SUMMARY = "report.md", "gaps.csv", "summary.png"

_COLUMNS = (
    "world",
    "robot",
    "outcome",
    "other_outcome",
    "track_rms_m",
    "track_end_m",
    "path_rms_m",
    "endpoint_m",
    "arrival_s",
    "clearance_m",
    "effort_us",
    "other_effort_us",
)


def write_report(out: Path, result: SpotcheckResult) -> None:
    """Write the report of all results so far.

    Raises:
        RunError: writing to the disk failed.
    """
    write_text(out / GAPS, _format_csv(result))
    pictures = []
    if any(name in _get_levels(result) for name, *_ in summarise_rows(result)):
        save_figure(figures.plot_summary(result), out / SUMMARY, palette=128)
        for count in result.counts:
            for pick in result.picks:
                if any(
                    (pick.world, level, count) in result.flights for level in _get_levels(result)
                ):
                    name = f"world_{pick.world:06d}_{count}.png"
                    figure = figures.plot_world(result, pick.world, count)
                    save_figure(figure, out / name, palette=128)
                    pictures.append((pick.world, count, name))
    write_text(out / REPORT, format_report(result, pictures))


def summarise_rows(result: SpotcheckResult) -> list[tuple[str, int, str, GapSummary]]:
    """Return the summary of all gaps: flyer, robots, reference.

    The batch simulator's own flights are compared with the recorded ones, to separate the part of
    the gap that is due to controllers alone.
    """
    return [
        (name, count, reference, gaps.summarise_gaps(listed))
        for name, reference in list_comparisons(result)
        for count in result.counts
        if (listed := result.list_gaps(name, count, reference))
    ]


def list_comparisons(result: SpotcheckResult) -> list[tuple[str, str]]:
    """Return the compared pairs: flyer and reference."""
    settings = result.settings
    levels: list[tuple[str, str]] = [
        (level, other) for level in settings.levels for other in settings.references
    ]
    return levels + [(against, RECORDED) for against in settings.against]


def format_report(result: SpotcheckResult, pictures: Sequence[tuple[int, int, str]]) -> str:
    """Return the text of the report.

    Args:
        result: the spot check.
        pictures: world, robots and file of each overlay figure.
    """
    scenario, origin = result.run.scenario, result.provenance
    ended = "" if result.complete else " **Interrupted: go on with --resume.**"
    parts = [
        f"# Spot check of {result.run.path.name}",
        "\n".join(
            [
                f"- Scenario {scenario.name}, seed {scenario.seed}, controller of the run: "
                f"{scenario.controller.title}.{ended}",
                f"- Plans: {result.plans}.",
                f"- ArduSub {result.autopilot}; external navigation by {result.settings.source}.",
                f"- Command: `{origin['command']}`, commit {origin['commit'] or 'unknown'}.",
                "- Not alike: autopilots go by their own filters and are not told the current, "
                "which the batch controllers may be; physics is stepped at 400 Hz.",
            ]
        ),
        "## In sum",
        format_gap_table(result),
        _READING,
        format_outcome_table(result),
        *([f"![summary]({SUMMARY})"] if pictures else []),
        "## Worlds",
        format_table(
            ["world", "picked for", "made again"],
            [[str(p.world), p.why, result.likeness.get(p.world, "-")] for p in result.picks],
        ),
    ]
    for world, count, name in pictures:
        parts += [f"### World {world}, {count} robots", _format_world(result, world, count)]
        parts += [f"![world {world}]({name})"]
    return "\n\n".join(parts) + "\n"


_READING = (
    "Track: root mean square distance of the two at the same time, while both were on their way. "
    "Way: the same to the other's way, whenever that was there, so without delays. Endpoint: "
    "between the places where the episodes ended, of those that ended alike. Each: median, and "
    "nine of ten below. Arrival: median difference, and nine of ten within. Clearance: median "
    "difference of the least one. Effort: median ratio of root mean square signals beside "
    "neutral. The interval is that of 95 %, by world: robots of one world are no independent draws."
)


def format_gap_table(result: SpotcheckResult) -> str:
    """Return the table of all gaps."""
    head = [
        "flown by",
        "robots",
        "against",
        "same outcome",
        "both or neither arrived",
        "track, m",
        "way, m",
        "endpoint, m",
        "arrival, s",
        "clearance, m",
        "effort",
    ]
    body = [
        [
            name,
            str(count),
            reference,
            f"{summary.agree} of {summary.robots} ({summary.agree_low:.0%} to "
            f"{summary.agree_high:.0%})",
            f"{summary.arrivals_agree} of {summary.robots}",
            _format_spread(summary.track_rms_m),
            _format_spread(summary.path_rms_m),
            _format_spread(summary.endpoint_m),
            f"{_format_number(summary.arrival_s[0], '+.1f')}, "
            f"{_format_number(summary.arrival_s[1], '.1f')}",
            _format_number(summary.clearance_m[0], "+.2f"),
            _format_number(summary.effort_ratio, ".2f"),
        ]
        for name, count, reference, summary in summarise_rows(result)
    ]
    return format_table(head, body)


def format_outcome_table(result: SpotcheckResult) -> str:
    """Return the table of outcomes of each kind of flight, over the picked worlds."""
    groups = [
        (
            name,
            count,
            [
                row
                for key, flight in result.flights.items()
                if key[1:] == (name, count)
                for row in flight.rows
            ],
        )
        for count in result.counts
        for name in result.flight_names()
    ]
    outcomes = [row["outcome"] for *_, group_rows in groups for row in group_rows]
    occurring = [outcome for outcome in OUTCOMES if outcome in outcomes]
    body = [
        [name, str(count), *_format_counts(group_rows, occurring)]
        for name, count, group_rows in groups
        if group_rows
    ]
    return format_table(["flown by", "robots", "with a plan", *occurring], body)


def _format_counts(group_rows: Sequence[FlightRow], occurring: Sequence[str]) -> list[str]:
    """Return the number of robots with a plan, and the number with each outcome."""
    outcomes = [row["outcome"] for row in group_rows]
    numbers = (sum(bool(row["planned"]) for row in group_rows), *map(outcomes.count, occurring))
    return [f"{number} of {len(group_rows)}" for number in numbers]


def _format_world(result: SpotcheckResult, world: int, count: int) -> str:
    """Return the outcome of each robot of a world, in each flight."""
    names = [name for name in result.flight_names() if (world, name, count) in result.flights]
    body = []
    for robot in range(count):
        cells = []
        for name in names:
            flight = result.flights[world, name, count]
            row = flight.rows[robot]
            touched = "" if row["failure_pair"] == "none" else f" ({row['failure_pair']})"
            cells.append(f"{row['outcome']}{touched} {flight.end_s[robot]:.1f} s")
        body.append([str(robot), *cells])
    return format_table(["robot", *names], body)


def _format_csv(result: SpotcheckResult) -> str:
    """Return one row for each robot of each world, level and reference."""
    written = io.StringIO()
    writer = csv.writer(written, lineterminator="\n")
    writer.writerow(["level", "robots", "against", *_COLUMNS])
    for level in _get_levels(result):
        for count in result.counts:
            for reference in result.settings.references:
                for gap in result.list_gaps(level, count, reference):
                    values = [getattr(gap, name) for name in _COLUMNS]
                    shown = [f"{x:.6g}" if isinstance(x, float) else x for x in values]
                    writer.writerow([level, count, reference, *shown])
    return written.getvalue()


def _get_levels(result: SpotcheckResult) -> tuple[str, ...]:
    return result.settings.levels


def _format_spread(spread: tuple[float, float]) -> str:
    return f"{_format_number(spread[0], '.2f')}, {_format_number(spread[1], '.2f')}"


def _format_number(value: float, form: str) -> str:
    return "-" if math.isnan(value) else format(value, form)
