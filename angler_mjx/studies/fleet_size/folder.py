"""The folder of a study: built hidden, with every batch as it comes, whole under its own name.

``study.toml`` (as it was given), ``resolved.json``, ``environment.json``, ``batches.jsonl``; at the
end, or when it is interrupted, ``study.json``, ``results.parquet``, ``page.md`` and figures. While
it is made, it is hidden (``.NAME.partial``).
"""

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.runs.provenance import describe_environment
from angler_mjx.runs.storage import output_lock
from angler_mjx.runs.storage.folder import ENVIRONMENT, write_json
from angler_mjx.runs.storage.output_lock import OutputLock
from angler_mjx.runs.storage.read_errors import read_table, wrap_read_errors
from angler_mjx.scenario.editing import first_changed_key
from angler_mjx.studies.fleet_size import figures, report
from angler_mjx.studies.fleet_size.conditions import FleetSizeStudy
from angler_mjx.studies.fleet_size.store import FILE, Batch

SOURCE, RESOLVED, STUDY = "study.toml", "resolved.json", "study.json"
RESULTS, PAGE = "results.parquet", "page.md"
FOLDER_KIND = "study"


def create_folder(study: FleetSizeStudy, source: Path, out: Path, tile: int) -> OutputLock:
    """A new folder, with all that the study is made of.

    Raises:
        ConfigError: the name is taken.
        RunError: it cannot be written.
    """
    lock = output_lock.acquire(out, kind=FOLDER_KIND, advise=_resumable_status)
    try:
        shutil.copyfile(source, lock.building / SOURCE)
        write_json(lock.building / ENVIRONMENT, describe_environment())
        write_json(lock.building / RESOLVED, {**study.resolved(), "tile": tile})
    except OSError as error:
        lock.withdraw()
        raise RunError(f"--out {out}: cannot be written ({error.strerror or error})") from error
    except BaseException:
        lock.withdraw()
        raise
    return lock


def _resumable_status(building: Path) -> str | None:
    batches = building / FILE
    return output_lock.RESUMABLE if batches.is_file() and batches.stat().st_size else None


def reopen_folder(study: FleetSizeStudy, out: Path) -> tuple[OutputLock, int]:
    """Take up a folder that was interrupted, and its tile.

    Raises:
        ConfigError: there is none, it is complete, or it is of another study.
    """
    if (out / STUDY).is_file() and read_results(out).get("complete"):
        raise ConfigError(f"--resume: {out} is complete; nothing is left to do")
    lock = output_lock.acquire_unfinished(out, kind=FOLDER_KIND)
    if lock is None:
        raise ConfigError(f"--resume: there is no interrupted study {out}")
    resolved_path = lock.building / RESOLVED
    try:
        then = read_table(resolved_path)
        with wrap_read_errors(resolved_path):
            other, tile = first_changed_key(study.resolved(), then), int(then["tile"])
        if other is not None:
            raise ConfigError(
                f"--resume: {out} was begun with another {other}; put the old value back (see "
                f"{resolved_path}), or begin a new study with --out"
            )
    except BaseException:
        lock.release()
        raise
    return lock, tile


def read_results(out: Path) -> dict[str, Any]:
    """What the ``study.json`` of a folder holds.

    Raises:
        ConfigError: there is none, or it is damaged.
    """
    if not (out / STUDY).is_file():
        raise ConfigError(f"{out}: is no folder of a fleet-size study (no {STUDY} in it)")
    return read_table(out / STUDY)


def publish_results(
    lock: OutputLock, study: FleetSizeStudy, results: Mapping[str, Any], batches: Sequence[Batch]
) -> None:
    """Tables, page and figures; then the folder gets its name.

    Raises:
        RunError: the disk gave out.
    """
    building = lock.building
    try:
        write_json(building / STUDY, dict(results))
        report.write_results(building / RESULTS, study, batches)
        report.write_page(building / PAGE, results)
        figures.plot_figures(results, building)
    except OSError as error:
        raise RunError(
            f"--out {lock.out}: cannot be written ({error.strerror or error}); its flights are "
            f"in {building}: make room and go on with --resume"
        ) from error
    lock.publish()
