"""Sequence of all checks of a dataset."""

from collections.abc import Callable
from pathlib import Path

from angler_mjx.errors import ConfigError
from angler_mjx.learning.datasets import index, manifest
from angler_mjx.learning.datasets.verifying import integrity, replay
from angler_mjx.learning.datasets.verifying.report import DatasetCheck, VerificationReport


def verify_dataset(
    root: Path, flights: int, progress: Callable[[str, int, int], None]
) -> VerificationReport:
    """Verify a dataset.

    Args:
        root: folder of the dataset.
        flights: episodes to fly again; they are left out where files or values are wrong.
        progress: called with the name of the check, the finished amount and the total.

    Raises:
        ConfigError: the manifest is missing or damaged.
    """
    dataset_manifest = manifest.read_manifest(root)
    steps: list[Callable[[], DatasetCheck]] = [
        lambda: integrity.check_files(root, dataset_manifest),
        lambda: integrity.check_parts(root, dataset_manifest),
        lambda: integrity.check_index(root, dataset_manifest, index.read_index(root)),
        lambda: integrity.check_values(root, dataset_manifest),
    ]
    names = ("files", "parts", "index", "values")
    checks: list[DatasetCheck] = []
    for number, (name, step) in enumerate(zip(names, steps, strict=True)):
        progress(name, number, len(steps))
        try:
            checks.append(step())
        except ConfigError as error:
            failed = DatasetCheck(name=name, looked_at="broke off")
            failed.add_finding(name, str(error))
            checks.append(failed)
    if flights and not any(check.findings for check in checks):
        checks.append(
            replay.replay_episodes(
                root, dataset_manifest, flights, lambda done, of: progress("flying again", done, of)
            )
        )
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
