"""A whole study: batches are flown where the answer is open, until it is good or the budget ends.

What is flown next hangs on nothing but what was flown before, so a study that was interrupted and
resumed comes to the same batches in the same order: those in the file are taken from it, and the
rest is flown. Of several processes each flies its share of the tiles of every batch and tells the
others what became of them, so all know the same and come to the same next batch; the first one
keeps the folder.
"""

import time
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import jax

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.progress import Progress
from angler_mjx.runs.processes import OneProcess, Processes
from angler_mjx.runs.provenance import describe_environment
from angler_mjx.runs.resumable_folder import OpenFolder, open_folder
from angler_mjx.runs.simulator.simulator import default_tile
from angler_mjx.runs.storage.planning_summary import PlanningFailures
from angler_mjx.studies.fleet_size import flying, folder, report
from angler_mjx.studies.fleet_size.conditions import Condition, FleetSizeStudy
from angler_mjx.studies.fleet_size.report import FleetSizeResults
from angler_mjx.studies.fleet_size.sequential_test import (
    SequentialRule,
    build_answer,
    select_next_sizes,
)
from angler_mjx.studies.fleet_size.simulators import Simulators
from angler_mjx.studies.fleet_size.store import FILE, Batch, StudyStore

GOOD, SPENT, LATE, STOPPED = "answered", "max_worlds", "max_minutes", "interrupted"
"""How a study ends."""


class _StoppedError(Exception):
    """One of the processes was interrupted, and all know it."""


@dataclass(kw_only=True)
class _Work:
    """A study in the making."""

    study: FleetSizeStudy
    rule: SequentialRule
    store: StudyStore
    progress: Progress
    stored_batches: dict[tuple[str, int, int], Batch]
    taken: dict[str, dict[int, tuple[int, int]]]
    """Of each condition the counts of the batches that were asked for."""
    ends_at: float | None
    together: Processes
    failures: PlanningFailures
    """Of planners, each kind said once."""
    answers: dict[str, str] = field(default_factory=dict)
    """Answer so far of each condition, as reported last."""
    flown: int = 0
    """Batches that were flown in this run."""


def rule_of(study: FleetSizeStudy) -> SequentialRule:
    """What the sequential part is to know of a study."""
    config, sizes = study.config, study.sizes
    return SequentialRule(
        sizes=sizes,
        first=tuple(sizes.index(size) for size in config.first_sizes()),
        probability=config.probability,
        confidence=config.confidence,
        within=config.within,
        max_worlds=config.budget.max_worlds,
        min_size=config.arrivals or 1,
    )


def tile_of(study: FleetSizeStudy) -> int:
    """Worlds in one device call: the scenario's, or what fits the device and fills batches.

    Raises:
        ConfigError: the scenario's does not.
    """
    batch = study.config.budget.batch
    scenario_tile = study.scenario(study.conditions[0], study.sizes[0]).tile
    if scenario_tile is None:
        max_tile = default_tile(batch)
        return max(n for n in range(1, max_tile + 1) if batch % n == 0)
    if batch % scenario_tile:
        raise ConfigError(
            f"{study.source}: budget.batch = {batch}: must be whole tiles of {scenario_tile} "
            "worlds (tile "
            "of the scenario)"
        )
    return scenario_tile


def run_study(
    study: FleetSizeStudy,
    source: Path,
    out: Path,
    *,
    progress: Progress,
    resume: bool = False,
    devices: int | None = None,
    simulators: Simulators | None = None,
    processes: Processes | None = None,
) -> FleetSizeResults:
    """Make a study, or go on with one.

    Args:
        study: to be made.
        source: its file, of which a copy is kept.
        out: folder to make.
        progress: of how far it is.
        resume: go on with an interrupted one.
        devices: to fly on; all if left out. Changes no byte of the results.
        simulators: of the same study, to use what they have compiled; they are left open.
        processes: that share every batch; each calls this with the same arguments, and they leave
            each other afterwards.

    Returns:
        What ``study.json`` holds; its ``complete`` is false where a resumption would fly more.

    Raises:
        ConfigError: the folder is taken, or is of another study.
        RunError: the disk or the device gave out, or another process did, or no batch had time.
        KeyboardInterrupt: before the first batch was whole.
    """
    together = processes or OneProcess()
    declared = folder.declare_folder(
        study, source, lambda: tile_of(study) if simulators is None else simulators.tile
    )
    with (
        open_folder(declared, out, resume=resume, processes=together) as opened,
        ExitStack() as stack,
    ):
        if simulators is None:
            simulators = Simulators(study, tile=opened.start, devices=devices)
            stack.callback(simulators.close)
        if not resume:
            _report_idle_devices(study, opened.start, devices, together, progress)
        _fill_folder(study, opened, simulators, progress, together)
    return folder.read_results(out)


def _report_idle_devices(
    study: FleetSizeStudy,
    tile: int,
    devices: int | None,
    together: Processes,
    progress: Progress,
) -> None:
    """Say so where a batch has too few tiles for all devices."""
    n_devices = len(jax.local_devices()) if devices is None else devices
    batch, total_devices = study.config.budget.batch, n_devices * together.count
    if batch // tile < total_devices:
        progress.report(
            f"budget.batch = {batch}: {batch // tile} of {total_devices} devices have work, each "
            "takes whole "
            f"tiles of {tile} worlds; give a larger --batch, or in the file set = {{ tile = "
            f"{max(batch // total_devices, 1)} }}"
        )


def _fill_folder(
    study: FleetSizeStudy,
    opened: OpenFolder[int],
    simulators: Simulators,
    progress: Progress,
    together: Processes,
) -> None:
    """Fly until the study ends, then write and publish its results."""
    minutes = study.config.budget.max_minutes
    begun = time.monotonic()
    store = StudyStore(opened.building / FILE, writes=opened.lock is not None)
    work = _Work(
        study=study,
        rule=rule_of(study),
        store=store,
        progress=progress,
        stored_batches={(item.condition, item.size, item.first): item for item in store.batches},
        taken={item.name: {} for item in study.conditions},
        ends_at=None if minutes is None else begun + 60.0 * minutes,
        together=together,
        failures=PlanningFailures(progress.report),
    )
    together.meet("known", len(store.batches))  # nobody writes before all have read
    try:
        ended = _fly_rounds(work, simulators)
    except (KeyboardInterrupt, _StoppedError) as error:
        agreed = together.count == 1 or isinstance(error, _StoppedError)
        if not (store.batches and agreed):
            raise KeyboardInterrupt from error
        ended = STOPPED
    finally:
        store.close()
    if not store.batches:
        raise RunError(
            f"{study.source}: budget.max_minutes = {minutes:g}: was over before the first batch; "
            "give more"
        )
    timing = {"total_s": time.monotonic() - begun, "compiled": simulators.compiled}
    opened.publish(partial(_write_results, work, ended, timing, simulators.tile))


def _write_results(
    work: _Work, ended: str, timing: Mapping[str, float], tile: int, building: Path
) -> None:
    """Write the results of all batches, with how the study ended."""
    results = report.gather_results(work.study, work.rule, work.store.batches, ended)
    results["timing"], results["tile"] = dict(timing), tile
    results["environment"] = describe_environment()
    folder.write_results(building, work.study, results, work.store.batches)


def _fly_rounds(work: _Work, simulators: Simulators) -> str:
    """Fly what is wanted until nothing is; how that ended."""
    while True:
        cells = [
            (at, condition)
            for condition in work.study.conditions
            for at in select_next_sizes(work.rule, work.taken[condition.name])
        ]
        if not cells:
            good = all(build_answer(work.rule, counts).good for counts in work.taken.values())
            return GOOD if good else SPENT
        # Those that share a program come one after another.
        order = {entry.name: i for i, entry in enumerate(work.study.conditions)}
        cells.sort(key=lambda cell: (cell[0], order[cell[1].name]))
        if not _fly_cells(work, simulators, cells):
            return LATE


def _fly_cells(work: _Work, simulators: Simulators, cells: list[tuple[int, Condition]]) -> bool:
    """Fly one batch of each; whether there was time for all."""
    left = [cell for cell in cells if _stored_batch(work, *cell) is None]
    for at, condition in cells:
        batch = _stored_batch(work, at, condition)
        size = work.rule.sizes[at]
        if batch is None:
            over = work.ends_at is not None and time.monotonic() > work.ends_at
            if work.together.meet(f"over/{work.flown}", over)[0]:  # by the clock of the first one
                return False
            simulators.begin((other, work.rule.sizes[ahead]) for ahead, other in left)
            left = left[1:]
            work.progress.describe(f"{condition.name}, {size} robots")
            batch = _fly_shared_batch(
                work, simulators, condition, size, _next_world(work, at, condition)
            )
            work.store.add(batch)
        counts = work.taken[condition.name]
        hits, total = counts.get(at, (0, 0))
        counts[at] = (hits + batch.hits(work.study.config.deadline_s), total + batch.worlds)
        so_far = build_answer(work.rule, counts).text(work.rule.confidence)
        if work.answers.get(condition.name) != so_far:
            work.answers[condition.name] = so_far
            work.progress.report(f"{condition.name}: {so_far}")
        work.progress.advance(batch.worlds)
    return True


def _fly_shared_batch(
    work: _Work, simulators: Simulators, condition: Condition, size: int, first: int
) -> Batch:
    """A batch, of which each process flies a share."""
    together = work.together
    part = None
    try:
        partition = (together.index, together.count)
        part = flying.fly_batch(
            work.study,
            simulators,
            condition,
            size,
            first,
            partition=partition,
            failures=work.failures,
        )
    except KeyboardInterrupt:
        together.stop()
    parts = together.meet(f"batch/{work.flown}", part)
    work.flown += 1
    if None in parts:
        raise _StoppedError
    return flying.merge_parts(condition, size, first, parts)


def _next_world(work: _Work, at: int, condition: Condition) -> int:
    """First world of the next batch of a size and condition."""
    return work.taken[condition.name].get(at, (0, 0))[1]


def _stored_batch(work: _Work, at: int, condition: Condition) -> Batch | None:
    key = (condition.name, work.rule.sizes[at], _next_world(work, at, condition))
    return work.stored_batches.get(key)
