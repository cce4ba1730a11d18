"""Several runs in one folder, one after another, for datasets and sweeps.

The folder is built like a run, hidden beside its place; what says that it is whole comes last. A
run of it that was broken off is resumed as any run is, so nothing but tiles in flight is lost.
"""

import gc
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path

import jax

from angler_mjx.files import FileModel, JsonTable
from angler_mjx.progress import Progress
from angler_mjx.runs import rollout
from angler_mjx.runs.processes import Processes, RunProcesses
from angler_mjx.runs.storage import folder, output_lock, results_folder
from angler_mjx.runs.storage.atomic_files import write_json
from angler_mjx.runs.storage.output_lock import OutputLock
from angler_mjx.scenario.scenario import Scenario

REQUEST_FILE = "making.json"
"""What is made, while it is; a resume must ask for the same."""
RUNS_FOLDER = "runs"
"""Folder of the runs."""


def create_folder(out: Path, kind: str, request: JsonTable) -> OutputLock:
    """Take the name of a folder of several runs.

    Args:
        out: folder to be.
        kind: it is, in a word.
        request: all that is asked for, in plain values.

    Raises:
        ConfigError: the name is taken or cannot be had.
        RunError: the disk gave out.
    """
    lock = output_lock.acquire(out, kind=kind)
    with lock.filling() as building:
        write_json(building / REQUEST_FILE, dict(request))
        (building / RUNS_FOLDER).mkdir()
    return lock


def resume_folder(
    out: Path,
    kind: str,
    request: JsonTable,
    *,
    models: Mapping[str, type[FileModel]],
    is_complete: bool,
) -> OutputLock:
    """Take up an interrupted folder of several runs; see `results_folder.resume_folder`.

    Args:
        out: folder to be.
        kind: it is, in a word.
        request: as of `create_folder`; must be the same.
        models: models of tables in it, whose keys may have been renamed since it was begun.
        is_complete: whether nothing is left to do.

    Raises:
        ConfigError: there is none, it is complete, or its request differs.
    """
    lock, _ = results_folder.resume_folder(
        out,
        kind=kind,
        file=REQUEST_FILE,
        is_complete=is_complete,
        check=lambda building: results_folder.require_same_request(
            building / REQUEST_FILE, request, models
        ),
    )
    return lock


def fly_runs(
    parts: Iterable[tuple[str, Scenario]],
    building: Path,
    progress: Progress,
    processes: Processes,
    options: Mapping[str, int | None],
) -> bool:
    """Fly what is left of several runs; whether all are whole now.

    Args:
        parts: place of each below the folder, and its scenario.
        building: the folder.
        progress: of how far it is.
        processes: processes that share each run.
        options: ``chunk``, ``devices`` and ``workers`` of `rollout.rollout`; None where missing.
    """
    parts = tuple(parts)
    for number, (path, scenario) in enumerate(parts):
        progress.report(f"run {number + 1} of {len(parts)}: {path}")
        if not _fly_run(
            scenario, building / path, progress, RunProcesses(processes, path), options
        ):
            return False
        # Programs of many runs together would use up the memory maps of a process.
        jax.clear_caches()
        gc.collect()
    return True


def _fly_run(
    scenario: Scenario,
    path: Path,
    progress: Progress,
    processes: Processes,
    options: Mapping[str, int | None],
) -> bool:
    """Fly a run, or what is left of it; whether it is whole now."""
    status = processes.meet("stands", run_status(path) if processes.index == 0 else None)[0]
    if status == "whole":
        return True
    begin = rollout.resume if status == "begun" else partial(rollout.rollout, scenario)
    run = begin(
        out=path,
        chunk=options.get("chunk"),
        progress=progress,
        devices=options.get("devices"),
        processes=processes,
        workers=options.get("workers"),
    )
    return bool(run.summary["complete"])


def run_status(path: Path) -> str:
    """Return the status of a run: whole, begun or none."""
    if (path / folder.SUMMARY).is_file() and folder.Run(path).summary.get("complete"):
        return "whole"
    building = results_folder.locate_folder(path)
    return "begun" if (building / folder.CONFIG).is_file() else "none"
