"""What of a dataset was damaged or lost, flown again; what is whole is kept."""

import gc
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import jax

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.learning.datasets import card, gaps, index, manifest, sums
from angler_mjx.learning.datasets.manifest import Manifest, PartEntry
from angler_mjx.learning.datasets.verifying import again
from angler_mjx.runs import rollout
from angler_mjx.runs.progress import Progress
from angler_mjx.runs.storage import folder, output_lock

_NEEDED = (folder.CONFIG, "inputs/")
"""Of a run: without these nobody knows what was flown."""

_TOLD_ANEW = (folder.SUMMARY, folder.LOG, folder.ENVIRONMENT)
"""Say how a run went, so they differ when it goes on."""


@dataclass(frozen=True, kw_only=True)
class Repaired:
    """What came of it."""

    damaged: tuple[str, ...]
    """Files that were."""
    parts: tuple[str, ...]
    """Run folders in which something was flown again."""
    other: tuple[str, ...]
    """Files that are whole now, with other bytes than before."""


def repair(place: Path, told: Progress, *, accept: bool = False) -> Repaired:
    """Fly again what was damaged.

    Args:
        place: the dataset.
        told: of how far it is.
        accept: keep flights that came out otherwise than before, on another device or version.

    Raises:
        ConfigError: it is no dataset, what says what was flown is lost too, or this machine makes
            other bytes and that was not accepted.
        RunError: the disk or the device gave out.
    """
    found = manifest.read(place)
    if output_lock.partial_path(place).exists():
        raise ConfigError(f"{place}: is being made; wait, or go on with it by --resume")
    said = _said(place, found)
    there = set(sums.files(place))
    now = dict(sums.of_files(place, sorted(there & said.keys())))
    damaged = sorted(name for name in said if now.get(name) != said[name])
    if not damaged:
        return Repaired(damaged=(), parts=(), other=())
    parts = [part for part in found.parts if any(_in(name, part) for name in damaged)]
    _require_known(place, parts, damaged)
    if (unlike := again.unlike(found)) and parts and not accept:
        raise ConfigError(
            f"{place}: was made with another {', '.join(unlike)}: flown again here, "
            f"{len(parts)} of its parts would have other bytes; mend it there, copy the files "
            "again, or take that with --accept"
        )
    for part in parts:
        _fly(place / part.path, [name for name in damaged if _in(name, part)], part, told)
        jax.clear_caches()
        gc.collect()
    other = [
        name
        for name, digest in sums.of_files(place, sorted(said.keys() & set(sums.files(place))))
        if digest != said[name] and Path(name).name not in _TOLD_ANEW and "/" in name
    ]
    if other and not accept:
        raise RunError(
            f"{place}: {len(other)} files came out otherwise than they were, {other[0]} first, "
            "though device and versions are the same; keep them with --accept"
        )
    _close(place, found, damaged)
    return Repaired(
        damaged=tuple(damaged), parts=tuple(part.path for part in parts), other=tuple(other)
    )


def _said(place: Path, found: Manifest) -> dict[str, str]:
    """Sums as they were; without their file, what is damaged cannot be known."""
    try:
        return sums.read(place, found.sums)
    except ConfigError as error:
        raise ConfigError(
            f"{error}; without it nobody can tell what is damaged: angler dataset verify --again "
            "says what still is as it was flown"
        ) from error


def _in(name: str, part: PartEntry) -> bool:
    return name.startswith(f"{part.path}/")


def _require_known(place: Path, parts: Sequence[PartEntry], damaged: Sequence[str]) -> None:
    for part in parts:
        for name in damaged:
            inner = name.removeprefix(f"{part.path}/")
            if _in(name, part) and inner.startswith(_NEEDED):
                raise ConfigError(
                    f"{place / name}: says what was flown, and is damaged or lost; copy it again"
                )


def _fly(place: Path, damaged: Sequence[str], part: PartEntry, told: Progress) -> None:
    """Take what is damaged away and go on with the run."""
    try:
        for name in damaged:
            (place / name.removeprefix(f"{part.path}/")).unlink(missing_ok=True)
        summary = place / folder.SUMMARY
        if summary.exists():
            table = json.loads(summary.read_text(encoding="utf-8"))
            folder.write_json(summary, {**table, "complete": False})
    except (OSError, ValueError) as error:
        raise RunError(f"{place}: cannot be mended ({error})") from error
    run = rollout.resume(place, progress=told, chunk=1)
    if not run.summary["complete"]:
        raise RunError(f"{place}: was interrupted; mend it again, and it goes on")


def _close(place: Path, found: Manifest, damaged: Sequence[str]) -> None:
    """Index, card and sums of what is there now; a spot check that was damaged is lost."""
    try:
        if gaps.FILE in damaged:
            (place / gaps.FILE).unlink(missing_ok=True)
        table = index.of_manifest(place, found)
        index.write(place, table)
        card.write(place, found, table)
        manifest.write(place, found.model_copy(update={"sums": sums.write(place)}))
    except OSError as error:
        raise RunError(f"{place}: cannot be written ({error.strerror or error})") from error
