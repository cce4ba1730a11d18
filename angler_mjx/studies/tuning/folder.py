"""The folder of a tuning: built hidden, kept after each generation, whole under its own name.

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

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.runs.storage import atomic_files, output_lock
from angler_mjx.runs.storage.output_lock import OutputLock
from angler_mjx.runs.storage.read_errors import read_table, wrap_read_errors
from angler_mjx.studies.tuning.search import Generation, TuningHistory

CHECKPOINT = "checkpoint.json"
ADVICE = "put back a copy of it, or begin a new tuning"


def create_folder(out: Path) -> OutputLock:
    """Take the name of a new tuning and make its hidden folder.

    Raises:
        ConfigError: it or ``out`` exists, or the parent cannot be written.
    """
    return output_lock.acquire(out, kind="tuning", advise=_resumable_status)


def _resumable_status(building: Path) -> str | None:
    return output_lock.RESUMABLE if (building / CHECKPOINT).exists() else None


def reopen_folder(
    out: Path, require: Callable[[dict[str, Any]], None] = lambda checkpoint: None
) -> tuple[OutputLock, dict[str, Any]]:
    """The hidden folder of an interrupted tuning, and its checkpoint.

    Args:
        out: name of the tuning.
        require: raises where it is not to be gone on with; asked before anything is moved.

    Raises:
        ConfigError: there is none, it is complete, it goes on, or its checkpoint is damaged.
    """
    building = output_lock.partial_path(out)
    hidden = building.exists()
    checkpoint_folder = building if hidden else out
    if not (checkpoint_folder / CHECKPOINT).is_file():
        raise ConfigError(f"--resume {out}: there is no interrupted tuning of that name")
    table = _read_checkpoint(checkpoint_folder)
    if table["complete"] and not hidden:
        raise ConfigError(f"--resume {out}: this tuning is complete; nothing is left to do")
    with wrap_read_errors(checkpoint_folder / CHECKPOINT, ADVICE):
        require(table)
    lock = output_lock.acquire_unfinished(out, kind="tuning")
    if lock is None:
        raise ConfigError(f"--resume {out}: there is no interrupted tuning of that name")
    return lock, table


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
    """What a checkpoint knows."""
    return [_parse_generation(row) for row in table["generations"]]


def _parse_generation(fields: dict[str, Any]) -> Generation:
    """One generation; TypeError or ValueError for anything else."""
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
