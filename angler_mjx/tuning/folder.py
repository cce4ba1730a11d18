"""The folder of a tuning: built hidden, kept after each generation, whole under its own name.

``checkpoint.json`` settings and everything that was found, ``gains.toml``, ``report.md``, figures,
and for ArduSub ``ardusub.param`` and ``ardusub.params``. While a search goes on, the folder is
hidden (``.NAME.partial``).
"""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.tuning.search import Generation, History

CHECKPOINT = "checkpoint.json"


def partial_path(out: Path) -> Path:
    """Where the tuning of ``out`` is built."""
    return out.parent / f".{out.name}.partial"


def create(out: Path) -> Path:
    """Make the hidden folder of a new tuning.

    Raises:
        ConfigError: it or ``out`` exists, or the parent cannot be written.
    """
    if out.exists():
        raise ConfigError(f"--out {out}: exists; give another folder or remove it")
    building = partial_path(out)
    if building.exists():
        raise ConfigError(
            f"--out {out}: an unfinished tuning lies in {building}; take it up again with "
            "--resume or remove it"
        )
    try:
        building.mkdir(parents=True)
    except OSError as error:
        raise ConfigError(f"--out {out}: cannot be written ({error.strerror})") from error
    return building


def reopen(out: Path) -> tuple[Path, dict[str, Any]]:
    """The hidden folder of an interrupted tuning, and its checkpoint.

    Raises:
        ConfigError: there is none, or it is complete.
    """
    building = partial_path(out)
    if not building.exists() and (out / CHECKPOINT).is_file():
        if _read(out)["complete"]:
            raise ConfigError(f"--resume {out}: this tuning is complete; nothing is left to do")
        out.rename(building)
    if not (building / CHECKPOINT).is_file():
        raise ConfigError(f"--resume {out}: there is no interrupted tuning of that name")
    return building, _read(building)


def _read(folder: Path) -> dict[str, Any]:
    path = folder / CHECKPOINT
    try:
        table: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: cannot be read ({error})") from error
    return table


def save(building: Path, table: dict[str, Any], history: History, *, complete: bool) -> None:
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
    return [Generation(**one) for one in table["generations"]]


def write(path: Path, text: str) -> None:
    """Write a file whole or not at all.

    Raises:
        RunError: the disk gave out.
    """
    writing = path.with_name(f".{path.name}.partial")
    try:
        writing.write_text(text, encoding="utf-8")
        writing.replace(path)
    except OSError as error:
        writing.unlink(missing_ok=True)
        raise RunError(f"{path}: cannot be written ({error.strerror or error})") from error


def close(building: Path, out: Path) -> None:
    """Give a folder its own name.

    Raises:
        RunError: there is one of that name by now, or the disk gave out.
    """
    try:
        if out.exists():
            raise RunError(f"--out {out}: was made by another meanwhile; this one is {building}")
        building.rename(out)
    except OSError as error:
        raise RunError(f"--out {out}: cannot be written ({error.strerror or error})") from error
