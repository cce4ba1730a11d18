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
from angler_mjx.runs.storage import atomic, output_lock
from angler_mjx.runs.storage.damage import read_table, reading
from angler_mjx.runs.storage.output_lock import OutputLock
from angler_mjx.studies.tuning.search import Generation, TuningHistory

CHECKPOINT = "checkpoint.json"
ADVICE = "put back a copy of it, or begin a new tuning"


def create(out: Path) -> OutputLock:
    """Take the name of a new tuning and make its hidden folder.

    Raises:
        ConfigError: it or ``out`` exists, or the parent cannot be written.
    """
    return output_lock.acquire(out, what="tuning", left=_left)


def _left(building: Path) -> str | None:
    return output_lock.RESUMABLE if (building / CHECKPOINT).exists() else None


def reopen(
    out: Path, require: Callable[[dict[str, Any]], None] = lambda known: None
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
    place = building if hidden else out
    if not (place / CHECKPOINT).is_file():
        raise ConfigError(f"--resume {out}: there is no interrupted tuning of that name")
    table = _read(place)
    if table["complete"] and not hidden:
        raise ConfigError(f"--resume {out}: this tuning is complete; nothing is left to do")
    with reading(place / CHECKPOINT, ADVICE):
        require(table)
    claimed = output_lock.acquire_unfinished(out, what="tuning")
    if claimed is None:
        raise ConfigError(f"--resume {out}: there is no interrupted tuning of that name")
    return claimed, table


def _read(folder: Path) -> dict[str, Any]:
    path = folder / CHECKPOINT
    table = read_table(path, ADVICE)
    with reading(path, ADVICE):
        if not isinstance(table["complete"], bool):
            raise TypeError("complete is neither true nor false")
        for name in ("settings", "provenance"):
            if not isinstance(table[name], dict):
                raise TypeError(f"{name} is no object")
        generations(table)
    return table


def save(building: Path, table: dict[str, Any], history: TuningHistory, *, complete: bool) -> None:
    """Keep what was found so far: the whole file, or the one before it.

    Args:
        building: the hidden folder.
        table: settings and where they come from.
        history: of the search.
        complete: whether nothing is left to do.
    """
    found = [asdict(one) for one in history.generations]
    whole = json.dumps({**table, "complete": complete, "generations": found}, indent=1)
    write(building / CHECKPOINT, whole + "\n")


def generations(table: dict[str, Any]) -> list[Generation]:
    """What a checkpoint knows."""
    return [_generation(one) for one in table["generations"]]


def _generation(given: dict[str, Any]) -> Generation:
    """One generation; TypeError or ValueError for anything else."""
    made = Generation(**given)
    costs = np.asarray(made.costs, float)
    failed = np.asarray(made.failed)
    slopes = None if made.gradients is None else np.asarray(made.gradients, float)
    if (
        costs.ndim != 1
        or failed.shape != costs.shape
        or failed.dtype.kind != "i"
        or (slopes is not None and (slopes.ndim != 2 or len(slopes) != len(costs)))
    ):
        raise ValueError("a generation is none")
    return made


def write(path: Path, text: str) -> None:
    """Write a file whole or not at all.

    Raises:
        RunError: the disk gave out.
    """
    try:
        atomic.write_text(path, text)
    except OSError as error:
        raise RunError(f"{path}: cannot be written ({error.strerror or error})") from error
