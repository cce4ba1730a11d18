"""Folder of a study: each batch is kept as it is finished.

``study.toml`` (as it was given), ``resolved.json``, ``environment.json``, ``batches.jsonl``; at the
end, or when it is interrupted, ``study.json``, ``results.parquet``, ``page.md`` and figures. While
it is made, it is hidden (``.NAME.partial``).
"""

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import cast

from angler_mjx.errors import ConfigError
from angler_mjx.runs.provenance import describe_environment
from angler_mjx.runs.resumable_folder import ResumableFolder
from angler_mjx.runs.storage import results_folder
from angler_mjx.runs.storage.atomic_files import write_json
from angler_mjx.runs.storage.folder import ENVIRONMENT
from angler_mjx.runs.storage.read_errors import read_table, wrap_read_errors
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.studies.fleet_size import figures, report
from angler_mjx.studies.fleet_size.conditions import FleetSizeStudy
from angler_mjx.studies.fleet_size.config import FleetSizeConfig
from angler_mjx.studies.fleet_size.report import FleetSizeResults
from angler_mjx.studies.fleet_size.store import FILE, Batch

SOURCE, RESOLVED, STUDY = "study.toml", "resolved.json", "study.json"
RESULTS, PAGE = "results.parquet", "page.md"


def declare_folder(
    study: FleetSizeStudy, source: Path, choose_tile: Callable[[], int]
) -> ResumableFolder[int]:
    """Declare the folder of a study; its tile, in worlds, is part of the results' bytes.

    Args:
        study: the study.
        source: its file.
        choose_tile: gives the tile of a new study.
    """

    def begin(building: Path) -> int:
        tile = choose_tile()
        shutil.copyfile(source, building / SOURCE)
        write_json(building / ENVIRONMENT, describe_environment())
        write_json(building / RESOLVED, {**study.resolved(), "tile": tile})
        return tile

    def resume(building: Path) -> int:
        path = building / RESOLVED
        stored = results_folder.require_same_request(
            path, study.resolved(), {"study": FleetSizeConfig, "scenario": Scenario}
        )
        with wrap_read_errors(path):
            return int(stored["tile"])

    return ResumableFolder(
        kind="study",
        request_file=RESOLVED,
        begin=begin,
        resume=resume,
        is_complete=_is_complete,
        advise=results_folder.resumable_by(FILE),
    )


def _is_complete(out: Path) -> bool:
    return (out / STUDY).is_file() and bool(read_results(out).get("complete"))


def read_results(out: Path) -> FleetSizeResults:
    """Read the ``study.json`` of a folder.

    Raises:
        ConfigError: there is none, or it is damaged.
    """
    if not (out / STUDY).is_file():
        raise ConfigError(f"{out}: is no folder of a fleet-size study (no {STUDY} in it)")
    return cast(FleetSizeResults, read_table(out / STUDY))


def write_results(
    building: Path, study: FleetSizeStudy, results: FleetSizeResults, batches: Sequence[Batch]
) -> None:
    """Write tables, page and figures."""
    write_json(building / STUDY, dict(results))
    report.write_results(building / RESULTS, study, batches)
    report.write_page(building / PAGE, results)
    figures.plot_figures(results, building)
