"""A spot check of a dataset: one of each of its parts, and what all of them come to.

The folder holds a spot check a part, with its report. The sum goes into the dataset itself, beside
its manifest and into its card.
"""

import datetime
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.learning.datasets import gaps as record
from angler_mjx.learning.datasets import manifest, sampling
from angler_mjx.learning.datasets.gaps import Checked, GapRow, SpotCheck
from angler_mjx.learning.datasets.keeping import attach
from angler_mjx.learning.datasets.manifest import Manifest, PartEntry
from angler_mjx.runs.storage.folder import Run
from angler_sitl.spotcheck import checking, folder, gaps, page
from angler_sitl.spotcheck.checking import SpotcheckProgress
from angler_sitl.spotcheck.gaps import Gap, Sum
from angler_sitl.spotcheck.results import SpotcheckResult, SpotcheckSettings


def check(
    place: Path,
    settings: SpotcheckSettings,
    out: Path,
    progress: SpotcheckProgress,
    *,
    resume: bool = False,
) -> SpotCheck | None:
    """Do a spot check of a dataset, and write what it found into it.

    Args:
        place: the dataset.
        settings: what is asked for; episodes are those of all parts together.
        out: folder to make, beside the dataset.
        progress: told how far each part is.
        resume: go on with an interrupted one in ``out``.

    Returns:
        What was found; None after an interruption (Ctrl-C), and then the dataset is as it was.

    Raises:
        ConfigError: no dataset, one of policies alone or with fewer episodes than asked for, or as
            in `checking.check`.
        RunError: as in `checking.check`.
    """
    whole = manifest.read(place)
    record.require_outside(place, out)
    parts = [part for part in whole.parts if checking.flies_plans(Run(place / part.path))]
    if not parts:
        raise ConfigError(
            f"{place}: a policy commanded the robots of all its parts, and autopilots fly plans, "
            "not that"
        )
    asked = _asked(parts, settings)
    for part, one in asked:
        checking.plan(place / part.path, one)
    if not resume and out.exists():
        raise ConfigError(
            f"--out {out}: exists; go on with --resume, give another folder or remove it"
        )
    done = []
    for part, one in asked:
        found = _part(place / part.path, one, out / Path(part.path).name, progress, resume=resume)
        if not found.complete:
            return None
        done.append((part, found))
    made = _record(whole, done, settings)
    attach.spotcheck(place, made)
    return made


def shared_out(worlds: Sequence[int], count: int, seed: int) -> list[int]:
    """Episodes of each part: one of each while there are as many, the others by their worlds.

    Args:
        worlds: of each part.
        count: of all parts together.
        seed: says which parts have one where they are too few.
    """
    if count <= len(worlds):
        first = np.random.default_rng(seed).permutation(len(worlds))[:count]
        return [int(i in first) for i in range(len(worlds))]
    more = np.array(worlds) - 1
    return [1 + int(one) for one in sampling.in_proportion(more, count - len(worlds))]


def _asked(
    parts: Sequence[PartEntry], settings: SpotcheckSettings
) -> list[tuple[PartEntry, SpotcheckSettings]]:
    """Parts of which some episodes are flown, each with settings of its own."""
    worlds = [part.worlds for part in parts]
    if settings.episodes < 1:
        raise ConfigError(f"--episodes {settings.episodes}: give 1 or more")
    if settings.episodes > sum(worlds):
        raise ConfigError(
            f"--episodes {settings.episodes}: the dataset has {sum(worlds)} that autopilots can "
            "fly; ask for fewer"
        )
    counts = shared_out(worlds, settings.episodes, settings.seed)
    return [
        (part, replace(settings, episodes=count))
        for part, count in zip(parts, counts, strict=True)
        if count
    ]


def _part(
    run_path: Path,
    settings: SpotcheckSettings,
    out: Path,
    progress: SpotcheckProgress,
    *,
    resume: bool,
) -> SpotcheckResult:
    """The spot check of a part, or what is left of it."""
    begun = resume and (out / folder.TABLE).is_file()
    if begun and folder.read(out)["complete"]:
        return checking.load(run_path, settings, out)
    return checking.check(run_path, settings, out, progress, resume=begun)


def _record(
    whole: Manifest, done: Sequence[tuple[PartEntry, SpotcheckResult]], settings: SpotcheckSettings
) -> SpotCheck:
    starts = np.cumsum([0, *(part.worlds for part in whole.parts)])
    first = {part.path: int(at) for part, at in zip(whole.parts, starts[:-1], strict=True)}
    found: dict[tuple[str, str], list[Gap]] = {}
    for part, one in done:
        for name, reference in page.pairs(one):
            listed = found.setdefault((name, reference), [])
            for count in one.counts:
                listed += [
                    replace(gap, world=gap.world + first[part.path])
                    for gap in one.gaps(name, count, reference)
                ]
    provenance, flying = done[0][1].provenance, {part.path for part, _ in done}
    return SpotCheck(
        autopilot=done[0][1].autopilot,
        command=provenance["command"],
        created=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        seed=settings.seed,
        stratify=settings.stratify,
        source=settings.source,
        flown=tuple(
            Checked(part=part.path, worlds=tuple(pick.world for pick in one.picks))
            for part, one in done
        ),
        left_out=tuple(part.path for part in whole.parts if part.path not in flying),
        rows=tuple(
            _row(name, reference, gaps.add_up(listed))
            for (name, reference), listed in found.items()
            if listed
        ),
    )


def _row(name: str, reference: str, one: Sum) -> GapRow:
    return GapRow(
        flown_by=name,
        against=reference,
        robots=one.robots,
        agree=one.agree,
        agree_low=one.agree_low,
        agree_high=one.agree_high,
        arrivals_agree=one.arrivals_agree,
        track_rms_m=_known(one.track_rms_m),
        path_rms_m=_known(one.path_rms_m),
        endpoint_m=_known(one.endpoint_m),
        arrival_s=_known(one.arrival_s),
        clearance_m=_known(one.clearance_m),
        effort_ratio=None if math.isnan(one.effort_ratio) else one.effort_ratio,
    )


def _known(pair: tuple[float, float]) -> tuple[float | None, float | None]:
    low, high = (None if math.isnan(value) else value for value in pair)
    return low, high
