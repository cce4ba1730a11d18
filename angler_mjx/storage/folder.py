"""The run folder: where it is built, what lies in it, and how it is read back.

``config.json`` resolved scenario, ``environment.json`` versions and machine, ``summary.json``,
``policy.json`` where one commanded the robots,
``episodes.parquet``, ``trajectories.zarr``, ``figures/``, ``replay.rrd``; ``robots/`` where each
robot left files of its own. While a run goes on, the
folder is hidden (``.NAME.partial``) and ``parts/`` holds the episodes of the finished tiles.
"""

import json
import shutil
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import zarr

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.files import parse
from angler_mjx.scenario.scenario import Scenario

CONFIG, ENVIRONMENT, SUMMARY = "config.json", "environment.json", "summary.json"
POLICY = "policy.json"
EPISODES, TRAJECTORIES, PARTS = "episodes.parquet", "trajectories.zarr", "parts"
FIGURES, REPLAY, ROBOTS = "figures", "replay.rrd", "robots"


@dataclass(frozen=True)
class Run:
    """A run folder, read lazily."""

    path: Path

    def __post_init__(self) -> None:
        """Refuse what is not a run folder."""
        if not (self.path / SUMMARY).is_file():
            raise ConfigError(f"{self.path}: not a run folder (no {SUMMARY} in it)")

    @cached_property
    def scenario(self) -> Scenario:
        """The resolved scenario."""
        return read_scenario(self.path)

    @cached_property
    def summary(self) -> dict[str, Any]:
        """What ``summary.json`` holds."""
        table: dict[str, Any] = json.loads((self.path / SUMMARY).read_text())
        return table

    @cached_property
    def episodes(self) -> pa.Table:
        """One row per robot per world, ordered by world and robot."""
        return pq.read_table(self.path / EPISODES)

    @cached_property
    def trajectories(self) -> zarr.Group:
        """Sampled trajectories; see their attributes.

        Raises:
            ConfigError: the run stored none.
        """
        if not (self.path / TRAJECTORIES).exists():
            raise ConfigError(f"{self.path}: this run stored no trajectories (record_hz = 0)")
        return zarr.open_group(self.path / TRAJECTORIES, mode="r")


def read_scenario(path: Path) -> Scenario:
    """The resolved scenario of a run folder, whole or in the making."""
    source = path / CONFIG
    return parse(Scenario, json.loads(source.read_text()), source=str(source))


def partial_path(out: Path) -> Path:
    """Where the run of ``out`` is built."""
    return out.parent / f".{out.name}.partial"


def create(out: Path) -> Path:
    """Make the hidden folder in which the run of ``out`` is built.

    Raises:
        ConfigError: ``out`` exists, or its parent cannot be written.
    """
    if out.exists():
        raise ConfigError(f"--out {out}: exists; give another folder or remove it")
    building = partial_path(out)
    if building.exists():
        raise ConfigError(
            f"--out {out}: an unfinished run lies in {building}; remove it, or if a rollout left "
            "it take it up again with --resume"
        )
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        building.mkdir()
        (building / PARTS).mkdir()
    except OSError as error:
        raise ConfigError(f"--out {out}: cannot be written ({error.strerror})") from error
    return building


def reopen(out: Path) -> Path:
    """Make an interrupted run of ``out`` ready to go on; returns the folder to build in.

    Raises:
        ConfigError: there is none, or it is complete.
    """
    building = partial_path(out)
    if out.exists() and not building.exists():
        summary = Run(out).summary
        if summary["complete"]:
            raise ConfigError(f"--resume {out}: this run is complete; nothing is left to do")
        if "interrupted" in summary:
            raise ConfigError(f"--resume {out}: this scene broke off and cannot go on; run it anew")
        out.rename(building)
        (building / PARTS).mkdir(exist_ok=True)
        (building / EPISODES).rename(building / PARTS / "before.parquet")
        (building / SUMMARY).unlink()
        shutil.rmtree(building / FIGURES, ignore_errors=True)
        (building / REPLAY).unlink(missing_ok=True)
    if not (building / CONFIG).is_file():
        raise ConfigError(f"--resume {out}: there is no interrupted run of that name")
    return building


def read_parts(building: Path) -> pa.Table | None:
    """Episodes of the finished tiles, ordered by world and robot; None if there are none."""
    parts = sorted((building / PARTS).glob("*.parquet"))
    if not parts:
        return None
    table = pa.concat_tables([pq.read_table(part) for part in parts])
    return table.sort_by([("world", "ascending"), ("robot", "ascending")])


def write_part(building: Path, first_world: int, episodes: pa.Table) -> None:
    """Keep the episodes of finished tiles."""
    place = building / PARTS / f"{first_world:012d}.parquet"
    written = place.with_suffix(".tmp")
    pq.write_table(episodes, written)
    written.rename(place)


def finish(building: Path, out: Path, episodes: pa.Table, summary: dict[str, Any]) -> Run:
    """Close the run: results in place, parts gone, the folder under its own name."""
    pq.write_table(episodes, building / EPISODES)
    write_json(building / SUMMARY, summary)
    shutil.rmtree(building / PARTS)
    building.rename(out)
    return Run(out)


def write_json(path: Path, table: dict[str, Any]) -> None:
    """Write a table as indented JSON."""
    path.write_text(json.dumps(table, indent=2, allow_nan=False) + "\n")


def remove(building: Path) -> None:
    """Take away a run of which nothing is worth keeping."""
    shutil.rmtree(building, ignore_errors=True)


def require_space(out: Path, needed_bytes: int) -> None:
    """Refuse a run that cannot fit on the disk.

    Raises:
        RunError: the free space is smaller than what the run will write at most.
    """
    place = out.parent
    while not place.exists():
        place = place.parent
    free = shutil.disk_usage(place).free
    if needed_bytes > free:
        raise RunError(
            f"--out {out}: the trajectories need up to {needed_bytes / 1e9:.2f} GB, "
            f"{free / 1e9:.2f} GB are free; lower --record-hz (0 stores none) or --worlds"
        )
