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
from angler_mjx.runs import rollout
from angler_mjx.runs.processes import OneOfMany, Processes
from angler_mjx.runs.progress import Progress
from angler_mjx.runs.storage import folder, output_lock
from angler_mjx.runs.storage.damage import read_table
from angler_mjx.runs.storage.output_lock import OutputLock
from angler_mjx.scenario.editing import first_difference
from angler_mjx.scenario.scenario import Scenario

MAKING = "making.json"
"""What is made, while it is; a resume must ask for the same."""
RUNS = "runs"
"""Folder of the runs."""


class RunsProgress(Progress, Protocol):
    """What several runs tell: as a run does, and which of them it is."""

    def part(self, number: int, of: int, name: str) -> None:
        """A run of them begins."""


def begin(out: Path, what: str, asked: Mapping[str, Any]) -> OutputLock:
    """Take the name of a folder of several runs.

    Args:
        out: folder to be.
        what: it is, in a word.
        asked: all that is asked for, in plain values.

    Raises:
        ConfigError: the name is taken or cannot be had.
    """
    claimed = output_lock.acquire(out, what=what)
    try:
        folder.write_json(claimed.building / MAKING, dict(asked))
        (claimed.building / RUNS).mkdir()
    except OSError as error:
        claimed.withdraw()
        raise ConfigError(f"--out {out}: cannot be written ({error.strerror})") from error
    return claimed


def again(out: Path, what: str, asked: Mapping[str, Any], *, whole: bool) -> OutputLock:
    """Take up the folder of several runs that were broken off.

    Args:
        out: folder to be.
        what: it is, in a word.
        asked: as of `begin`; must be the same.
        whole: whether nothing is left to do.

    Raises:
        ConfigError: there is none, it is whole, or something else was asked for.
    """
    if whole:
        raise ConfigError(f"--resume {out}: this {what} is complete; nothing is left to do")
    building = folder.where(out)
    if not (building / MAKING).is_file():
        raise ConfigError(f"--resume {out}: there is no interrupted {what} of that name")
    before = read_table(building / MAKING)
    other = first_difference(asked, before)
    if other is not None:
        raise ConfigError(
            f"--resume {out}: was begun with another {other} (see {building / MAKING}); give what "
            "it was begun with, or begin a new one"
        )
    claimed = output_lock.acquire_unfinished(out, what=what)
    if claimed is None:
        raise ConfigError(f"--resume {out}: there is no interrupted {what} of that name")
    return claimed


def fly(
    parts: Iterable[tuple[str, Scenario]],
    building: Path,
    told: RunsProgress,
    together: Processes,
    how: Mapping[str, Any],
) -> bool:
    """Fly what is left of several runs; whether all are whole now.

    Args:
        parts: place of each below the folder, and its scenario.
        building: the folder.
        told: of how far it is.
        together: processes that share each run.
        how: other arguments of `rollout.rollout`.
    """
    parts = tuple(parts)
    for number, (path, scenario) in enumerate(parts):
        told.part(number, len(parts), path)
        if not _fly(scenario, building / path, told, OneOfMany(together, path), how):
            return False
        # Programs of many runs together would use up the memory maps of a process.
        jax.clear_caches()
        gc.collect()
    return True


def _fly(
    scenario: Scenario, place: Path, told: RunsProgress, together: Processes, how: Mapping[str, Any]
) -> bool:
    """Fly a run, or what is left of it; whether it is whole now."""
    found = together.meet("stands", stands(place) if together.index == 0 else None)[0]
    if found == "whole":
        return True
    shared: dict[str, Any] = {"progress": told, "processes": together, **how}
    if found == "begun":
        run = rollout.resume(place, **shared)
    else:
        run = rollout.rollout(scenario, out=place, **shared)
    return bool(run.summary["complete"])


def stands(place: Path) -> str:
    """How far a run is: whole, begun or none."""
    if (place / folder.SUMMARY).is_file() and folder.Run(place).summary.get("complete"):
        return "whole"
    begun = place if place.is_dir() and any(place.iterdir()) else output_lock.partial_path(place)
    return "begun" if (begun / folder.CONFIG).is_file() else "none"
