"""Several runs in one folder, one after another: what datasets and sweeps are made of.

The folder is built like a run, hidden beside its place; what says that it is whole comes last. A
run of it that was broken off is resumed as any run is, so nothing but tiles in flight is lost.
"""

import gc
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Protocol

import jax

from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel, rename_keys
from angler_mjx.runs import rollout
from angler_mjx.runs.processes import Processes, RunProcesses
from angler_mjx.runs.progress import Progress
from angler_mjx.runs.storage import folder, output_lock
from angler_mjx.runs.storage.output_lock import OutputLock
from angler_mjx.runs.storage.read_errors import read_table
from angler_mjx.scenario.editing import first_changed_key
from angler_mjx.scenario.scenario import Scenario

REQUEST_FILE = "making.json"
"""What is made, while it is; a resume must ask for the same."""
RUNS_FOLDER = "runs"
"""Folder of the runs."""


class RunsProgress(Progress, Protocol):
    """What several runs tell: as a run does, and which of them it is."""

    def part(self, number: int, of: int, name: str) -> None:
        """A run of them begins."""


def create_folder(out: Path, kind: str, request: Mapping[str, Any]) -> OutputLock:
    """Take the name of a folder of several runs.

    Args:
        out: folder to be.
        kind: it is, in a word.
        request: all that is asked for, in plain values.

    Raises:
        ConfigError: the name is taken or cannot be had.
    """
    lock = output_lock.acquire(out, kind=kind)
    try:
        folder.write_json(lock.building / REQUEST_FILE, dict(request))
        (lock.building / RUNS_FOLDER).mkdir()
    except OSError as error:
        lock.withdraw()
        raise ConfigError(f"--out {out}: cannot be written ({error.strerror})") from error
    return lock


def resume_folder(
    out: Path,
    kind: str,
    request: Mapping[str, Any],
    *,
    models: Mapping[str, type[FileModel]],
    is_complete: bool,
) -> OutputLock:
    """Take up the folder of several runs that were broken off.

    Args:
        out: folder to be.
        kind: it is, in a word.
        request: as of `create_folder`; must be the same.
        models: models of tables in it, whose keys may have been renamed since it was begun.
        is_complete: whether nothing is left to do.

    Raises:
        ConfigError: there is none, it is whole, or something else was asked for.
    """
    if is_complete:
        raise ConfigError(f"--resume {out}: this {kind} is complete; nothing is left to do")
    building = folder.locate_folder(out)
    if not (building / REQUEST_FILE).is_file():
        raise ConfigError(f"--resume {out}: there is no interrupted {kind} of that name")
    stored = read_table(building / REQUEST_FILE)
    for name, model in models.items():
        if isinstance(table := stored.get(name), dict):
            stored[name] = rename_keys(model, table, str(building / REQUEST_FILE))
    difference = first_changed_key(request, stored)
    if difference is not None:
        raise ConfigError(
            f"--resume {out}: was begun with another {difference} (see {building / REQUEST_FILE}); "
            "give what "
            "it was begun with, or begin a new one"
        )
    lock = output_lock.acquire_unfinished(out, kind=kind)
    if lock is None:
        raise ConfigError(f"--resume {out}: there is no interrupted {kind} of that name")
    return lock


def fly_runs(
    parts: Iterable[tuple[str, Scenario]],
    building: Path,
    progress: RunsProgress,
    processes: Processes,
    options: Mapping[str, Any],
) -> bool:
    """Fly what is left of several runs; whether all are whole now.

    Args:
        parts: place of each below the folder, and its scenario.
        building: the folder.
        progress: of how far it is.
        processes: processes that share each run.
        options: other arguments of `rollout.rollout`.
    """
    parts = tuple(parts)
    for number, (path, scenario) in enumerate(parts):
        progress.part(number, len(parts), path)
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
    progress: RunsProgress,
    processes: Processes,
    options: Mapping[str, Any],
) -> bool:
    """Fly a run, or what is left of it; whether it is whole now."""
    status = processes.meet("stands", run_status(path) if processes.index == 0 else None)[0]
    if status == "whole":
        return True
    arguments: dict[str, Any] = {"progress": progress, "processes": processes, **options}
    if status == "begun":
        run = rollout.resume(path, **arguments)
    else:
        run = rollout.rollout(scenario, out=path, **arguments)
    return bool(run.summary["complete"])


def run_status(path: Path) -> str:
    """How far a run is: whole, begun or none."""
    if (path / folder.SUMMARY).is_file() and folder.Run(path).summary.get("complete"):
        return "whole"
    building = path if path.is_dir() and any(path.iterdir()) else output_lock.partial_path(path)
    return "begun" if (building / folder.CONFIG).is_file() else "none"
