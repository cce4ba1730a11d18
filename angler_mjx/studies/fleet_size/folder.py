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
from angler_mjx.runs.storage.damage import read_table, reading
from angler_mjx.runs.storage.folder import ENVIRONMENT, write_json
from angler_mjx.runs.storage.output_lock import OutputLock
from angler_mjx.scenario.editing import first_difference
from angler_mjx.studies.fleet_size import figures, report
from angler_mjx.studies.fleet_size.conditions import FleetSizeStudy
from angler_mjx.studies.fleet_size.store import FILE, Batch

SOURCE, RESOLVED, STUDY = "study.toml", "resolved.json", "study.json"
RESULTS, PAGE = "results.parquet", "page.md"
WHAT = "study"


def begin(study: FleetSizeStudy, source: Path, out: Path, tile: int) -> OutputLock:
    """A new folder, with all that the study is made of.

    Raises:
        ConfigError: the name is taken.
        RunError: it cannot be written.
    """
    claimed = output_lock.acquire(out, what=WHAT, left=_worth)
    try:
        shutil.copyfile(source, claimed.building / SOURCE)
        write_json(claimed.building / ENVIRONMENT, describe_environment())
        write_json(claimed.building / RESOLVED, {**study.resolved(), "tile": tile})
    except OSError as error:
        claimed.withdraw()
        raise RunError(f"--out {out}: cannot be written ({error.strerror or error})") from error
    except BaseException:
        claimed.withdraw()
        raise
    return claimed


def _worth(building: Path) -> str | None:
    batches = building / FILE
    return output_lock.RESUMABLE if batches.is_file() and batches.stat().st_size else None


def reopen(study: FleetSizeStudy, out: Path) -> tuple[OutputLock, int]:
    """Take up a folder that was interrupted, and its tile.

    Raises:
        ConfigError: there is none, it is complete, or it is of another study.
    """
    if (out / STUDY).is_file() and read(out).get("complete"):
        raise ConfigError(f"--resume: {out} is complete; nothing is left to do")
    claimed = output_lock.acquire_unfinished(out, what=WHAT)
    if claimed is None:
        raise ConfigError(f"--resume: there is no interrupted study {out}")
    place = claimed.building / RESOLVED
    try:
        then = read_table(place)
        with reading(place):
            other, tile = first_difference(study.resolved(), then), int(then["tile"])
        if other is not None:
            raise ConfigError(
                f"--resume: {out} was begun with another {other}; put the old value back (see "
                f"{place}), or begin a new study with --out"
            )
    except BaseException:
        claimed.release()
        raise
    return claimed, tile


def read(out: Path) -> dict[str, Any]:
    """What the ``study.json`` of a folder holds.

    Raises:
        ConfigError: there is none, or it is damaged.
    """
    if not (out / STUDY).is_file():
        raise ConfigError(f"{out}: is no folder of a fleet-size study (no {STUDY} in it)")
    return read_table(out / STUDY)


def close(
    claimed: OutputLock, study: FleetSizeStudy, found: Mapping[str, Any], batches: Sequence[Batch]
) -> None:
    """Tables, page and figures; then the folder gets its name.

    Raises:
        RunError: the disk gave out.
    """
    place = claimed.building
    try:
        write_json(place / STUDY, dict(found))
        report.write_results(place / RESULTS, study, batches)
        report.write_page(place / PAGE, found)
        figures.draw(found, place)
    except OSError as error:
        raise RunError(
            f"--out {claimed.out}: cannot be written ({error.strerror or error}); its flights are "
            f"in {place}: make room and go on with --resume"
        ) from error
    claimed.publish()
