"""Folder of a tuning: a checkpoint is kept after each generation.

``checkpoint.json`` settings and everything that was found, ``gains.toml``, ``report.md``, figures,
and for ArduSub ``ardusub.param`` and ``ardusub.params``. While a search goes on, the folder is
hidden (``.NAME.partial``).
"""

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from angler_mjx.errors import RunError
from angler_mjx.runs.resumable_folder import ResumableFolder
from angler_mjx.runs.storage import atomic_files, output_lock, results_folder
from angler_mjx.runs.storage.read_errors import read_table, wrap_read_errors
from angler_mjx.studies.tuning.search import Generation, TuningHistory

CHECKPOINT = "checkpoint.json"
ADVICE = "put back a copy of it, or begin a new tuning"


def declare_folder(
    table: dict[str, Any], require: Callable[[dict[str, Any]], None]
) -> ResumableFolder[dict[str, Any]]:
    """Declare the folder of a tuning; it is opened with its checkpoint.

    Args:
        table: settings and provenance of a new tuning.
        require: raises where a checkpoint must not be resumed.
    """

    def begin(building: Path) -> dict[str, Any]:
        save_checkpoint(building, table, TuningHistory(), complete=False)
        return {**table, "generations": []}

    def resume(building: Path) -> dict[str, Any]:
        checkpoint = _read_checkpoint(building)
        with wrap_read_errors(building / CHECKPOINT, ADVICE):
            require(checkpoint)
        return checkpoint

    return ResumableFolder(
        kind="tuning",
        request_file=CHECKPOINT,
        begin=begin,
        resume=resume,
        is_complete=_is_complete,
        advise=results_folder.resumable_by(CHECKPOINT),
    )


def _is_complete(out: Path) -> bool:
    """Return whether a published tuning has all its generations."""
    is_published = not output_lock.partial_path(out).exists() and (out / CHECKPOINT).is_file()
    return is_published and bool(_read_checkpoint(out)["complete"])


def _read_checkpoint(folder: Path) -> dict[str, Any]:
    path = folder / CHECKPOINT
    table = read_table(path, ADVICE)
    with wrap_read_errors(path, ADVICE):
        if not isinstance(table["complete"], bool):
            raise TypeError("complete is neither true nor false")
        for name in ("settings", "provenance"):
            if not isinstance(table[name], dict):
                raise TypeError(f"{name} is no object")
        read_generations(table)
    return table


def save_checkpoint(
    building: Path, table: dict[str, Any], history: TuningHistory, *, complete: bool
) -> None:
    """Keep what was found so far: the whole file, or the one before it.

    Args:
        building: the hidden folder.
        table: settings and where they come from.
        history: of the search.
        complete: whether nothing is left to do.
    """
    rows = [asdict(generation) for generation in history.generations]
    whole = json.dumps({**table, "complete": complete, "generations": rows}, indent=1)
    write_file(building / CHECKPOINT, whole + "\n")


def read_generations(table: dict[str, Any]) -> list[Generation]:
    """Return the generations of a checkpoint."""
    return [_parse_generation(row) for row in table["generations"]]


def _parse_generation(fields: dict[str, Any]) -> Generation:
    """Parse a generation; raise TypeError or ValueError for anything else."""
    generation = Generation(**fields)
    costs = np.asarray(generation.costs, float)
    failed = np.asarray(generation.failed)
    slopes = None if generation.gradients is None else np.asarray(generation.gradients, float)
    if (
        costs.ndim != 1
        or failed.shape != costs.shape
        or failed.dtype.kind != "i"
        or (slopes is not None and (slopes.ndim != 2 or len(slopes) != len(costs)))
    ):
        raise ValueError("a generation is none")
    return generation


def write_file(path: Path, text: str) -> None:
    """Write a file whole or not at all.

    Raises:
        RunError: the disk gave out.
    """
    try:
        atomic_files.write_text(path, text)
    except OSError as error:
        raise RunError(f"{path}: cannot be written ({error.strerror or error})") from error
