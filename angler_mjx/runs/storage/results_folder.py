"""Life of a results folder: claimed, filled, interrupted, resumed, published.

All kinds use it: runs, sweeps, benchmarks, datasets, studies, tunings, plans, problems,
environments, exports. A folder that can be resumed has one file that says how it was begun.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.files import FileModel, rename_keys
from angler_mjx.runs.storage import output_lock
from angler_mjx.runs.storage.output_lock import OutputLock
from angler_mjx.runs.storage.read_errors import read_table
from angler_mjx.scenario.editing import first_changed_key


def locate_folder(out: Path) -> Path:
    """Return where the folder of this name lies: hidden until it is published."""
    building = output_lock.partial_path(out)
    return building if building.exists() else out


def resumable_by(name: str) -> Callable[[Path], str | None]:
    """Return the advice on an unfinished folder that can be resumed once it has a file.

    Args:
        name: of the file, below the folder; an empty one does not count.
    """

    def advise(building: Path) -> str | None:
        path = building / name
        return output_lock.RESUMABLE if path.is_file() and path.stat().st_size else None

    return advise


@contextmanager
def build_folder(
    out: Path, *, kind: str, advise: Callable[[Path], str | None] = lambda building: None
) -> Iterator[Path]:
    """Fill the hidden folder inside; it is published at the end, or withdrawn on failure.

    Args:
        out: the folder to be.
        kind: is made, in a word.
        advise: as of `output_lock.acquire`; by default a folder that a killed process left is
            replaced.

    Raises:
        ConfigError: the name is taken.
        RunError: the disk gave out.
    """
    lock = output_lock.acquire(out, kind=kind, advise=advise)
    with lock.filling() as building:
        yield building
    lock.publish()


def resume_folder[T](
    out: Path, *, kind: str, file: str, is_complete: bool, check: Callable[[Path], T]
) -> tuple[OutputLock, T]:
    """Take up an interrupted folder. A refusal changes nothing.

    Args:
        out: the folder to be.
        kind: it is, in a word.
        file: below the folder, that says how it was begun.
        is_complete: whether nothing is left to do.
        check: reads the folder and raises where it must not be resumed.

    Returns:
        The claim, and the result of the check.

    Raises:
        ConfigError: there is none, it is complete, or another process works on it.
    """
    if is_complete:
        raise ConfigError(f"--resume {out}: this {kind} is complete; nothing is left to do")
    building = locate_folder(out)
    if not (building / file).is_file():
        raise ConfigError(f"--resume {out}: there is no interrupted {kind} of that name")
    checked = check(building)
    lock = output_lock.acquire_unfinished(out, kind=kind)
    if lock is None:
        raise ConfigError(f"--resume {out}: there is no interrupted {kind} of that name")
    return lock, checked


def require_same_request(
    path: Path, request: Mapping[str, object], models: Mapping[str, type[FileModel]] | None = None
) -> dict[str, Any]:
    """Return the stored request of a folder; refuse to resume it with a different one.

    Args:
        path: file of the request.
        request: current one, in plain values.
        models: models of tables in it, whose keys may have been renamed since it was begun.

    Raises:
        ConfigError: naming the first key that differs, or that the file is damaged.
    """
    stored = read_table(path)
    for name, model in (models or {}).items():
        if isinstance(table := stored.get(name), dict):
            stored[name] = rename_keys(model, table, str(path))
    require_same_keys(path, request, stored)
    return stored


def require_same_keys(
    path: Path, request: Mapping[str, object], stored: Mapping[str, object]
) -> None:
    """Refuse to resume a folder whose stored request differs from the current one.

    Args:
        path: of what holds the stored request, for the message.
        request: current one, in plain values.
        stored: request with which the folder was begun.

    Raises:
        ConfigError: naming the first key that differs.
    """
    difference = first_changed_key(request, stored)
    if difference is None:
        return
    values = ""
    if difference in request:  # not inside a table, which would be long
        before, now = stored.get(difference), request[difference]
        values = f": {format_value(before)}, not {format_value(now)}"
    raise ConfigError(
        f"--resume: was begun with another {difference} (see {path}{values}); put the old value "
        "back, or begin anew with --out"
    )
