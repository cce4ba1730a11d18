"""Spot check of a dataset: one of each of its parts, and the summary of all.

The folder holds a spot check per part, with its report. The summary goes into the dataset itself,
beside its manifest and into its card.
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
from angler_mjx.learning.datasets.gaps import CheckedPart, GapRow, SpotCheck
from angler_mjx.learning.datasets.maintenance import attach
from angler_mjx.learning.datasets.manifest import Manifest, PartEntry
from angler_mjx.progress import Progress
from angler_mjx.runs.storage import results_folder
from angler_mjx.runs.storage.folder import Run
from angler_sitl.spotcheck import folder, gaps, report_page, runner
from angler_sitl.spotcheck.gaps import FlightGap, GapSummary
from angler_sitl.spotcheck.results import SpotcheckResult, SpotcheckSettings


def check_dataset(
    dataset_path: Path,
    settings: SpotcheckSettings,
    out: Path,
    progress: Progress,
    *,
    resume: bool = False,
) -> SpotCheck | None:
    """Run a spot check of a dataset, and write its results into the dataset.

    Args:
        dataset_path: the dataset.
        settings: of the spot check; the number of episodes is that of all parts together.
        out: folder to create, beside the dataset.
        progress: receives the progress of each part.
        resume: resume an interrupted spot check in ``out``.

    Returns:
        The result; None after an interruption (Ctrl-C), and then the dataset is unchanged.

    Raises:
        ConfigError: no dataset, only policies in it, fewer episodes than requested, or as
            in `runner.run_spot_check`.
        RunError: as in `runner.run_spot_check`.
    """
    dataset_manifest = manifest.read_manifest(dataset_path)
    record.require_outside(dataset_path, out)
    parts = [
        part
        for part in dataset_manifest.parts
        if runner.has_flown_plans(Run(dataset_path / part.path))
    ]
    if not parts:
        raise ConfigError(
            f"{dataset_path}: a policy commanded the robots of all its parts, and autopilots fly "
            "plans, "
            "not that"
        )
    part_settings = _allocate_settings(parts, settings)
    for part, part_options in part_settings:
        runner.plan_spot_check(dataset_path / part.path, part_options)
    if not resume and out.exists():
        raise ConfigError(
            f"--out {out}: exists; go on with --resume, give another folder or remove it"
        )
    done = []
    for part, part_options in part_settings:
        result = _check_part(
            dataset_path / part.path,
            part_options,
            out / Path(part.path).name,
            progress,
            resume=resume,
        )
        if not result.complete:
            return None
        done.append((part, result))
    spot_check = _build_record(dataset_manifest, done, settings)
    attach.attach_spot_check(dataset_path, spot_check)
    return spot_check


def allocate_episodes(worlds: Sequence[int], count: int, seed: int) -> list[int]:
    """Allocate episodes to parts: at least one of each if there are enough, the rest by worlds.

    Args:
        worlds: number of worlds of each part.
        count: number of episodes of all parts together.
        seed: selects the parts with an episode where there are too few.
    """
    if count <= len(worlds):
        chosen = np.random.default_rng(seed).permutation(len(worlds))[:count]
        return [int(i in chosen) for i in range(len(worlds))]
    more = np.array(worlds) - 1
    return [1 + int(extra) for extra in sampling.scale_counts(more, count - len(worlds))]


def _allocate_settings(
    parts: Sequence[PartEntry], settings: SpotcheckSettings
) -> list[tuple[PartEntry, SpotcheckSettings]]:
    """Return the parts with episodes to fly, each with its own settings."""
    worlds = [part.worlds for part in parts]
    if settings.episodes < 1:
        raise ConfigError(f"--episodes {settings.episodes}: give 1 or more")
    if settings.episodes > sum(worlds):
        raise ConfigError(
            f"--episodes {settings.episodes}: the dataset has {sum(worlds)} that autopilots can "
            "fly; ask for fewer"
        )
    counts = allocate_episodes(worlds, settings.episodes, settings.seed)
    return [
        (part, replace(settings, episodes=count))
        for part, count in zip(parts, counts, strict=True)
        if count
    ]


def _check_part(
    run_path: Path,
    settings: SpotcheckSettings,
    out: Path,
    progress: Progress,
    *,
    resume: bool,
) -> SpotcheckResult:
    """Run the spot check of a part, or the rest of an interrupted one."""
    existing = results_folder.locate_folder(out)
    begun = resume and (existing / folder.TABLE).is_file()
    if begun and existing == out and folder.load_table(out)["complete"]:
        return runner.load_result(run_path, settings, out)
    return runner.run_spot_check(run_path, settings, out, progress, resume=begun)


def _build_record(
    dataset_manifest: Manifest,
    done: Sequence[tuple[PartEntry, SpotcheckResult]],
    settings: SpotcheckSettings,
) -> SpotCheck:
    starts = np.cumsum([0, *(part.worlds for part in dataset_manifest.parts)])
    first = {
        part.path: int(at) for part, at in zip(dataset_manifest.parts, starts[:-1], strict=True)
    }
    gaps_by_pair: dict[tuple[str, str], list[FlightGap]] = {}
    for part, result in done:
        for name, reference in report_page.list_comparisons(result):
            pair_gaps = gaps_by_pair.setdefault((name, reference), [])
            for count in result.counts:
                pair_gaps += [
                    replace(gap, world=gap.world + first[part.path])
                    for gap in result.list_gaps(name, count, reference)
                ]
    provenance, flying = done[0][1].provenance, {part.path for part, _ in done}
    return SpotCheck(
        autopilot=done[0][1].autopilot,
        command=str(provenance["command"]),
        created=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        seed=settings.seed,
        stratify=settings.stratify,
        source=settings.source,
        flown=tuple(
            CheckedPart(part=part.path, worlds=tuple(pick.world for pick in result.picks))
            for part, result in done
        ),
        left_out=tuple(part.path for part in dataset_manifest.parts if part.path not in flying),
        rows=tuple(
            _build_row(name, reference, gaps.summarise_gaps(pair_gaps))
            for (name, reference), pair_gaps in gaps_by_pair.items()
            if pair_gaps
        ),
    )


def _build_row(name: str, reference: str, summary: GapSummary) -> GapRow:
    return GapRow(
        flown_by=name,
        against=reference,
        robots=summary.robots,
        agree=summary.agree,
        agree_low=summary.agree_low,
        agree_high=summary.agree_high,
        arrivals_agree=summary.arrivals_agree,
        track_rms_m=_replace_nan(summary.track_rms_m),
        path_rms_m=_replace_nan(summary.path_rms_m),
        endpoint_m=_replace_nan(summary.endpoint_m),
        arrival_s=_replace_nan(summary.arrival_s),
        clearance_m=_replace_nan(summary.clearance_m),
        effort_ratio=None if math.isnan(summary.effort_ratio) else summary.effort_ratio,
    )


def _replace_nan(pair: tuple[float, float]) -> tuple[float | None, float | None]:
    low, high = (None if math.isnan(value) else value for value in pair)
    return low, high
