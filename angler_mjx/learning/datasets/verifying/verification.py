"""All checks of a dataset, one after another."""

from collections.abc import Callable
from pathlib import Path

from angler_mjx.errors import ConfigError
from angler_mjx.learning.datasets import index, manifest
from angler_mjx.learning.datasets.verifying import integrity, replay
from angler_mjx.learning.datasets.verifying.report import DatasetCheck, VerificationReport


def verify_dataset(
    root: Path, flights: int, progress: Callable[[str, int, int], None]
) -> VerificationReport:
    """Judge a dataset.

    Args:
        root: its folder.
        flights: episodes to fly again; they are left out where files or values are wrong.
        progress: told what is looked at, how much of it is done, and how much there is.

    Raises:
        ConfigError: there is no manifest, or it cannot be read.
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
        why = "what is stored is damaged" if flights else "--again N flies N episodes again"
        checks.append(
            DatasetCheck(
                name="flown again",
                looked_at=f"not checked: {why}",
                unchecked=dataset_manifest.episodes,
                why=why,
            )
        )
    return VerificationReport(dataset=str(root), checks=tuple(checks))
