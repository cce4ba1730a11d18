"""Sequence of all checks of a dataset."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from angler_mjx.errors import ConfigError
from angler_mjx.learning.datasets import index, manifest
from angler_mjx.learning.datasets.manifest import Manifest
from angler_mjx.learning.datasets.verifying import integrity, replay
from angler_mjx.learning.datasets.verifying.report import DatasetCheck, VerificationReport
from angler_mjx.progress import Progress
from angler_mjx.runs.storage.parallel import open_processes


def verify_dataset(
    root: Path, flights: int, progress: Progress, workers: int | None = None
) -> VerificationReport:
    """Verify a dataset.

    Args:
        root: folder of the dataset.
        flights: episodes to fly again; they are left out where files or values are wrong.
        progress: receives the progress of one check after another.
        workers: number of reading processes; see `integrity.count_processes`.

    Raises:
        ConfigError: the manifest is missing or damaged.
        RunError: a process of the pool was killed.
    """
    dataset_manifest = manifest.read_manifest(root)
    checks = _check_files_and_values(root, dataset_manifest, progress, workers)
    if flights and not any(check.findings for check in checks):
        checks.append(replay.replay_episodes(root, dataset_manifest, flights, progress))
    else:
        why = "stored files are damaged" if flights else "--again N flies N episodes again"
        checks.append(
            DatasetCheck(
                name="flown again",
                looked_at=f"not checked: {why}",
                unchecked=dataset_manifest.episodes,
                why=why,
            )
        )
    return VerificationReport(dataset=str(root), checks=tuple(checks))


def _check_files_and_values(
    root: Path, dataset_manifest: Manifest, progress: Progress, workers: int | None
) -> list[DatasetCheck]:
    """Return the checks of what is stored; the processes start during the first of them."""
    count = integrity.count_processes(dataset_manifest, workers)
    of_files = partial(integrity.check_files, root, dataset_manifest, progress)
    of_parts = partial(integrity.check_parts, root, dataset_manifest, progress)
    with open_processes(count, integrity.__name__) as pool:
        return [
            _run_check("files", of_files),
            _run_check("parts", of_parts),
            _run_check(
                "index",
                lambda: integrity.check_index(
                    root, dataset_manifest, index.read_index(root), progress
                ),
            ),
            _run_check(
                "values", lambda: integrity.check_values(root, dataset_manifest, pool, progress)
            ),
        ]


def _run_check(name: str, check: Callable[[], DatasetCheck]) -> DatasetCheck:
    """Return the result of a check; a finding where it broke off."""
    try:
        return check()
    except ConfigError as error:
        failed = DatasetCheck(name=name, looked_at="broke off")
        failed.add_finding(name, str(error))
        return failed
