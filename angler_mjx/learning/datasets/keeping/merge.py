"""Several datasets in one."""

import os
import shutil
from collections.abc import Sequence
from pathlib import Path

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.learning.datasets import card, describing, index, manifest, sums
from angler_mjx.learning.datasets.index import of_manifest, shared_environment
from angler_mjx.learning.datasets.manifest import Manifest, PartEntry
from angler_mjx.runs.several import RUNS
from angler_mjx.runs.storage import output_lock

SAME = ("arrays", "time", "conventions", "split_shares", "sample", "licence")
"""What datasets must have in common."""


def merge(places: Sequence[Path], out: Path, name: str | None = None) -> Path:
    """Make one dataset of several; files are linked where the disk can, else copied.

    Args:
        places: of the datasets.
        out: folder to make.
        name: of the new one; that of its folder if None.

    Raises:
        ConfigError: they do not go together, hold the same worlds twice, or the folder is taken.
        RunError: the disk gave out.
    """
    if len(places) < 2:
        raise ConfigError("merge: give two datasets or more")
    found = [manifest.read(place) for place in places]
    _require_alike(places, found)
    claimed = output_lock.acquire(out, what="dataset")
    try:
        whole = _merged(places, found, claimed.building, name or out.name)
        table = of_manifest(claimed.building, whole)
        if (pair := shared_environment(table)) is not None:
            raise ConfigError(
                f"merge: splits {pair[0]} and {pair[1]} would share the environment {pair[2]}; "
                "a shifted scene of one is in another's train, val or test"
            )
        index.write(claimed.building, table)
        whole = describing.counted(whole, table)
        card.write(claimed.building, whole, table)
        digest = sums.write(claimed.building)
        manifest.write(claimed.building, whole.model_copy(update={"sums": digest}))
    except OSError as error:
        claimed.withdraw()
        raise RunError(f"--out {out}: cannot be written ({error.strerror or error})") from error
    except BaseException:
        claimed.withdraw()
        raise
    claimed.publish()
    return out


def _require_alike(places: Sequence[Path], found: Sequence[Manifest]) -> None:
    for place, one in zip(places[1:], found[1:], strict=True):
        for key in SAME:
            if getattr(one, key) != getattr(found[0], key):
                raise ConfigError(
                    f"merge: {key} of {place} is not that of {places[0]}; only datasets that were "
                    "recorded in one way are one dataset"
                )
    seen: dict[tuple[str, int], str] = {}
    for place, one in zip(places, found, strict=True):
        for part in one.parts:
            before = seen.setdefault((part.digest, part.seed), f"{place / part.path}")
            if before != f"{place / part.path}":
                raise ConfigError(
                    f"merge: {place / part.path} flies in the same worlds as {before}; make one of "
                    "the datasets with another seed"
                )


def _merged(
    places: Sequence[Path], found: Sequence[Manifest], building: Path, name: str
) -> Manifest:
    """Bring the run folders together; the manifest but for index and sums."""
    (building / RUNS).mkdir()
    entries: list[PartEntry] = []
    for place, one in zip(places, found, strict=True):
        for part in one.parts:
            own = Path(part.path).name.partition("_")[2] or Path(part.path).name
            path = f"{RUNS}/{len(entries):03d}_{own}"
            shutil.copytree(place / part.path, building / path, copy_function=_link)
            entries.append(part.model_copy(update={"path": path}))
    parameter_sets: dict[str, str] = {}
    for one in found:
        parameter_sets |= one.parameter_sets
    return found[0].model_copy(
        update={
            "name": name,
            "description": "; ".join(dict.fromkeys(x.description for x in found if x.description)),
            "parts": tuple(entries),
            "parameter_sets": parameter_sets,
            "seeds": {**found[0].seeds, "dataset": [one.seeds.get("dataset") for one in found]},
        }
    )


def _link(source: str, target: str) -> None:
    """A file in another place: files of datasets are never written to again, only replaced."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)
