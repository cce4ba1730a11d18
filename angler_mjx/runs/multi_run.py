"""Several runs in one folder, for datasets, sweeps and checks.

They are flown one after another, or in groups by processes side by side. An interrupted run is
resumed as any run is, so nothing but tiles in flight is lost. While one run flies, the programs of
the next ones are compiled.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TypedDict

from angler_mjx.files import FileModel
from angler_mjx.progress import Progress
from angler_mjx.runs import rollout
from angler_mjx.runs.device_processes import map_on_devices
from angler_mjx.runs.processes import OneProcess, Processes, RunProcesses
from angler_mjx.runs.resumable_folder import ResumableFolder
from angler_mjx.runs.simulator.programs import release_memory
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.simulator_cache import MAX_AHEAD, SimulatorCache
from angler_mjx.runs.storage import folder, results_folder
from angler_mjx.runs.storage.atomic_files import write_json
from angler_mjx.runs.storage.plans.read import open_plans
from angler_mjx.scenario.scenario import Scenario

REQUEST_FILE = "making.json"
"""What is made, while it is; a resume must ask for the same."""
RUNS_FOLDER = "runs"
"""Folder of the runs."""


class RunOptions(TypedDict, total=False):
    """Options of every run, as of `rollout.rollout`."""

    chunk: int
    devices: int | None
    workers: int | None


def declare_folder(
    kind: str,
    request: Mapping[str, object],
    *,
    models: Mapping[str, type[FileModel]],
    is_complete: Callable[[Path], bool],
) -> ResumableFolder[None]:
    """Declare a folder of several runs.

    Args:
        kind: noun of the kind.
        request: all that is asked for, in plain values.
        models: models of tables in it, whose keys may have been renamed since it was begun.
        is_complete: as of `ResumableFolder`.
    """

    def begin(building: Path) -> None:
        write_json(building / REQUEST_FILE, dict(request))
        (building / RUNS_FOLDER).mkdir()

    def resume(building: Path) -> None:
        results_folder.require_same_request(building / REQUEST_FILE, request, models)

    return ResumableFolder(
        kind=kind,
        request_file=REQUEST_FILE,
        begin=begin,
        resume=resume,
        is_complete=is_complete,
    )


def fly_runs(
    parts: Iterable[tuple[str, Scenario]],
    building: Path,
    progress: Progress,
    processes: Processes,
    options: RunOptions,
    plans: Mapping[str, Path] = MappingProxyType({}),
) -> bool:
    """Fly what is left of several runs; whether all are whole now.

    Args:
        parts: place of each below the folder, and its scenario.
        building: the folder.
        progress: of how far it is.
        processes: processes that share each run.
        options: options of every run.
        plans: files of plans that runs fly instead of their planner's, by the runs' places.
    """
    parts = tuple(parts)
    with SimulatorCache() as simulators:
        for number, (path, scenario) in enumerate(parts):
            progress.report(f"run {number + 1} of {len(parts)}: {path}")
            group = RunProcesses(processes, path)
            status = run_status(building / path) if processes.index == 0 else None
            status = group.meet("stands", status)[0]
            if status == "whole":
                continue
            _begin_compiling(parts[number:], building, simulators, options, plans)
            progress.describe("compiling")
            out, plan_file = building / path, plans.get(path)
            simulator = simulators.of(path, _simulator_builder(scenario, out, options, plan_file))
            fly = partial(rollout.rollout, scenario, out=out, plans=plan_file)
            if status == "begun":
                fly = partial(rollout.resume, out, plans=plan_file)
            chunk = options.get("chunk")
            run = fly(simulator=simulator, chunk=chunk, progress=progress, processes=group)
            if not run.summary["complete"]:
                return False
            simulators.drop(path)
            release_memory()
    return True


@dataclass(frozen=True, kw_only=True)
class RunGroup:
    """Runs of one folder that one process flies, one after another."""

    building: Path
    parts: tuple[tuple[str, Scenario], ...]
    plans: Mapping[str, Path]
    """As of `fly_runs`."""

    def fly(self) -> bool:
        """Fly what is left of the runs; whether all are whole now."""
        return fly_runs(self.parts, self.building, Progress(), OneProcess(), {}, self.plans)


def fly_groups(groups: Sequence[RunGroup], progress: Progress, processes: int) -> bool:
    """Fly groups of runs in processes side by side; whether all runs are whole then.

    Args:
        groups: those whose scenarios have the same programs of flights are best one group.
        progress: of how far it is, in runs.
        processes: number of processes.
    """
    progress.start(sum(len(group.parts) for group in groups), unit="runs")
    progress.describe("compiling and simulating")
    is_whole = True
    flights = map_on_devices(RunGroup.fly, groups, min(processes, len(groups)), __name__)
    for group, is_flown in zip(groups, flights, strict=True):
        is_whole = is_whole and is_flown
        progress.advance(len(group.parts))
    return is_whole


def _begin_compiling(
    parts: Sequence[tuple[str, Scenario]],
    building: Path,
    simulators: SimulatorCache,
    options: RunOptions,
    plans: Mapping[str, Path],
) -> None:
    """Begin to compile the first run and those after it that are not whole."""
    ahead = [part for part in parts if run_status(building / part[0]) != "whole"]
    for path, scenario in ahead[: 1 + MAX_AHEAD]:
        build = _simulator_builder(scenario, building / path, options, plans.get(path))
        simulators.begin(path, build)


def _simulator_builder(
    scenario: Scenario, path: Path, options: RunOptions, plan_file: Path | None
) -> Callable[[], Simulator]:
    """Return the function that builds the simulator of a run; one that is begun keeps its tile."""
    paths = None if plan_file is None else open_plans(plan_file, scenario).shape
    if run_status(path) == "begun":
        scenario = folder.read_scenario(results_folder.locate_folder(path))
    devices, workers = options.get("devices"), options.get("workers")
    return partial(Simulator, scenario, devices=devices, workers=workers, paths=paths)


def run_status(path: Path) -> str:
    """Return the status of a run: whole, begun or none."""
    if (path / folder.SUMMARY).is_file() and folder.Run(path).summary.get("complete"):
        return "whole"
    building = results_folder.locate_folder(path)
    return "begun" if (building / folder.CONFIG).is_file() else "none"
