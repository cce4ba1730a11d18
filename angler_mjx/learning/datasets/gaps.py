"""How far real autopilots were from a dataset: ``spotcheck.json``, and what the card says of it."""

from pathlib import Path
from typing import Literal

from pydantic import Field

from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel, parse_model, read_json
from angler_mjx.runs.storage import folder

SPOT_CHECK_FILE = "spotcheck.json"

type MedianAndP90 = tuple[float | None, float | None]
"""Median, and what nine of ten are below; None where there is no value."""


class GapRow(FileModel):
    """All flights by one kind of pilot, against one kind of flight of the same episodes."""

    flown_by: str
    """thrusters or guided: where commands enter the autopilots; or a controller of the batch."""
    against: str
    """recorded: the dataset; or a controller of the batch, flown again."""
    robots: int = Field(ge=1)
    agree: int = Field(ge=0)
    """Robots that ended the same way."""
    agree_low: float
    agree_high: float
    """95 % interval of their share, by episode."""
    arrivals_agree: int = Field(ge=0)
    """Robots that arrived in both, or in neither."""
    track_rms_m: MedianAndP90
    """Of robots: root mean square distance at the same time."""
    path_rms_m: MedianAndP90
    """The same to the other's way, whenever it was there."""
    endpoint_m: MedianAndP90
    """Between the ends of those that ended alike."""
    arrival_s: MedianAndP90
    """Difference of arrivals; its size in nine of ten."""
    clearance_m: MedianAndP90
    """Difference of least clearances."""
    effort_ratio: float | None
    """Median ratio of signals beside neutral."""


class CheckedPart(FileModel):
    """Episodes of a part that were flown."""

    part: str
    """Path of the run folder."""
    worlds: tuple[int, ...] = Field(min_length=1)


class SpotCheck(FileModel):
    """``spotcheck.json``."""

    schema_version: Literal[1] = 1
    autopilot: str
    """Version and sum of the ArduSub."""
    command: str
    created: str
    """UTC, ISO 8601."""
    seed: int
    """Of the draw of episodes."""
    stratify: str
    """outcome: rare outcomes were drawn on purpose; none: they were not."""
    source: str
    """Where the autopilots learned their position."""
    flown: tuple[CheckedPart, ...] = Field(min_length=1)
    left_out: tuple[str, ...] = ()
    """Parts of which nothing was flown: too few episodes, or a policy commanded them."""
    rows: tuple[GapRow, ...]


def read_spot_check(root: Path) -> SpotCheck | None:
    """The spot check of a dataset; None where there was none.

    Raises:
        ConfigError: it is damaged.
    """
    path = root / SPOT_CHECK_FILE
    return parse_model(SpotCheck, read_json(path), source=str(path)) if path.is_file() else None


def write_spot_check(root: Path, spot_check: SpotCheck) -> None:
    """Write it, whole or not at all.

    Raises:
        OSError: the disk gave out.
    """
    folder.write_json(root / SPOT_CHECK_FILE, spot_check.model_dump(mode="json"))


def format_spot_check(spot_check: SpotCheck | None) -> list[str]:
    """Lines of the card."""
    if spot_check is None:
        return [
            "No episode of it was flown by real autopilots yet; `angler spotcheck PATH` flies a "
            "sample on ArduSub and says here how far that is from the dataset.",
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
    "outcome": "Rare outcomes were drawn on purpose, so it is no sample of how often robots arrive."
}


def _format_pair(pair: MedianAndP90) -> str:
    return f"{_format_number(pair[0], '.2f')}, {_format_number(pair[1], '.2f')}"


def _format_number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def require_outside(root: Path, out: Path) -> None:
    """Refuse flights inside a dataset: they would be no files of it.

    Raises:
        ConfigError: they would be.
    """
    if out.resolve().is_relative_to(root.resolve()):
        raise ConfigError(f"--out {out}: lies in the dataset {root}; give a folder beside it")
