"""Merging of datasets."""

import os
import shutil
from collections.abc import Sequence
from pathlib import Path

from angler_mjx.errors import ConfigError
from angler_mjx.learning.datasets import card, checksums, index, manifest, manifest_building
from angler_mjx.learning.datasets.index import build_index, find_shared_environment
from angler_mjx.learning.datasets.manifest import Manifest, PartEntry
from angler_mjx.runs.multi_run import RUNS_FOLDER
from angler_mjx.runs.storage import output_lock, results_folder

COMMON_KEYS = ("arrays", "time", "conventions", "split_shares", "sample", "licence")
"""Keys of the manifest that must agree between datasets."""


def merge_datasets(roots: Sequence[Path], out: Path, name: str | None = None) -> Path:
    """Merge datasets into one; files are linked where the disk can, else copied.

    Args:
        roots: folders of the datasets.
        out: folder to create.
        name: name of the new dataset; that of its folder if None.

    Raises:
        ConfigError: the datasets do not agree, hold the same worlds twice, or the folder exists.
        RunError: writing failed.
    """
    if len(roots) < 2:
        raise ConfigError("merge: give two datasets or more")
    manifests = [manifest.read_manifest(root) for root in roots]
    _require_alike(roots, manifests)
    with results_folder.build_folder(
        out, kind="dataset", advise=output_lock.default_advice
    ) as building:
        whole = _merge_parts(roots, manifests, building, name or out.name)
        table = build_index(building, whole)
        if (pair := find_shared_environment(table)) is not None:
            raise ConfigError(
                f"merge: splits {pair[0]} and {pair[1]} would share the environment {pair[2]}; "
                "a shifted scene of one is in another's train, val or test"
            )
        index.write_index(building, table)
        whole = manifest_building.add_counts(whole, table)
        card.write_card(building, whole, table)
        digest = checksums.write_checksums(building)
        manifest.write_manifest(building, whole.model_copy(update={"sums": digest}))
    return out


def _require_alike(roots: Sequence[Path], manifests: Sequence[Manifest]) -> None:
    for root, dataset in zip(roots[1:], manifests[1:], strict=True):
        for key in COMMON_KEYS:
            if getattr(dataset, key) != getattr(manifests[0], key):
                raise ConfigError(
                    f"merge: {key} of {root} is not that of {roots[0]}; only datasets that were "
                    "recorded in one way are one dataset"
                )
    paths: dict[tuple[str, int], str] = {}
    for root, dataset in zip(roots, manifests, strict=True):
        for part in dataset.parts:
            other_path = paths.setdefault((part.digest, part.seed), f"{root / part.path}")
            if other_path != f"{root / part.path}":
                raise ConfigError(
                    f"merge: {root / part.path} flies in the same worlds as {other_path}; make one "
                    "of "
                    "the datasets with another seed"
                )


def _merge_parts(
    roots: Sequence[Path], manifests: Sequence[Manifest], building: Path, name: str
) -> Manifest:
    """Link the run folders together; return the manifest without index and checksums."""
    (building / RUNS_FOLDER).mkdir()
    entries: list[PartEntry] = []
    for root, dataset in zip(roots, manifests, strict=True):
        for part in dataset.parts:
            label = Path(part.path).name.partition("_")[2] or Path(part.path).name
            path = f"{RUNS_FOLDER}/{len(entries):03d}_{label}"
            shutil.copytree(root / part.path, building / path, copy_function=_link_or_copy)
            entries.append(part.model_copy(update={"path": path}))
    parameter_sets: dict[str, str] = {}
    for dataset in manifests:
        parameter_sets |= dataset.parameter_sets
    return manifests[0].model_copy(
        update={
            "name": name,
            "description": "; ".join(
                dict.fromkeys(x.description for x in manifests if x.description)
            ),
            "parts": tuple(entries),
            "parameter_sets": parameter_sets,
            "seeds": {
                **manifests[0].seeds,
                "dataset": [dataset.seeds.get("dataset") for dataset in manifests],
            },
        }
    )


def _link_or_copy(source: str, target: str) -> None:
    """Link or copy a file; files of datasets are never written to again, only replaced."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)
