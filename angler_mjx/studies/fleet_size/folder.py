"""Folder of a study: each batch is kept as it is finished.

``study.toml`` (as it was given), ``resolved.json``, ``environment.json``, ``batches.jsonl``; at the
end, or when it is interrupted, ``study.json``, ``results.parquet``, ``page.md`` and figures. While
it is made, it is hidden (``.NAME.partial``).
"""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import cast

from angler_mjx.errors import ConfigError
from angler_mjx.runs.provenance import describe_environment
from angler_mjx.runs.storage import output_lock, results_folder
from angler_mjx.runs.storage.atomic_files import write_json
from angler_mjx.runs.storage.folder import ENVIRONMENT
from angler_mjx.runs.storage.output_lock import OutputLock
from angler_mjx.runs.storage.read_errors import read_table, wrap_read_errors
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.studies.fleet_size import figures, report
from angler_mjx.studies.fleet_size.conditions import FleetSizeStudy
from angler_mjx.studies.fleet_size.config import FleetSizeConfig
from angler_mjx.studies.fleet_size.store import FILE, Batch

SOURCE, RESOLVED, STUDY = "study.toml", "resolved.json", "study.json"
RESULTS, PAGE = "results.parquet", "page.md"
FOLDER_KIND = "study"


def create_folder(study: FleetSizeStudy, source: Path, out: Path, tile: int) -> OutputLock:
    """Create the folder, with all inputs of the study.

    Raises:
        ConfigError: the name is taken.
        RunError: it cannot be written.
    """
    lock = output_lock.acquire(out, kind=FOLDER_KIND, advise=results_folder.resumable_by(FILE))
    with lock.filling() as building:
        shutil.copyfile(source, building / SOURCE)
        write_json(building / ENVIRONMENT, describe_environment())
        write_json(building / RESOLVED, {**study.resolved(), "tile": tile})
    return lock


def reopen_folder(study: FleetSizeStudy, out: Path) -> tuple[OutputLock, int]:
    """Take up a folder that was interrupted, and its tile; see `results_folder.resume_folder`.

    Raises:
        ConfigError: there is none, it is complete, or it is of another study.
    """

    def check(building: Path) -> int:
        path = building / RESOLVED
        stored = results_folder.require_same_request(
            path, study.resolved(), {"study": FleetSizeConfig, "scenario": Scenario}
        )
        with wrap_read_errors(path):
            return int(stored["tile"])

    is_complete = (out / STUDY).is_file() and bool(read_results(out).get("complete"))
    return results_folder.resume_folder(
        out, kind=FOLDER_KIND, file=RESOLVED, is_complete=is_complete, check=check
    )


def read_results(out: Path) -> report.StudyResults:
    """Read the ``study.json`` of a folder.

    Raises:
        ConfigError: there is none, or it is damaged.
    """
    if not (out / STUDY).is_file():
        raise ConfigError(f"{out}: is no folder of a fleet-size study (no {STUDY} in it)")
    return cast(report.StudyResults, read_table(out / STUDY))


def publish_results(
    lock: OutputLock, study: FleetSizeStudy, results: report.StudyResults, batches: Sequence[Batch]
) -> None:
    """Write tables, page and figures, and publish the folder.

    Raises:
        RunError: the disk gave out.
    """
    with lock.keeping() as building:
        write_json(building / STUDY, dict(results))
        report.write_results(building / RESULTS, study, batches)
        report.write_page(building / PAGE, results)
        figures.plot_figures(results, building)
    lock.publish()
