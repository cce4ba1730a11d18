"""Simulate device batches of tiles, from their keys to their results on the host.

The device receives its next work before the host waits for the last: segment i + 1 before the
samples of segment i, the worlds of the next device batch before the end of this one. So the host
learns one segment late that every robot of a device batch has ended; the record of each tile is cut
where that tile ended.
"""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import jax
import numpy as np

from angler_mjx.progress import Progress
from angler_mjx.robot.control.plans import Plan
from angler_mjx.runs.simulator import devices
from angler_mjx.runs.simulator.host_planning import PlanNotes, SampledBatch
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage import device_to_host
from angler_mjx.runs.storage.device_to_host import FinishedTile, LastState, TileEnd
from angler_mjx.sim.record import Sample
from angler_mjx.sim.state import World

SEGMENTS_IN_FLIGHT = 2
"""Segments that the device has been given and the host has not taken."""


class StoredPlans(Protocol):
    """Plans that were made before."""

    def of(
        self, firsts: list[int], worlds: World, simulator: Simulator
    ) -> tuple[Plan, PlanNotes | None]:
        """Return the paths of the next device batch, [devices * tile, robot] leading, with notes.

        Args:
            firsts: first world of each device's tile.
            worlds: of them, drawn.
            simulator: whose worlds they are.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class _InFlight:
    """A segment in flight on the device, by tile."""

    number: int
    samples: list[Sample]
    running: list[jax.Array]


def split_tiles(tiles: Sequence[int], devices: int) -> list[list[int]]:
    """Split tiles, given by their first worlds, into device batches of at most one a device."""
    return [list(tiles[i : i + devices]) for i in range(0, len(tiles), devices)]


def simulate_tiles(
    simulator: Simulator,
    tiles: Sequence[int],
    *,
    recorded: bool,
    progress: Progress,
    plans: StoredPlans | None = None,
    seed: int | None = None,
    strict: bool = True,
    modify_worlds: Callable[[list[int], World], World] | None = None,
) -> Iterator[list[FinishedTile]]:
    """Run tiles, a device batch at a time.

    Args:
        simulator: compiled.
        tiles: first world of each.
        recorded: whether samples are kept.
        progress: what to tell.
        plans: made before; instead of the scenario's planner.
        seed: of the worlds; the scenario's if left out.
        strict: refuse worlds that cannot hold the fleet.
        modify_worlds: gives worlds other numbers before they are flown, from the first world of
            each device's tile and the worlds as they were drawn.

    Yields:
        The finished tiles of each device batch.

    Raises:
        RunError: a world cannot hold the fleet, or device memory is used up.
    """
    batches = split_tiles(tiles, simulator.devices)
    sampled: deque[SampledBatch] = deque()

    def sample_next(number: int) -> None:
        sampled.extend(
            _sample_batch(simulator, firsts, seed) for firsts in batches[number : number + 1]
        )

    try:
        sample_next(0)
        for i, firsts in enumerate(batches):
            worlds, notes = simulator.finish(sampled.popleft())
            if plans is not None:
                paths, notes = plans.of(firsts, worlds, simulator)
                worlds = simulator.with_paths(worlds, paths)
            if modify_worlds is not None:
                worlds = modify_worlds(_pad_firsts(simulator, firsts), worlds)
            flight = _BatchFlight(simulator, firsts, recorded, progress, notes, strict)
            if simulator.hosted:  # so that the host plans while the device flies
                sample_next(i + 1)
            flight.run_segments(worlds)
            if not simulator.hosted:
                sample_next(i + 1)
            yield flight.take_results()
    except jax.errors.JaxRuntimeError as error:
        simulator.explain(error)
        raise


def _sample_batch(simulator: Simulator, firsts: list[int], seed: int | None) -> SampledBatch:
    """Begin with a device batch; devices without a tile repeat the last one, which is dropped."""
    n_idle, total = simulator.devices - len(firsts), simulator.scenario.worlds
    counts = [min(simulator.tile, total - first) for first in firsts]
    return simulator.begin(
        _pad_firsts(simulator, firsts), seed=seed, counts=[*counts, *[0] * n_idle]
    )


def _pad_firsts(simulator: Simulator, firsts: list[int]) -> list[int]:
    """Return a first world for each device."""
    return [*firsts, *firsts[-1:] * (simulator.devices - len(firsts))]


class _BatchFlight:
    """One device batch from its worlds to its end."""

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
        self._counts = [min(simulator.tile, total - first) for first in firsts]
        self._parts: list[list[Sample]] = [[] for _ in firsts]
        self._ended = [False] * len(firsts)
        self._last: list[LastState | None] = [None for _ in firsts]
        self._in_flight: deque[_InFlight] = deque()

    def run_segments(self, worlds: World) -> None:
        """Give the device all segments, taking the samples behind it; stop when all have ended."""
        sim, count = self._sim, len(self._firsts)
        self._constants = devices.split_shards(
            device_to_host.select_constants(worlds, recorded=self._recorded), count
        )
        state = sim.reset(worlds)
        for segment_number in range(sim.segments):
            state, sample, running = sim.advance(worlds, state)
            self._in_flight.append(
                _InFlight(
                    number=segment_number,
                    samples=devices.split_shards(sample, count) if self._recorded else [],
                    running=devices.split_shards(running, count),
                )
            )
            if segment_number == 0 and self._strict:
                for constants, first, kept in zip(
                    self._constants, self._firsts, self._counts, strict=True
                ):
                    device_to_host.require_valid(constants, first, kept)
            if len(self._in_flight) == SEGMENTS_IN_FLIGHT:
                self._take_samples(self._in_flight.popleft())
            if all(self._ended):
                break
        self._end = devices.split_shards(
            device_to_host.select_end(state, recorded=self._recorded), count
        )

    def take_results(self) -> list[FinishedTile]:
        """Take what is still in flight, and the end."""
        while self._in_flight:
            self._take_samples(self._in_flight.popleft())
        tile = self._sim.tile
        return [
            FinishedTile(
                first=first,
                kept=self._counts[i],
                constants=jax.tree.map(np.asarray, self._constants[i]),
                end=self._tile_end(i),
                parts=self._parts[i],
                notes=self._notes and self._notes.rows(slice(i * tile, (i + 1) * tile)),
            )
            for i, first in enumerate(self._firsts)
        ]

    def _tile_end(self, i: int) -> TileEnd:
        """Return the end of a tile, at its own last sample even if others of the batch went on."""
        end: TileEnd = jax.tree.map(np.asarray, self._end[i])
        last = self._last[i]
        return end if last is None else replace(end, last=last)

    def _take_samples(self, segment: _InFlight) -> None:
        """Take the samples of a segment for those tiles that had not ended before it."""
        sim = self._sim
        for i, count in enumerate(self._counts):
            if self._ended[i]:
                if self._recorded and self._last[i] is None:
                    step = segment.number * sim.segment_steps
                    self._last[i] = device_to_host.last_state_from(segment.samples[i], step)
                continue
            if self._recorded:
                self._parts[i].append(jax.tree.map(np.asarray, segment.samples[i]))
            running = int(np.asarray(segment.running[i])[:count].sum())
            self._ended[i] = running == 0
            n_segments = sim.segments - segment.number if running == 0 else 1
            steps = running * sim.segment_steps * sim.spec.physics_steps
            self._progress.advance(count * n_segments / sim.segments, steps)
