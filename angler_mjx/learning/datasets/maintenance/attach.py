"""Attachment of later findings to a dataset, beside its manifest and in its card."""

from pathlib import Path

from angler_mjx.learning.datasets import card, checksums, gaps, index, manifest
from angler_mjx.learning.datasets.gaps import SpotCheck
from angler_mjx.runs.storage.atomic_files import wrap_write_errors


def attach_spot_check(root: Path, spot_check: SpotCheck) -> None:
    """Add a spot check, or replace an older one; checksums of all other files are kept.

    Args:
        root: folder of the dataset.
        spot_check: the spot check.

    Raises:
        ConfigError: the folder is no dataset, or its checksum file is damaged.
        RunError: writing failed.
    """
    dataset_manifest = manifest.read_manifest(root)
    table = index.read_index(root)
    digests = checksums.read_checksums(root, dataset_manifest.sums)
    with wrap_write_errors(root, "make room and write it again"):
        gaps.write_spot_check(root, spot_check)
        card.write_readme(root, dataset_manifest, table)
        digest = checksums.update_checksums(root, digests, (gaps.SPOT_CHECK_FILE, card.README))
        manifest.write_manifest(root, dataset_manifest.model_copy(update={"sums": digest}))
