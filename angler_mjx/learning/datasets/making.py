"""Making a dataset: its parts flown into run folders one by one, then what says what they are.

It is built like a run, in a hidden folder beside its place; the manifest comes last. A part that
was broken off is resumed as any run is, so nothing but tiles in flight is lost.
"""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.learning.datasets import card, describing, index, manifest, sums
from angler_mjx.learning.datasets import parts as flown
from angler_mjx.learning.datasets.config import DatasetConfig
from angler_mjx.learning.datasets.parts import DatasetPart
from angler_mjx.learning.datasets.sampling import CROSSED
from angler_mjx.runs import several
from angler_mjx.runs.processes import OneProcess, Processes, telling
from angler_mjx.runs.several import RunsProgress
from angler_mjx.runs.simulator.simulator import default_tile
from angler_mjx.runs.storage import output_lock
from angler_mjx.runs.storage.output_lock import OutputLock
from angler_mjx.runs.storage.recorder import Shape
from angler_mjx.world.config import resolve

TILE_BYTES = 2 * 10**9
"""Samples of a tile at most, where the file names no tile: one is flown while another is written,
and a GPU is as fast with half its tile."""


@dataclass(frozen=True, kw_only=True)
class DatasetRequest:
    """What a person asked for."""

    config: DatasetConfig
    table: Mapping[str, Any]
    """Of the scenario that all is made of."""
    episodes: int
    source: str

    @property
    def parts(self) -> tuple[DatasetPart, ...]:
        """To be flown; see `parts.parts`."""
        return flown.parts(self.config, self.table, self.episodes, self.source)

    def resolved(self) -> dict[str, Any]:
        """All of it in plain values."""
        return {
            "episodes": self.episodes,
            "dataset": self.config.model_dump(mode="json"),
            "scenario": dict(self.table),
        }


def read_request(path: Path, episodes: int) -> DatasetRequest:
    """What is to be made of a dataset file.

    Raises:
        ConfigError: the file has faults, or episodes are none.
    """
    if episodes < 1:
        raise ConfigError(f"--episodes {episodes}: must be at least 1")
    config, table = flown.read(path)
    return DatasetRequest(config=config, table=table, episodes=episodes, source=str(path))


def make(
    asked: DatasetRequest,
    out: Path,
    *,
    told: RunsProgress,
    resume: bool = False,
    devices: int | None = None,
    workers: int | None = None,
    processes: Processes | None = None,
) -> Path | None:
    """Make a dataset, or go on with one.

    Args:
        asked: what is to be in it.
        out: folder to make.
        told: of how far it is.
        resume: go on with an interrupted one.
        devices: to fly on; all if left out. Changes no byte of the results.
        workers: processes that plan, where a planner is one of the host.
        processes: that share the making, part by part; each calls this with the same arguments,
            and they leave each other afterwards.

    Returns:
        Its folder; None after an interruption (Ctrl-C): what was finished is kept, to go on with.

    Raises:
        ConfigError: the folder is taken, or what is asked for cannot be flown, or is not what was
            begun there.
        RunError: the disk or the device gave out, or another process did.
    """
    together = processes or OneProcess()
    with telling(together):
        return _make(asked, out, told, together, resume, {"devices": devices, "workers": workers})


def _make(
    asked: DatasetRequest,
    out: Path,
    told: RunsProgress,
    together: Processes,
    resume: bool,
    how: Mapping[str, Any],
) -> Path | None:
    parts = asked.parts
    _require_one_recording(parts, asked.source)
    _require_crossings(asked.config, parts, asked.source)
    building = output_lock.partial_path(out)
    with ExitStack() as stack:
        claimed = None
        if together.index == 0:
            whole = (out / manifest.MANIFEST).is_file()
            claimed = (
                several.again(out, "dataset", asked.resolved(), whole=whole)
                if resume
                else several.begin(out, "dataset", asked.resolved())
            )
            stack.callback(claimed.release)
        together.meet("dataset")
        flights = [
            (part.path, part.scenario.model_copy(update={"tile": tile_of(part)})) for part in parts
        ]
        if not several.fly(flights, building, told, together, {"chunk": 1, **how}):
            return None
        if claimed is not None:
            _close(asked, parts, claimed)
        together.meet("whole")
    return out


def _require_one_recording(parts: Sequence[DatasetPart], source: str) -> None:
    """Refuse parts that are recorded at different rates, or in different steps."""
    first = parts[0].scenario
    if first.time.record_hz == 0.0:
        raise ConfigError(f"{source}: set.time.record_hz = 0: there is nothing to learn from it")
    for part in parts:
        for name, a, b in (
            ("set.time.record_hz", first.time.record_hz, part.scenario.time.record_hz),
            ("set.store", first.store, part.scenario.store),
        ):
            if a != b:
                raise ConfigError(
                    f"{source}: scene {part.scene!r}, {name}: {b} is not {a} as in scene "
                    f"{parts[0].scene!r}; a dataset is recorded in one way"
                )


def _require_crossings(config: DatasetConfig, parts: Sequence[DatasetPart], source: str) -> None:
    """Refuse crossings where no two robots are."""
    if not all(part.robots < 2 for part in parts if part.split is None):
        return
    for kind in CROSSED:
        if (wished := config.sample.at_least.get(kind, 0.0)) > 0.0:
            raise ConfigError(
                f"{source}: sample.at_least.{kind} = {wished:g}: every team that is not of a "
                "shifted scene is one robot, which crosses nobody; give teams of two or more"
            )


def tile_of(part: DatasetPart) -> int:
    """Worlds in one device call: the file's, or as many as memory is to hold of them."""
    scenario = part.scenario
    if scenario.tile is not None:
        return scenario.tile
    obstacles = resolve(scenario.world).obstacles
    per_world = Shape(
        worlds=1,
        samples=round(scenario.time.horizon_s * scenario.time.record_hz),
        robots=part.robots,
        thrusters=8,
        obstacles=obstacles.dynamic.count + len(obstacles.explicit),
        plan_points=scenario.planner.points,
        estimated=scenario.senses,
    ).bytes_per_world()
    fits = max(1, TILE_BYTES // per_world)
    return min(default_tile(scenario.worlds), 1 << (fits.bit_length() - 1))


def _close(asked: DatasetRequest, parts: Sequence[DatasetPart], claimed: OutputLock) -> None:
    """Index, sums, card and, last, the manifest; then the folder gets its name."""
    place = claimed.building
    try:
        made = describing.describe(asked.config, parts, place)
        table = index.of_manifest(place, made)
        made = describing.counted(made, table)
        index.write(place, table)
        card.write(place, made, table)
        (place / several.MAKING).unlink()
        manifest.write(place, made.model_copy(update={"sums": sums.write(place)}))
    except OSError as error:
        raise RunError(
            f"--out {claimed.out}: cannot be written ({error.strerror or error}); its flights are "
            f"whole in {place}: make room and go on with --resume"
        ) from error
    claimed.publish()
