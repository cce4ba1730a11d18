"""Generation of a dataset: its parts flown into run folders one by one, then its descriptions.

It is built like a run, in a hidden folder beside its target; the manifest is written last. An
interrupted part is resumed as any run is, so only tiles in flight are lost.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from angler_mjx.errors import ConfigError
from angler_mjx.learning.datasets import card, checksums, index, manifest, manifest_building
from angler_mjx.learning.datasets import parts as flown
from angler_mjx.learning.datasets.config import DatasetConfig
from angler_mjx.learning.datasets.parts import DatasetPart
from angler_mjx.learning.datasets.sampling import CROSSED
from angler_mjx.progress import Progress
from angler_mjx.runs import multi_run
from angler_mjx.runs.multi_run import RunOptions
from angler_mjx.runs.processes import OneProcess, Processes, reporting_failure
from angler_mjx.runs.resumable_folder import open_folder
from angler_mjx.runs.simulator.simulator import default_tile
from angler_mjx.runs.storage.recorder import TrajectoryShape
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.fleet import label_joints
from angler_mjx.world.config import resolve_world

TILE_BYTES = 2 * 10**9
"""Maximum bytes of the samples of a tile, where the file sets no tile: one is flown while another
is written, and a GPU is as fast with half its tile."""


@dataclass(frozen=True, kw_only=True)
class DatasetRequest:
    """Inputs of a dataset."""

    config: DatasetConfig
    table: Mapping[str, object]
    """Table of the scenario of all parts."""
    episodes: int
    source: str

    @property
    def parts(self) -> tuple[DatasetPart, ...]:
        """Return the parts to fly; see `parts.build_parts`."""
        return flown.build_parts(self.config, self.table, self.episodes, self.source)

    def resolved(self) -> dict[str, object]:
        """Return all of it in plain values."""
        return {
            "episodes": self.episodes,
            "dataset": self.config.model_dump(mode="json"),
            "scenario": dict(self.table),
        }


def read_request(path: Path, episodes: int) -> DatasetRequest:
    """Read the request of a dataset file.

    Raises:
        ConfigError: the file has faults, or the number of episodes is not above 0.
    """
    if episodes < 1:
        raise ConfigError(f"--episodes {episodes}: must be at least 1")
    config, table = flown.read_config(path)
    return DatasetRequest(config=config, table=table, episodes=episodes, source=str(path))


def make_dataset(
    request: DatasetRequest,
    out: Path,
    *,
    progress: Progress,
    resume: bool = False,
    devices: int | None = None,
    workers: int | None = None,
    processes: Processes | None = None,
) -> Path | None:
    """Make a dataset, or resume one.

    Args:
        request: contents of the dataset.
        out: folder to create.
        progress: receives the progress.
        resume: continue an interrupted dataset.
        devices: devices to run on; all if left out. They change no byte of the results.
        workers: processes that plan, for planners on the host.
        processes: processes that share the parts; each calls this function with the same arguments,
            and they disconnect afterwards.

    Returns:
        Its folder; None after an interruption (Ctrl-C): finished tiles are kept for resuming.

    Raises:
        ConfigError: the folder exists, the request cannot be flown, or differs from the one that
            was begun in the folder.
        RunError: the disk, the device or another process failed.
    """
    process_group = processes or OneProcess()
    with reporting_failure(process_group):
        parts = request.parts
        _require_same_recording(parts, request.source)
        _require_crossings(request.config, parts, request.source)
    declared = multi_run.declare_folder(
        "dataset",
        request.resolved(),
        models={"dataset": DatasetConfig, "scenario": Scenario},
        is_complete=lambda path: (path / manifest.MANIFEST).is_file(),
    )
    flights = [
        (part.path, part.scenario.model_copy(update={"tile": tile}))
        for part, tile in zip(parts, choose_tiles(parts), strict=True)
    ]
    options: RunOptions = {"chunk": 1, "devices": devices, "workers": workers}
    with open_folder(declared, out, resume=resume, processes=process_group) as opened:
        complete = multi_run.fly_runs(flights, opened.building, progress, process_group, options)
        if complete:
            opened.publish(partial(_finish_dataset, request, parts))
    return out if complete else None


def _require_same_recording(parts: Sequence[DatasetPart], source: str) -> None:
    """Refuse parts that are recorded at different rates, or in different steps."""
    first = parts[0].scenario
    if first.time.record_hz == 0.0:
        raise ConfigError(f"{source}: set.time.record_hz = 0: the dataset would have no samples")
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
    """Refuse crossings for teams of fewer than two robots."""
    if not all(part.robots < 2 for part in parts if part.split is None):
        return
    for kind in CROSSED:
        if (minimum := config.sample.at_least.get(kind, 0.0)) > 0.0:
            raise ConfigError(
                f"{source}: sample.at_least.{kind} = {minimum:g}: every team that is not of a "
                "shifted scene is one robot, without crossings; give teams of two or more"
            )


def choose_tiles(parts: Sequence[DatasetPart]) -> list[int]:
    """Return the worlds of one device call of each part: the file's, or as many as memory may hold.

    Parts of one team size share a tile if the engine is fused and no policy commands the robots.
    Their programs are then of one shape, and flying the unused worlds of a tile takes less time
    than compiling programs of another tile.
    """
    return [
        part.scenario.tile
        or _choose_tile([other for other in parts if _use_same_tile(part, other)])
        for part in parts
    ]


def _use_same_tile(part: DatasetPart, other: DatasetPart) -> bool:
    return part is other or (part.robots == other.robots and _is_fast(part) and _is_fast(other))


def _is_fast(part: DatasetPart) -> bool:
    """Return whether a part has no tile of its own, and flies faster than it compiles."""
    scenario = part.scenario
    return scenario.tile is None and scenario.engine == "fused" and not scenario.flown


def _choose_tile(parts: Sequence[DatasetPart]) -> int:
    """Return the tile that parts share: a power of two that holds the largest part, where it can.

    The tile of a part that shares it with no other is at most the worlds of the part.
    """
    worlds = max(part.scenario.worlds for part in parts)
    shared = 1 << (worlds - 1).bit_length() if len(parts) > 1 else worlds
    return min(default_tile(shared), *(_max_tile(part) for part in parts))


def _max_tile(part: DatasetPart) -> int:
    """Return the worlds of which memory may hold the samples, as a power of two."""
    scenario = part.scenario
    obstacles = resolve_world(scenario.world).obstacles
    per_world = TrajectoryShape(
        worlds=1,
        samples=round(scenario.time.horizon_s * scenario.time.record_hz),
        robots=part.robots,
        thrusters=8,
        obstacles=obstacles.dynamic.count + len(obstacles.explicit),
        plan_points=scenario.planner.points,
        estimated=scenario.senses,
        joints=label_joints(scenario.members()),
    ).bytes_per_world()
    fits = max(1, TILE_BYTES // per_world)
    return 1 << (fits.bit_length() - 1)


def _finish_dataset(request: DatasetRequest, parts: Sequence[DatasetPart], root: Path) -> None:
    """Write index, card, checksums and manifest.

    The request is deleted last: an interruption before leaves a folder that can be resumed.
    """
    dataset_manifest = manifest_building.build_manifest(request.config, parts, root)
    table = index.build_index(root, dataset_manifest)
    dataset_manifest = manifest_building.add_counts(dataset_manifest, table)
    index.write_index(root, table)
    card.write_card(root, dataset_manifest, table)
    manifest.write_manifest(
        root, dataset_manifest.model_copy(update={"sums": checksums.write_checksums(root)})
    )
    (root / multi_run.REQUEST_FILE).unlink()
