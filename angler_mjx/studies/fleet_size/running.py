"""A whole study: batches are flown where the answer is open, until it is good or the budget ends.

What is flown next hangs on nothing but what was flown before, so a study that was interrupted and
resumed comes to the same batches in the same order: those in the file are taken from it, and the
rest is flown.
"""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.runs.provenance import describe_environment
from angler_mjx.simulator.simulator import default_tile
from angler_mjx.storage.claims import Claim
from angler_mjx.studies.fleet_size import folder, report
from angler_mjx.studies.fleet_size.asking import Condition, Study
from angler_mjx.studies.fleet_size.flying import fly
from angler_mjx.studies.fleet_size.sequence import Rule, answer, wanted
from angler_mjx.studies.fleet_size.simulators import Simulators
from angler_mjx.studies.fleet_size.store import FILE, Batch, Store

GOOD, SPENT, LATE, STOPPED = "answered", "most_worlds", "most_minutes", "interrupted"
"""How a study ends."""


class Told(Protocol):
    """What a study tells while it goes on."""

    def begin(self, condition: str, size: int) -> None:
        """A batch is to be flown; its program may have to be compiled first."""

    def flown(self, condition: str, worlds: int, so_far: str) -> None:
        """A batch of worlds is over; what is known of the answer of its condition."""


@dataclass(kw_only=True)
class _Work:
    """A study in the making."""

    study: Study
    rule: Rule
    store: Store
    told: Told
    known: dict[tuple[str, int, int], Batch]
    taken: dict[str, dict[int, tuple[int, int]]]
    """Of each condition the counts of the batches that were asked for."""
    ends_at: float | None


def rule_of(study: Study) -> Rule:
    """What the sequential part is to know of a study."""
    config, sizes = study.config, study.sizes
    return Rule(
        sizes=sizes,
        first=tuple(sizes.index(size) for size in config.first_sizes()),
        probability=config.probability,
        confidence=config.confidence,
        within=config.within,
        most_worlds=config.budget.most_worlds,
    )


def tile_of(study: Study) -> int:
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
    study: Study,
    source: Path,
    out: Path,
    *,
    told: Told,
    resume: bool = False,
    devices: int | None = None,
    simulators: Simulators | None = None,
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

    Returns:
        What ``study.json`` holds; its ``complete`` is false where a resumption would fly more.

    Raises:
        ConfigError: the folder is taken, or is of another study.
        RunError: the disk or the device gave out, or no batch had time.
        KeyboardInterrupt: before the first batch was whole.
    """
    if resume:
        claimed, tile = folder.reopen(study, out)
    else:
        tile = tile_of(study) if simulators is None else simulators.tile
        claimed = folder.begin(study, source, out, tile)
    try:
        made = simulators or Simulators(study, tile=tile, devices=devices)
        try:
            return _run(study, claimed, tile, made, told)
        finally:
            if simulators is None:
                made.close()
    finally:
        claimed.release()


def _run(
    study: Study, claimed: Claim, tile: int, simulators: Simulators, told: Told
) -> dict[str, Any]:
    minutes = study.config.budget.most_minutes
    begun = time.monotonic()
    store = Store(claimed.building / FILE)
    work = _Work(
        study=study,
        rule=rule_of(study),
        store=store,
        told=told,
        known={(one.condition, one.size, one.first): one for one in store.batches},
        taken={one.name: {} for one in study.conditions},
        ends_at=None if minutes is None else begun + 60.0 * minutes,
    )
    try:
        ended = _rounds(work, simulators)
    except KeyboardInterrupt:
        if not store.batches:
            raise
        ended = STOPPED
    finally:
        store.close()
    if not store.batches:
        raise RunError(
            f"{study.source}: budget.most_minutes = {minutes:g}: was over before the first batch; "
            "give more"
        )
    took = {"total_s": time.monotonic() - begun, "compiled": simulators.compiled}
    found = report.gather(study, work.rule, store.batches, ended)
    found |= {"timing": took, "tile": tile, "environment": describe_environment()}
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
            if work.ends_at is not None and time.monotonic() > work.ends_at:
                return False
            simulators.begin((other, work.rule.sizes[ahead]) for ahead, other in left)
            left = left[1:]
            work.told.begin(condition.name, size)
            batch = fly(work.study, simulators, condition, size, _first(work, at, condition))
            work.store.add(batch)
        counts = work.taken[condition.name]
        hits, total = counts.get(at, (0, 0))
        counts[at] = (hits + batch.hits(work.study.config.deadline_s), total + batch.worlds)
        so_far = answer(work.rule, counts).text(work.rule.confidence)
        work.told.flown(condition.name, batch.worlds, so_far)
    return True


def _first(work: _Work, at: int, condition: Condition) -> int:
    """First world of the next batch of a size and condition."""
    return work.taken[condition.name].get(at, (0, 0))[1]


def _known(work: _Work, at: int, condition: Condition) -> Batch | None:
    key = (condition.name, work.rule.sizes[at], _first(work, at, condition))
    return work.known.get(key)
