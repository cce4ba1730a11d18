"""Repair of a dataset: damaged or missing parts are flown again, sound ones are kept."""

import gc
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import jax

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.learning.datasets import card, checksums, gaps, index, manifest
from angler_mjx.learning.datasets.manifest import Manifest, PartEntry
from angler_mjx.learning.datasets.verifying import replay
from angler_mjx.progress import Progress
from angler_mjx.runs import rollout
from angler_mjx.runs.storage import folder, output_lock
from angler_mjx.runs.storage.atomic_files import wrap_write_errors, write_json
from angler_mjx.runs.storage.checksums import compare_files

_REQUIRED = (folder.CONFIG, "inputs/")
"""Files of a run that define its flights."""

_RUN_REPORTS = (folder.SUMMARY, folder.LOG, folder.ENVIRONMENT)
"""Reports on the course of a run, which differ after a resume."""


@dataclass(frozen=True, kw_only=True)
class RepairResult:
    """Result of a repair."""

    damaged: tuple[str, ...]
    """Damaged files."""
    parts: tuple[str, ...]
    """Run folders with repeated flights."""
    other: tuple[str, ...]
    """Files that are intact now, with other bytes than before."""


def repair_dataset(root: Path, progress: Progress, *, accept: bool = False) -> RepairResult:
    """Fly the damaged files again.

    Args:
        root: folder of the dataset.
        progress: receives the progress.
        accept: keep flights with other bytes than before, from another device or version.

    Raises:
        ConfigError: the folder is no dataset, the definition of the flights is lost too, or this
            machine makes other bytes and that was not accepted.
        RunError: the disk or the device failed.
    """
    dataset_manifest = manifest.read_manifest(root)
    if output_lock.partial_path(root).exists():
        raise ConfigError(f"{root}: is being made; wait, or go on with it by --resume")
    digests = _read_checksums(root, dataset_manifest)
    compared = compare_files(root, digests, checksums.list_files(root))
    damaged = sorted((*compared.missing, *compared.changed))
    if not damaged:
        return RepairResult(damaged=(), parts=(), other=())
    parts = [
        part for part in dataset_manifest.parts if any(_is_in_part(name, part) for name in damaged)
    ]
    _require_inputs(root, parts, damaged)
    if (differences := replay.environment_differences(dataset_manifest)) and parts and not accept:
        raise ConfigError(
            f"{root}: was made with another {', '.join(differences)}: flown again on this machine, "
            f"{len(parts)} of its parts would have other bytes; mend it there, copy the files "
            "again, or take that with --accept"
        )
    for part in parts:
        _refly_part(
            root / part.path, [name for name in damaged if _is_in_part(name, part)], part, progress
        )
        jax.clear_caches()
        gc.collect()
    other = [
        name
        for name in compare_files(root, digests, checksums.list_files(root)).changed
        if Path(name).name not in _RUN_REPORTS and "/" in name
    ]
    if other and not accept:
        raise RunError(
            f"{root}: {len(other)} files came out otherwise than they were, {other[0]} first, "
            "though device and versions are the same; keep them with --accept"
        )
    _finish_dataset(root, dataset_manifest, damaged)
    return RepairResult(
        damaged=tuple(damaged), parts=tuple(part.path for part in parts), other=tuple(other)
    )


def _read_checksums(root: Path, dataset_manifest: Manifest) -> dict[str, str]:
    """Read the checksums; refuse a dataset without them, whose damage cannot be known."""
    try:
        return checksums.read_checksums(root, dataset_manifest.sums)
    except ConfigError as error:
        raise ConfigError(
            f"{error}; without it damage cannot be located: angler dataset verify --again "
            "lists the intact flights"
        ) from error


def _is_in_part(name: str, part: PartEntry) -> bool:
    return name.startswith(f"{part.path}/")


def _require_inputs(root: Path, parts: Sequence[PartEntry], damaged: Sequence[str]) -> None:
    for part in parts:
        for name in damaged:
            inner = name.removeprefix(f"{part.path}/")
            if _is_in_part(name, part) and inner.startswith(_REQUIRED):
                raise ConfigError(
                    f"{root / name}: defines the flights, and is damaged or lost; copy it again"
                )


def _refly_part(root: Path, damaged: Sequence[str], part: PartEntry, progress: Progress) -> None:
    """Remove the damaged files and resume the run."""
    try:
        for name in damaged:
            (root / name.removeprefix(f"{part.path}/")).unlink(missing_ok=True)
        summary = root / folder.SUMMARY
        if summary.exists():
            table = json.loads(summary.read_text(encoding="utf-8"))
            write_json(summary, {**table, "complete": False})
    except (OSError, ValueError) as error:
        raise RunError(f"{root}: cannot be mended ({error})") from error
    run = rollout.resume(root, progress=progress, chunk=1)
    if not run.summary["complete"]:
        raise RunError(f"{root}: was interrupted; mend it again, and it goes on")


def _finish_dataset(root: Path, dataset_manifest: Manifest, damaged: Sequence[str]) -> None:
    """Write index, card and checksums of the present files; a damaged spot check is dropped."""
    with wrap_write_errors(root):
        if gaps.SPOT_CHECK_FILE in damaged:
            (root / gaps.SPOT_CHECK_FILE).unlink(missing_ok=True)
        table = index.build_index(root, dataset_manifest)
        index.write_index(root, table)
        card.write_card(root, dataset_manifest, table)
        manifest.write_manifest(
            root, dataset_manifest.model_copy(update={"sums": checksums.write_checksums(root)})
        )
