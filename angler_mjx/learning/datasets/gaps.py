"""Deviation of real autopilots from a dataset: ``spotcheck.json``, and its lines of the card."""

from pathlib import Path
from typing import Literal

from pydantic import Field

from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel, parse_model, read_json
from angler_mjx.runs.storage.atomic_files import write_json

SPOT_CHECK_FILE = "spotcheck.json"

type MedianAndP90 = tuple[float | None, float | None]
"""Median and 90th percentile; None without values."""


class GapRow(FileModel):
    """Flights by one kind of pilot, compared with one kind of flight of the same episodes."""

    flown_by: str
    """Entry of commands into the autopilots, thrusters or guided; or a controller of the batch."""
    against: str
    """Reference: recorded, the dataset; or a controller of the batch, flown again."""
    robots: int = Field(ge=1)
    agree: int = Field(ge=0)
    """Number of robots with the same outcome."""
    agree_low: float
    agree_high: float
    """95 % interval of their fraction, by episode."""
    arrivals_agree: int = Field(ge=0)
    """Number of robots that arrived in both, or in neither."""
    track_rms_m: MedianAndP90
    """Root mean square distance of robots at the same time."""
    path_rms_m: MedianAndP90
    """Root mean square distance to the other's path, at any time."""
    endpoint_m: MedianAndP90
    """Distance between the end points of robots with the same outcome."""
    arrival_s: MedianAndP90
    """Difference of arrival times; 90th percentile of its magnitude."""
    clearance_m: MedianAndP90
    """Difference of least clearances."""
    effort_ratio: float | None
    """Median ratio of signals relative to neutral."""


class CheckedPart(FileModel):
    """Episodes of a part that were flown."""

    part: str
    """Path of the run folder."""
    worlds: tuple[int, ...] = Field(min_length=1)


class SpotCheck(FileModel):
    """Contents of ``spotcheck.json``."""

    schema_version: Literal[1] = 1
    autopilot: str
    """Version and checksum of ArduSub."""
    command: str
    created: str
    """UTC, ISO 8601."""
    seed: int
    """Seed of the sample of episodes."""
    stratify: str
    """outcome: rare outcomes were sampled more often; none: they were not."""
    source: str
    """Source of the autopilots' position."""
    flown: tuple[CheckedPart, ...] = Field(min_length=1)
    left_out: tuple[str, ...] = ()
    """Parts without flights: too few episodes, or commanded by a policy."""
    rows: tuple[GapRow, ...]


def read_spot_check(root: Path) -> SpotCheck | None:
    """Return the spot check of a dataset; None where there was none.

    Raises:
        ConfigError: the file is damaged.
    """
    path = root / SPOT_CHECK_FILE
    return parse_model(SpotCheck, read_json(path), source=str(path)) if path.is_file() else None


def write_spot_check(root: Path, spot_check: SpotCheck) -> None:
    """Write the spot check, complete or not at all.

    Raises:
        OSError: writing failed.
    """
    write_json(root / SPOT_CHECK_FILE, spot_check.model_dump(mode="json"))


def format_spot_check(spot_check: SpotCheck | None) -> list[str]:
    """Return lines of the card."""
    if spot_check is None:
        return [
            "Real autopilots have not flown episodes of it yet; `angler spotcheck PATH` flies a "
            "sample on ArduSub and reports the deviation from the dataset in this section.",
        ]
    episodes = sum(len(part.worlds) for part in spot_check.flown)
    left_out = f" Nothing was flown of {', '.join(spot_check.left_out)}."
    return [
        f"{episodes} episodes of {len(spot_check.flown)} parts, flown with the same plans by "
        "ArduSub "
        f"{spot_check.autopilot}, positions by {spot_check.source} (`{spot_check.command}`, "
        f"{spot_check.created}). "
        f"{_STRATIFY_NOTES.get(spot_check.stratify, '')}{left_out if spot_check.left_out else ''}",
        "",
        "| flown by | against | same outcome | both or neither arrived | track, m | way, m | "
        "endpoint, m | arrival, s | clearance, m | effort |",
        "|---" * 10 + "|",
        *[
            f"| {row.flown_by} | {row.against} | {row.agree} of {row.robots} "
            f"({row.agree_low:.0%} to {row.agree_high:.0%}) | {row.arrivals_agree} of "
            f"{row.robots} | {_format_pair(row.track_rms_m)} | {_format_pair(row.path_rms_m)} | "
            f"{_format_pair(row.endpoint_m)} | {_format_number(row.arrival_s[0], '+.1f')}, "
            f"{_format_number(row.arrival_s[1], '.1f')} | "
            f"{_format_number(row.clearance_m[0], '+.2f')} | "
            f"{_format_number(row.effort_ratio, '.2f')} |"
            for row in spot_check.rows
        ],
        "",
        "Track: root mean square distance at the same time while both were on their way; way: to "
        "the other's way, whenever it was there; each: median, and nine of ten below. Effort: "
        "ratio of signals beside neutral.",
    ]


_STRATIFY_NOTES = {
    "outcome": "Rare outcomes were sampled more often, so arrival rates do not follow from it."
}


def _format_pair(pair: MedianAndP90) -> str:
    return f"{_format_number(pair[0], '.2f')}, {_format_number(pair[1], '.2f')}"


def _format_number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def require_outside(root: Path, out: Path) -> None:
    """Refuse flights inside a dataset's folder: they are no files of the dataset.

    Raises:
        ConfigError: the output folder is inside the dataset.
    """
    if out.resolve().is_relative_to(root.resolve()):
        raise ConfigError(f"--out {out}: lies in the dataset {root}; give a folder beside it")
