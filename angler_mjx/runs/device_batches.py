"""The device's side of a run: waves of tiles from their keys to their results on the host.

The device is always given the next thing to do before the host waits for the last one: segment
i + 1 before the samples of segment i are taken, the next wave's worlds before this one's end is. So
the host learns one segment late that every robot of a wave has ended; what was recorded of each
tile is cut where that tile ended, whatever ran beside it.
"""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import jax
import numpy as np

from angler_mjx.robot.control.plans import Plan
from angler_mjx.runs.progress import Progress
from angler_mjx.runs.simulator import devices
from angler_mjx.runs.simulator.hosted import PlanNotes, SampledBatch
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage import device_to_host
from angler_mjx.runs.storage.device_to_host import FinishedTile, Last, TileEnd
from angler_mjx.sim.record import Sample
from angler_mjx.sim.state import World

AHEAD = 2
"""Segments that the device has been given and the host has not taken."""


class StoredPlans(Protocol):
    """Plans that were made before."""

    def of(
        self, firsts: list[int], worlds: World, simulator: Simulator
    ) -> tuple[Plan, PlanNotes | None]:
        """Paths of the next wave, [devices * tile, robot] leading, and how they were planned.

        Args:
            firsts: first world of each device's tile.
            worlds: of them, drawn.
            simulator: whose worlds they are.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class _InFlight:
    """A segment that the device works on, by tile."""

    number: int
    samples: list[Sample]
    running: list[jax.Array]


def split(tiles: Sequence[int], devices: int) -> list[list[int]]:
    """Tiles, given by their first worlds, in waves of up to one a device."""
    return [list(tiles[i : i + devices]) for i in range(0, len(tiles), devices)]


def simulate(
    simulator: Simulator,
    tiles: Sequence[int],
    *,
    recorded: bool,
    progress: Progress,
    plans: StoredPlans | None = None,
    seed: int | None = None,
    strict: bool = True,
    changed: Callable[[list[int], World], World] | None = None,
) -> Iterator[list[FinishedTile]]:
    """Run tiles, a wave at a time.

    Args:
        simulator: compiled.
        tiles: first world of each.
        recorded: whether samples are kept.
        progress: what to tell.
        plans: made before; instead of the scenario's planner.
        seed: of the worlds; the scenario's if left out.
        strict: refuse worlds that cannot hold the fleet.
        changed: gives worlds other numbers before they are flown, from the first world of each
            device's tile and the worlds as they were drawn.

    Yields:
        The finished tiles of each wave.

    Raises:
        RunError: a world cannot hold the fleet, or device memory is used up.
    """
    waves = split(tiles, simulator.devices)
    drawn: deque[SampledBatch] = deque()

    def draw(number: int) -> None:
        drawn.extend(_draw(simulator, firsts, seed) for firsts in waves[number : number + 1])

    try:
        draw(0)
        for i, firsts in enumerate(waves):
            worlds, notes = simulator.finish(drawn.popleft())
            if plans is not None:
                path, notes = plans.of(firsts, worlds, simulator)
                worlds = simulator.with_paths(worlds, path)
            if changed is not None:
                worlds = changed(_padded(simulator, firsts), worlds)
            flight = _Flight(simulator, firsts, recorded, progress, notes, strict)
            if simulator.hosted:  # so that the host plans while the device flies
                draw(i + 1)
            flight.fly(worlds)
            if not simulator.hosted:
                draw(i + 1)
            yield flight.land()
    except jax.errors.JaxRuntimeError as error:
        simulator.explain(error)
        raise


def _draw(simulator: Simulator, firsts: list[int], seed: int | None) -> SampledBatch:
    """Begin with a wave; devices without a tile repeat the last one, which is dropped."""
    idle, total = simulator.devices - len(firsts), simulator.scenario.worlds
    kept = [min(simulator.tile, total - first) for first in firsts]
    return simulator.begin(_padded(simulator, firsts), seed=seed, kept=[*kept, *[0] * idle])


def _padded(simulator: Simulator, firsts: list[int]) -> list[int]:
    """A first world for each device."""
    return [*firsts, *firsts[-1:] * (simulator.devices - len(firsts))]


class _Flight:
    """One wave from its worlds to its end."""

    def __init__(
        self,
        simulator: Simulator,
        firsts: list[int],
        recorded: bool,
        progress: Progress,
        notes: PlanNotes | None,
        strict: bool,
    ) -> None:
        self._sim = simulator
        self._strict = strict
        self._notes = notes
        self._firsts = firsts
        self._recorded = recorded
        self._progress = progress
        total = simulator.scenario.worlds
        self._kept = [min(simulator.tile, total - first) for first in firsts]
        self._parts: list[list[Sample]] = [[] for _ in firsts]
        self._ended = [False] * len(firsts)
        self._last: list[Last | None] = [None for _ in firsts]
        self._in_flight: deque[_InFlight] = deque()

    def fly(self, worlds: World) -> None:
        """Give the device all segments, taking the samples behind it; stop when all have ended."""
        sim, count = self._sim, len(self._firsts)
        self._constants = devices.shards(
            device_to_host.constants(worlds, recorded=self._recorded), count
        )
        state = sim.reset(worlds)
        for number in range(sim.segments):
            state, sample, running = sim.advance(worlds, state)
            self._in_flight.append(
                _InFlight(
                    number=number,
                    samples=devices.shards(sample, count) if self._recorded else [],
                    running=devices.shards(running, count),
                )
            )
            if number == 0 and self._strict:
                for at, first, kept in zip(self._constants, self._firsts, self._kept, strict=True):
                    device_to_host.require_valid(at, first, kept)
            if len(self._in_flight) == AHEAD:
                self._take(self._in_flight.popleft())
            if all(self._ended):
                break
        self._end = devices.shards(device_to_host.end(state, recorded=self._recorded), count)

    def land(self) -> list[FinishedTile]:
        """Take what is still in flight, and the end."""
        while self._in_flight:
            self._take(self._in_flight.popleft())
        tile = self._sim.tile
        return [
            FinishedTile(
                first=first,
                kept=self._kept[i],
                constants=jax.tree.map(np.asarray, self._constants[i]),
                end=self._end_of(i),
                parts=self._parts[i],
                notes=self._notes and self._notes.rows(slice(i * tile, (i + 1) * tile)),
            )
            for i, first in enumerate(self._firsts)
        ]

    def _end_of(self, i: int) -> TileEnd:
        """The end of a tile: its own, however long it went on beside others."""
        end: TileEnd = jax.tree.map(np.asarray, self._end[i])
        last = self._last[i]
        return end if last is None else replace(end, last=last)

    def _take(self, segment: _InFlight) -> None:
        """Samples of a segment, of those tiles that had not ended before it."""
        sim = self._sim
        for i, kept in enumerate(self._kept):
            if self._ended[i]:
                if self._recorded and self._last[i] is None:
                    step = segment.number * sim.segment_steps
                    self._last[i] = device_to_host.last_in(segment.samples[i], step)
                continue
            if self._recorded:
                self._parts[i].append(jax.tree.map(np.asarray, segment.samples[i]))
            running = int(np.asarray(segment.running[i])[:kept].sum())
            self._ended[i] = running == 0
            share = sim.segments - segment.number if running == 0 else 1
            steps = running * sim.segment_steps * sim.spec.physics_steps
            self._progress.advance(kept * share / sim.segments, steps)
