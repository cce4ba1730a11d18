"""Folder of a tuning: a checkpoint is kept after each generation.

``checkpoint.json`` settings and everything that was found, ``gains.toml``, ``report.md``, figures,
and for ArduSub ``ardusub.param`` and ``ardusub.params``. While a search goes on, the folder is
hidden (``.NAME.partial``).
"""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from angler_mjx.errors import RunError
from angler_mjx.runs.resumable_folder import ResumableFolder
from angler_mjx.runs.storage import atomic_files, output_lock, results_folder
from angler_mjx.runs.storage.read_errors import read_table, wrap_read_errors
from angler_mjx.studies.tuning.search import Generation

CHECKPOINT = "checkpoint.json"
ADVICE = "put back a copy of it, or begin a new tuning"


@dataclass(frozen=True, kw_only=True)
class TuningCheckpoint:
    """Content of ``checkpoint.json``."""

    settings: dict[str, object]
    provenance: dict[str, Any]
    complete: bool = False
    """Whether nothing is left to do."""
    generations: list[Generation] = field(default_factory=list)


def declare_folder(
    start: TuningCheckpoint, require: Callable[[TuningCheckpoint], None]
) -> ResumableFolder[TuningCheckpoint]:
    """Declare the folder of a tuning; it is opened with its checkpoint.

    Args:
        start: checkpoint of a new tuning.
        require: raises where a checkpoint must not be resumed.
    """

    def begin(building: Path) -> TuningCheckpoint:
        save_checkpoint(building, start)
        return start

    def resume(building: Path) -> TuningCheckpoint:
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
    return is_published and _read_checkpoint(out).complete


def _read_checkpoint(folder: Path) -> TuningCheckpoint:
    path = folder / CHECKPOINT
    table = read_table(path, ADVICE)
    with wrap_read_errors(path, ADVICE):
        if not isinstance(table["complete"], bool):
            raise TypeError("complete is neither true nor false")
        for name in ("settings", "provenance"):
            if not isinstance(table[name], dict):
                raise TypeError(f"{name} is no object")
        return TuningCheckpoint(
            settings=table["settings"],
            provenance=table["provenance"],
            complete=table["complete"],
            generations=[_parse_generation(row) for row in table["generations"]],
        )


def save_checkpoint(building: Path, checkpoint: TuningCheckpoint) -> None:
    """Keep what was found so far: the whole file, or the one before it."""
    write_file(building / CHECKPOINT, json.dumps(asdict(checkpoint), indent=1) + "\n")


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
