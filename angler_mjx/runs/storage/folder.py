"""Run folder: its files, how it is built and how it is read back.

``config.json`` resolved scenario, ``environment.json`` versions and machine, ``policy.json`` where
one commanded the robots, ``variants.json`` where vehicles were randomised, ``inputs/`` copies of
the vehicle, thruster and plan files, ``summary.json``, ``episodes.parquet``, ``trajectories.zarr``,
``run.log``, ``figures/``, ``replay.rrd``; ``robots/`` where each robot left files of its own. While
a run goes on, the folder is hidden (``.NAME.partial``) and ``parts/`` holds the episodes of the
finished tiles.
"""

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import zarr

from angler_mjx.errors import ConfigError, RunError, format_bytes
from angler_mjx.files import parse_model
from angler_mjx.runs.storage import (
    atomic_files,
    environments,
    input_copies,
    output_lock,
    results,
    results_folder,
    trajectory_layout,
)
from angler_mjx.runs.storage.atomic_files import write_json
from angler_mjx.runs.storage.output_lock import OutputLock
from angler_mjx.runs.storage.read_errors import read_table, wrap_read_errors
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim import fleet

CONFIG, ENVIRONMENT, SUMMARY = "config.json", "environment.json", "summary.json"
POLICY, VARIANTS = "policy.json", "variants.json"
EPISODES, TRAJECTORIES, PARTS = "episodes.parquet", "trajectories.zarr", "parts"
FIGURES, REPLAY, ROBOTS, LOG = "figures", "replay.rrd", "robots", "run.log"


@dataclass(frozen=True)
class Run:
    """A run folder, read lazily; a damaged part raises a `ConfigError` that names it."""

    path: Path

    def __post_init__(self) -> None:
        """Refuse what is not a run folder."""
        object.__setattr__(self, "path", Path(self.path))
        if not (self.path / SUMMARY).is_file():
            raise ConfigError(f"{self.path}: not a run folder (no {SUMMARY} in it)")

    @cached_property
    def scenario(self) -> Scenario:
        """The resolved scenario.

        A vehicle file that is not there any more, or was edited since, is replaced by its copy.
        """
        return read_scenario(self.path)

    @cached_property
    def summary(self) -> dict[str, Any]:
        """Content of ``summary.json``."""
        return read_table(self.path / SUMMARY)

    @cached_property
    def environment(self) -> dict[str, Any]:
        """Content of ``environment.json``: versions, device, machine, commit, command."""
        return read_table(self.path / ENVIRONMENT)

    @cached_property
    def episodes(self) -> pa.Table:
        """One row per robot per world, ordered by world and robot."""
        return read_episodes(self.path / EPISODES)

    @cached_property
    def trajectories(self) -> zarr.Group:
        """Sampled trajectories; see their attributes.

        Raises:
            ConfigError: the run stored none, or an array is missing or described wrongly.
        """
        path, scenario = self.path / TRAJECTORIES, self.scenario
        if not path.exists():
            if scenario.time.record_hz > 0:
                raise ConfigError(
                    f"{path}: is missing: the run stored no trajectories, or they were removed; "
                    "copy it again, or make the run anew"
                )
            raise ConfigError(f"{self.path}: this run stored no trajectories (record_hz = 0)")
        with wrap_read_errors(path):
            group = zarr.open_group(path, mode="r")
            arrays = environments.list_arrays(group)
            trajectory_layout.check_layout(
                arrays,
                str(path),
                worlds=scenario.worlds,
                robots=len(scenario.members()),
                estimated=scenario.senses,
                also=scenario.store.also,
                tasked=scenario.task_spec() is not None,
                joints=fleet.count_joints(scenario.members()),
            )
            inside = f"{trajectory_layout.ENVIRONMENT_GROUP}/"
            environments.check_arrays(
                {n.removeprefix(inside): x for n, x in arrays.items() if n.startswith(inside)},
                path / trajectory_layout.ENVIRONMENT_GROUP,
            )
        return group

    def vehicle_file(self, label: str) -> str:
        """Return the vehicle of a row of ``episodes`` for `robot.vehicles.library.load_vehicle`."""
        return input_copies.vehicle_file(self.path, label)


def read_scenario(path: Path) -> Scenario:
    """Read the resolved scenario of a run folder, complete or not.

    Raises:
        ConfigError: it is damaged.
    """
    source = path / CONFIG
    table = read_table(source)
    with wrap_read_errors(source):
        input_copies.use_stand_ins(table, path)
    return parse_model(Scenario, table, source=str(source))


def read_episodes(path: Path) -> pa.Table:
    """Read rows of episodes, missing values as nulls, also where older files have NaN.

    Raises:
        ConfigError: the file is damaged or holds something else.
    """
    with wrap_read_errors(path):
        table = pq.read_table(path, page_checksum_verification=True)
        return results.check_table(table)


def recovery_advice(building: Path) -> str | None:
    """Return the advice on the hidden folder of an ended process; None if it holds nothing.

    A run can go on as soon as it says of what it is; logs of robots are kept.
    """
    if (building / CONFIG).exists():
        return output_lock.RESUMABLE
    has_content = (building / ROBOTS).exists() or holds_results(building)
    return output_lock.BROKEN_OFF if has_content else None


def require_none(out: Path) -> None:
    """Refuse the name of a run that is taken; see `output_lock.require_none`."""
    output_lock.require_none(out, advise=recovery_advice)


def create_folder(out: Path) -> OutputLock:
    """Take the name of a run and make the hidden folder in which it is built.

    Raises:
        ConfigError: ``out`` exists, or its parent cannot be written.
    """
    lock = output_lock.acquire(out, advise=recovery_advice)
    with lock.filling() as building:
        (building / PARTS).mkdir()
    return lock


def write_start_files(
    building: Path,
    scenario: Scenario,
    environment: Mapping[str, object],
    extra_files: list[tuple[str, Path]] | None = None,
) -> None:
    """Write what is known before the first step.

    Args:
        building: the hidden folder.
        scenario: resolved.
        environment: versions and machine.
        extra_files: role and file of what is used beside the scenario's vehicles.
    """
    laws = [(input_copies.LAW, file) for file in scenario.controller.files]
    if scenario.policy.file is not None:
        laws.append((input_copies.POLICY, scenario.policy.file))
    files = [*input_copies.world_files(scenario.world), *laws, *(extra_files or [])]
    input_copies.copy_inputs(building, [entry.vehicle for entry in scenario.fleet], files)
    write_json(building / CONFIG, scenario.model_dump(mode="json"))
    _write_variants(building, scenario)
    write_json(building / ENVIRONMENT, environment)


def _write_variants(building: Path, scenario: Scenario) -> None:
    """Say what each variant is, where vehicles are randomised."""
    if scenario.randomise.changes_vehicles:
        write_json(building / VARIANTS, {"variants": fleet.describe_variants(scenario.members())})


def reopen_folder(out: Path, report: Callable[[str], None]) -> OutputLock:
    """Make an interrupted run ready to go on; returns the claim of its folder.

    Args:
        out: name of the run.
        report: receives a line for each part that is damaged and made again.

    Raises:
        ConfigError: there is none, it is complete, it goes on, or its vehicles were edited.
        RunError: the disk gave out.
    """
    lock, scenario = results_folder.resume_folder(
        out,
        kind="run",
        file=CONFIG,
        is_complete=_is_complete(out),
        check=partial(_check_inputs, out, report),
    )
    with lock.keeping() as building:
        _restore_parts(building)
        _set_damaged_aside(building, report)
        _write_variants(building, scenario)
    return lock


def _is_complete(out: Path) -> bool:
    """Return whether a run is complete; refuse a scene that broke off, which cannot go on."""
    if not (out / SUMMARY).is_file():
        return False
    summary = Run(out).summary
    if summary.get("complete") is not True and "interrupted" in summary:
        raise ConfigError(f"--resume {out}: this scene broke off and cannot go on; run it anew")
    return summary.get("complete") is True


def _check_inputs(out: Path, report: Callable[[str], None], existing: Path) -> Scenario:
    """Return the scenario of a run whose inputs are what they were."""
    scenario = read_scenario(existing)
    input_copies.require_unchanged(existing, flag=f"--resume {out}")
    if (existing / input_copies.INPUTS_FOLDER).resolve() in Path(scenario.planner.name).parents:
        report(
            f"the planner's file is another one now; the run goes on with {scenario.planner.name}"
        )
    return scenario


def _restore_parts(building: Path) -> None:
    """Take the end of a run back: its rows are parts again."""
    (building / PARTS).mkdir(exist_ok=True)
    if (building / EPISODES).exists():
        (building / EPISODES).replace(building / PARTS / "before.parquet")
    (building / SUMMARY).unlink(missing_ok=True)
    shutil.rmtree(building / FIGURES, ignore_errors=True)
    (building / REPLAY).unlink(missing_ok=True)


def _set_damaged_aside(building: Path, report: Callable[[str], None]) -> None:
    """Rename parts that cannot be read: their worlds are computed again."""
    for part in sorted((building / PARTS).glob("*.parquet")):
        try:
            read_episodes(part)
        except ConfigError as error:
            part.replace(part.with_suffix(".damaged"))
            report(f"{error}; its worlds are computed again")


def read_parts(building: Path) -> pa.Table | None:
    """Read the episodes of finished tiles, ordered by world and robot; None without any.

    Raises:
        ConfigError: a part is damaged.
    """
    parts = sorted((building / PARTS).glob("*.parquet"))
    if not parts:
        return None
    table = pa.concat_tables([read_episodes(part) for part in parts])
    table = table.sort_by([("world", "ascending"), ("robot", "ascending")])
    # A tile that was computed again stands in two parts, with the same rows.
    keys = np.stack([table["world"].to_numpy(), table["robot"].to_numpy()])
    first = np.r_[True, (np.diff(keys) != 0).any(axis=0)]
    return table if first.all() else table.filter(pa.array(first))


def write_part(building: Path, first_world: int, episodes: pa.Table) -> None:
    """Keep the episodes of finished tiles: on the disk when this returns."""
    write_episodes(building / PARTS / f"{first_world:012d}.parquet", episodes)
    atomic_files.sync_path(building / PARTS)


def write_episodes(path: Path, episodes: pa.Table) -> None:
    """Write rows with checksums, whole or not at all."""
    atomic_files.write_parquet(path, episodes, page_checksums=True)


def holds_results(building: Path) -> bool:
    """Return whether a hidden folder holds results."""
    parts = building / PARTS
    return (building / EPISODES).exists() or (parts.is_dir() and any(parts.iterdir()))


def finish_folder(lock: OutputLock, episodes: pa.Table, summary: Mapping[str, object]) -> Run:
    """Close the run: results in place, the folder under its own name, parts gone.

    Raises:
        RunError: the name cannot be had; the run stays whole where it was built.
        OSError: the disk gave out; the run can be resumed.
    """
    write_episodes(lock.building / EPISODES, episodes)
    write_json(lock.building / SUMMARY, summary)
    lock.publish()
    shutil.rmtree(lock.out / PARTS, ignore_errors=True)
    return Run(lock.out)


def require_space(out: Path, needed_bytes: int) -> None:
    """Refuse a run that cannot fit on the disk.

    Raises:
        RunError: the free space is smaller than what the run will write at most.
    """
    parent = out.absolute().parent
    while not parent.exists():
        parent = parent.parent
    free = shutil.disk_usage(parent).free
    if needed_bytes > free:
        raise RunError(
            f"--out {out}: the trajectories need up to {format_bytes(needed_bytes)}, "
            f"{format_bytes(free)} are free; lower --record-hz (0 stores none) or --worlds"
        )
