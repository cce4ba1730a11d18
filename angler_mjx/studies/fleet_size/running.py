"""A whole study: batches are flown where the answer is open, until it is good or the budget ends.

What is flown next hangs on nothing but what was flown before, so a study that was interrupted and
resumed comes to the same batches in the same order: those in the file are taken from it, and the
rest is flown. Of several processes each flies its share of the tiles of every batch and tells the
others what became of them, so all know the same and come to the same next batch; the first one
keeps the folder.
"""

import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import jax

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.runs.processes import OneProcess, Processes, telling
from angler_mjx.runs.provenance import describe_environment
from angler_mjx.runs.simulator.simulator import default_tile
from angler_mjx.runs.storage import output_lock
from angler_mjx.runs.storage.output_lock import OutputLock
from angler_mjx.runs.storage.planned import PlanningFailures
from angler_mjx.studies.fleet_size import flying, folder, report
from angler_mjx.studies.fleet_size.conditions import Condition, FleetSizeStudy
from angler_mjx.studies.fleet_size.sequence import Rule, answer, wanted
from angler_mjx.studies.fleet_size.simulators import Simulators
from angler_mjx.studies.fleet_size.store import FILE, Batch, StudyStore

GOOD, SPENT, LATE, STOPPED = "answered", "most_worlds", "most_minutes", "interrupted"
"""How a study ends."""


class _StoppedError(Exception):
    """One of the processes was interrupted, and all know it."""


class StudyProgress(Protocol):
    """What a study tells while it goes on."""

    def tell(self, text: str) -> None:
        """Something that a person may want to do otherwise."""

    def begin(self, condition: str, size: int) -> None:
        """A batch is to be flown; its program may have to be compiled first."""

    def flown(self, condition: str, worlds: int, so_far: str) -> None:
        """A batch of worlds is over; what is known of the answer of its condition."""


@dataclass(kw_only=True)
class _Work:
    """A study in the making."""

    study: FleetSizeStudy
    rule: Rule
    store: StudyStore
    told: StudyProgress
    known: dict[tuple[str, int, int], Batch]
    taken: dict[str, dict[int, tuple[int, int]]]
    """Of each condition the counts of the batches that were asked for."""
    ends_at: float | None
    together: Processes
    failures: PlanningFailures
    """Of planners, each kind said once."""
    flown: int = 0
    """Batches that were flown in this run."""


def rule_of(study: FleetSizeStudy) -> Rule:
    """What the sequential part is to know of a study."""
    config, sizes = study.config, study.sizes
    return Rule(
        sizes=sizes,
        first=tuple(sizes.index(size) for size in config.first_sizes()),
        probability=config.probability,
        confidence=config.confidence,
        within=config.within,
        most_worlds=config.budget.most_worlds,
        min_size=config.arrivals or 1,
    )


def tile_of(study: FleetSizeStudy) -> int:
    """Worlds in one device call: the scenario's, or what fits the device and fills batches.

    Raises:
        ConfigError: the scenario's does not.
    """
    batch = study.config.budget.batch
    given = study.scenario(study.conditions[0], study.sizes[0]).tile
    if given is None:
        most = default_tile(batch)
        return max(n for n in range(1, most + 1) if batch % n == 0)
    if batch % given:
        raise ConfigError(
            f"{study.source}: budget.batch = {batch}: must be whole tiles of {given} worlds (tile "
            "of the scenario)"
        )
    return given


def run(
    study: FleetSizeStudy,
    source: Path,
    out: Path,
    *,
    told: StudyProgress,
    resume: bool = False,
    devices: int | None = None,
    simulators: Simulators | None = None,
    processes: Processes | None = None,
) -> dict[str, Any]:
    """Make a study, or go on with one.

    Args:
        study: to be made.
        source: its file, of which a copy is kept.
        out: folder to make.
        told: of how far it is.
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
    with telling(together), ExitStack() as stack:
        claimed = tile = None
        if together.index == 0:
            if resume:
                claimed, tile = folder.reopen(study, out)
            else:
                tile = tile_of(study) if simulators is None else simulators.tile
                claimed = folder.begin(study, source, out, tile)
            stack.callback(claimed.release)
        tile = int(together.meet("study", tile)[0])
        if simulators is None:
            simulators = Simulators(study, tile=tile, devices=devices)
            stack.callback(simulators.close)
        if not resume:
            _tell_of_idle(study, tile, devices, together, told)
        place = output_lock.partial_path(out)
        found = _run(study, claimed, place, simulators, told, together)
        together.meet("closed")
    return folder.read(out) if found is None else found


def _tell_of_idle(
    study: FleetSizeStudy, tile: int, devices: int | None, together: Processes, told: StudyProgress
) -> None:
    """Say so where a batch has too few tiles for all devices."""
    here = len(jax.local_devices()) if devices is None else devices
    batch, of = study.config.budget.batch, here * together.count
    if batch // tile < of:
        told.tell(
            f"budget.batch = {batch}: {batch // tile} of {of} devices have work, each takes whole "
            f"tiles of {tile} worlds; give a larger --batch, or in the file set = {{ tile = "
            f"{max(batch // of, 1)} }}"
        )


def _run(
    study: FleetSizeStudy,
    claimed: OutputLock | None,
    place: Path,
    simulators: Simulators,
    told: StudyProgress,
    together: Processes,
) -> dict[str, Any] | None:
    """What ``study.json`` holds; None of a process that does not keep the folder."""
    minutes = study.config.budget.most_minutes
    begun = time.monotonic()
    store = StudyStore(place / FILE, writes=claimed is not None)
    work = _Work(
        study=study,
        rule=rule_of(study),
        store=store,
        told=told,
        known={(one.condition, one.size, one.first): one for one in store.batches},
        taken={one.name: {} for one in study.conditions},
        ends_at=None if minutes is None else begun + 60.0 * minutes,
        together=together,
        failures=PlanningFailures(told.tell),
    )
    together.meet("known", len(store.batches))  # nobody writes before all have read
    try:
        ended = _rounds(work, simulators)
    except (KeyboardInterrupt, _StoppedError) as error:
        agreed = together.count == 1 or isinstance(error, _StoppedError)
        if not (store.batches and agreed):
            raise KeyboardInterrupt from error
        ended = STOPPED
    finally:
        store.close()
    if not store.batches:
        raise RunError(
            f"{study.source}: budget.most_minutes = {minutes:g}: was over before the first batch; "
            "give more"
        )
    if claimed is None:
        return None
    took = {"total_s": time.monotonic() - begun, "compiled": simulators.compiled}
    found = report.gather(study, work.rule, store.batches, ended)
    found |= {"timing": took, "tile": simulators.tile, "environment": describe_environment()}
    folder.close(claimed, study, found, store.batches)
    return found


def _rounds(work: _Work, simulators: Simulators) -> str:
    """Fly what is wanted until nothing is; how that ended."""
    while True:
        cells = [
            (at, condition)
            for condition in work.study.conditions
            for at in wanted(work.rule, work.taken[condition.name])
        ]
        if not cells:
            good = all(answer(work.rule, counts).good for counts in work.taken.values())
            return GOOD if good else SPENT
        # Those that share a program come one after another.
        order = {one.name: i for i, one in enumerate(work.study.conditions)}
        cells.sort(key=lambda cell: (cell[0], order[cell[1].name]))
        if not _fly(work, simulators, cells):
            return LATE


def _fly(work: _Work, simulators: Simulators, cells: list[tuple[int, Condition]]) -> bool:
    """Fly one batch of each; whether there was time for all."""
    left = [cell for cell in cells if _known(work, *cell) is None]
    for at, condition in cells:
        batch = _known(work, at, condition)
        size = work.rule.sizes[at]
        if batch is None:
            over = work.ends_at is not None and time.monotonic() > work.ends_at
            if work.together.meet(f"over/{work.flown}", over)[0]:  # by the clock of the first one
                return False
            simulators.begin((other, work.rule.sizes[ahead]) for ahead, other in left)
            left = left[1:]
            work.told.begin(condition.name, size)
            batch = _flown(work, simulators, condition, size, _first(work, at, condition))
            work.store.add(batch)
        counts = work.taken[condition.name]
        hits, total = counts.get(at, (0, 0))
        counts[at] = (hits + batch.hits(work.study.config.deadline_s), total + batch.worlds)
        so_far = answer(work.rule, counts).text(work.rule.confidence)
        work.told.flown(condition.name, batch.worlds, so_far)
    return True


def _flown(
    work: _Work, simulators: Simulators, condition: Condition, size: int, first: int
) -> Batch:
    """A batch, of which each process flies a share."""
    together = work.together
    part = None
    try:
        share = (together.index, together.count)
        part = flying.fly(
            work.study, simulators, condition, size, first, share=share, failures=work.failures
        )
    except KeyboardInterrupt:
        together.stop()
    parts = together.meet(f"batch/{work.flown}", part)
    work.flown += 1
    if None in parts:
        raise _StoppedError
    return flying.batch(condition, size, first, parts)


def _first(work: _Work, at: int, condition: Condition) -> int:
    """First world of the next batch of a size and condition."""
    return work.taken[condition.name].get(at, (0, 0))[1]


def _known(work: _Work, at: int, condition: Condition) -> Batch | None:
    key = (condition.name, work.rule.sizes[at], _first(work, at, condition))
    return work.known.get(key)
