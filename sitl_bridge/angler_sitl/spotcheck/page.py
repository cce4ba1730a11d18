"""The report of a spot check: ``report.md``, ``gaps.csv`` and figures."""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from angler_mjx.report.viewing.style import save
from angler_mjx.report.viewing.tables import table
from angler_mjx.runs.storage.results import OUTCOMES
from angler_sitl.spotcheck import figures, folder, gaps
from angler_sitl.spotcheck.flight import RECORDED
from angler_sitl.spotcheck.gaps import Sum
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


def write(out: Path, found: SpotcheckResult) -> None:
    """Write everything that can be said so far.

    Raises:
        RunError: the disk gave out.
    """
    folder.save_text(out / GAPS, _csv(found))
    pictures = []
    if any(name in _levels(found) for name, *_ in rows(found)):
        save(figures.summary(found), out / SUMMARY, palette=128)
        for count in found.counts:
            for pick in found.picks:
                if any((pick.world, level, count) in found.flights for level in _levels(found)):
                    name = f"world_{pick.world:06d}_{count}.png"
                    figure = figures.overlay(found, pick.world, count)
                    save(figure, out / name, palette=128)
                    pictures.append((pick.world, count, name))
    folder.save_text(out / REPORT, text(found, pictures))


def rows(found: SpotcheckResult) -> list[tuple[str, int, str, Sum]]:
    """What all gaps come to: who flew, robots, reference.

    The batch simulator's own flights are held against what was recorded, to tell how much of the
    gap is a matter of controllers alone.
    """
    return [
        (name, count, reference, gaps.add_up(listed))
        for name, reference in pairs(found)
        for count in found.counts
        if (listed := found.gaps(name, count, reference))
    ]


def pairs(found: SpotcheckResult) -> list[tuple[str, str]]:
    """Who flew, and what that is held against."""
    settings = found.settings
    levels: list[tuple[str, str]] = [
        (level, other) for level in settings.levels for other in settings.references
    ]
    return levels + [(against, RECORDED) for against in settings.against]


def text(found: SpotcheckResult, pictures: Sequence[tuple[int, int, str]]) -> str:
    """The report.

    Args:
        found: the spot check.
        pictures: world, robots and file of each overlay.
    """
    scenario, origin = found.run.scenario, found.provenance
    ended = "" if found.complete else " **Interrupted: go on with --resume.**"
    parts = [
        f"# Spot check of {found.run.path.name}",
        "\n".join(
            [
                f"- Scenario {scenario.name}, seed {scenario.seed}, controller of the run: "
                f"{scenario.controller.title}.{ended}",
                f"- Plans: {found.plans}.",
                f"- ArduSub {found.autopilot}; external navigation by {found.settings.source}.",
                f"- Command: `{origin['command']}`, commit {origin['commit'] or 'unknown'}.",
                "- Not alike: autopilots go by their own filters and are not told the current, "
                "which the batch controllers may be; physics is stepped at 400 Hz.",
            ]
        ),
        "## In sum",
        in_sum(found),
        _READING,
        ends(found),
        *([f"![summary]({SUMMARY})"] if pictures else []),
        "## Worlds",
        table(
            ["world", "picked for", "made again"],
            [[str(p.world), p.why, found.likeness.get(p.world, "-")] for p in found.picks],
        ),
    ]
    for world, count, name in pictures:
        parts += [f"### World {world}, {count} robots", _world(found, world, count)]
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


def in_sum(found: SpotcheckResult) -> str:
    """The table of all gaps."""
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
            f"{one.agree} of {one.robots} ({one.agree_low:.0%} to {one.agree_high:.0%})",
            f"{one.arrivals_agree} of {one.robots}",
            _two(one.track_rms_m),
            _two(one.path_rms_m),
            _two(one.endpoint_m),
            f"{_number(one.arrival_s[0], '+.1f')}, {_number(one.arrival_s[1], '.1f')}",
            _number(one.clearance_m[0], "+.2f"),
            _number(one.effort_ratio, ".2f"),
        ]
        for name, count, reference, one in rows(found)
    ]
    return table(head, body)


def ends(found: SpotcheckResult) -> str:
    """The table of how robots ended in each kind of flight, over the worlds that were picked."""
    flown = [
        (
            name,
            count,
            [
                row
                for key, one in found.flights.items()
                if key[1:] == (name, count)
                for row in one.rows
            ],
        )
        for count in found.counts
        for name in found.names()
    ]
    ended = [row["outcome"] for *_, listed in flown for row in listed]
    seen = [outcome for outcome in OUTCOMES if outcome in ended]
    body = [[name, str(count), *_counted(listed, seen)] for name, count, listed in flown if listed]
    return table(["flown by", "robots", "with a plan", *seen], body)


def _counted(listed: Sequence[Mapping[str, Any]], seen: Sequence[str]) -> list[str]:
    """How many of some robots have a plan, and how many ended in each way."""
    ended = [row["outcome"] for row in listed]
    numbers = (sum(bool(row["planned"]) for row in listed), *map(ended.count, seen))
    return [f"{number} of {len(listed)}" for number in numbers]


def _world(found: SpotcheckResult, world: int, count: int) -> str:
    """How each robot of a world ended, in each flight."""
    names = [name for name in found.names() if (world, name, count) in found.flights]
    body = []
    for robot in range(count):
        cells = []
        for name in names:
            flight = found.flights[world, name, count]
            row = flight.rows[robot]
            touched = "" if row["failure_pair"] == "none" else f" ({row['failure_pair']})"
            cells.append(f"{row['outcome']}{touched} {flight.end_s[robot]:.1f} s")
        body.append([str(robot), *cells])
    return table(["robot", *names], body)


def _csv(found: SpotcheckResult) -> str:
    """One row for each robot of each world, level and reference."""
    written = io.StringIO()
    writer = csv.writer(written, lineterminator="\n")
    writer.writerow(["level", "robots", "against", *_COLUMNS])
    for level in _levels(found):
        for count in found.counts:
            for reference in found.settings.references:
                for gap in found.gaps(level, count, reference):
                    values = [getattr(gap, name) for name in _COLUMNS]
                    shown = [f"{x:.6g}" if isinstance(x, float) else x for x in values]
                    writer.writerow([level, count, reference, *shown])
    return written.getvalue()


def _levels(found: SpotcheckResult) -> tuple[str, ...]:
    return found.settings.levels


def _two(spread: tuple[float, float]) -> str:
    return f"{_number(spread[0], '.2f')}, {_number(spread[1], '.2f')}"


def _number(value: float, form: str) -> str:
    return "-" if math.isnan(value) else format(value, form)
