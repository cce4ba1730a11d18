"""The kernels of the fused engine: one a phase of robots, and the obstacles ahead of them."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import jax

from angler_kernels import lanes
from angler_mjx.sim.engines.lanes import judge as lane_judge
from angler_mjx.sim.engines.triton import launch as triton
from angler_mjx.sim.engines.triton.context import KernelBodies, KernelGroup
from angler_mjx.sim.engines.triton.segment import Arrays, Drift, Segment
from angler_mjx.sim.fleet import VehicleGroup
from angler_mjx.sim.phase import Phase
from angler_mjx.sim.state import SimSpec
from angler_mjx.sim.step import ALONE, DECIDE, JUDGE, MEETING, MOVE, OBSTACLES

TOLD = {
    DECIDE.name: ("command", "loaded"),
    MOVE.name: ("loaded",),
    JUDGE.name: ("command", "finished", "last_approach_s", "approaching"),
}
"""Slots that phases of robots read, by the phase's name, where somebody gives them."""

_SEEN = OBSTACLES.name
"""Record of the obstacles."""

type Launch = Callable[[jax.Array, jax.Array, Arrays], Arrays]
"""What is done in control step ``base + k``."""


class Kernels:
    """The four kernels for one segment, each as one launch of it.

    Every launch is for control step ``base + k``, both int32 [1], counted from the segment's first.
    """

    def __init__(self, program: triton.LaunchedProgram, spec: SimSpec, part: Segment) -> None:
        """Bind them to a segment."""
        self._program, self._spec, self._part = program, spec, part
        self._tile = part.tile

    def launches(self) -> tuple[Launch, Launch]:
        """The obstacles, `Segment.ahead` control steps of them, and what the robots do in one."""
        groups = self._tile.groups
        # Functions of their own, so that each is traced and lowered once for all launches.
        alone = [(phase, jax.jit(partial(self.phase, phase, g))) for g in groups for phase in ALONE]
        meet = [
            (phase, jax.jit(partial(self.phase, phase, g))) for phase in MEETING for g in groups
        ]
        go_ahead = jax.jit(self.go_ahead)

        def obstacles(base: jax.Array, at: jax.Array, x: Arrays) -> Arrays:
            if not self._tile.some_obstacle:
                return x
            bodies, track, seen = go_ahead(base, at, x)
            return replace(x, bodies=bodies, track=track, records={**x.records, _SEEN: seen})

        def robots(base: jax.Array, at: jax.Array, x: Arrays) -> Arrays:
            for phase, launch in (*alone, *meet):
                changed = launch(base, at, x)
                given = dict(zip(phase.gives, changed, strict=False))
                records = {phase.name: changed[-1]} if phase.name in x.records else {}
                x = replace(x, slots={**x.slots, **given}, records={**x.records, **records})
            return x

        return obstacles, robots

    def phase(
        self, phase: Phase, group: VehicleGroup, base: jax.Array, k: jax.Array, x: Arrays
    ) -> Sequence[jax.Array]:
        """One phase of the robots of a group, and its record: what it gives, in that order."""
        part, tile = self._part, self._tile
        read = [part.layout(slot)[0] for slot in phase.reads]
        constant = {slot: x.slots[slot] for slot in read if slot not in phase.gives}
        told = TOLD.get(phase.name, ())
        constant |= {slot: x.slots[slot] for slot in told if slot in x.slots}
        if phase.meets:
            constant["track"] = x.track
        changed = {slot: x.slots[slot] for slot in phase.gives}
        if phase.name in part.shelves:
            changed["record"] = x.records[phase.name]
        head = [part.first, base, k, *tile.arrays]

        def kernel(*refs: Any) -> None:
            (first, base, k), data = refs[:3], refs[3 : len(head)]
            places = dict(zip(constant, refs[len(head) :], strict=False))
            places |= dict(zip(changed, refs[-len(changed) :], strict=True))
            row, lane, at, store = self._place(group.first)
            count = base[0] + k[0]
            here = KernelGroup(
                self._spec,
                part,
                group,
                places,
                data,
                row=row,
                at=at,
                first=part.taken(first, at),
                count=count,
            )
            slots = {slot: here.slot(slot) for slot in phase.reads}
            done = phase.run(here, slots)
            if "record" in places:

                def write_record() -> None:
                    sample, keep = count // part.every, store(places["record"])
                    part.shelves[phase.name].write(keep, sample, row, at, done.record())

                with here.forgetting():
                    triton.when(count % part.every == 0, write_record)
            given = done.slots()
            for slot in phase.gives:
                part.layouts[slot].write(store(places[slot]), lane, given[slot])

        given, kept = [*head, *constant.values()], list(changed.values())
        return self._run(kernel, group.count, given, kept)

    def go_ahead(self, base: jax.Array, k: jax.Array, x: Arrays) -> Sequence[jax.Array]:
        """Control steps of the obstacles, `Segment.ahead` or what is left, and their record."""
        part, tile = self._part, self._tile
        head = [part.first, base, k, *tile.arrays]

        def kernel(*refs: Any) -> None:
            (first, base, k), data = refs[:3], refs[3 : len(head)]
            state, track, seen = refs[-3:]
            row, lane, at, store = self._place(0)
            count = base[0] + k[0]
            here = KernelBodies(self._spec, part, data, row, at)
            here.load()
            taken = part.taken(first, at)

            def one(i: jax.Array, now: Any) -> Any:
                step = count + i
                here.t = part.time(taken + step, self._spec)
                done = OBSTACLES.run(here, {"obstacles": now})

                def write_record() -> None:
                    keep = store(seen)
                    part.shelves[_SEEN].write(keep, step // part.every, row, at, done.record())

                is_left = step < part.steps
                triton.when(is_left & (step % part.every == 0), write_record)
                after = done.slots()["obstacles"]
                there = Drift(p=after.p, q=after.q, v=lane_judge.velocity(after.q, after.nu))
                part.drift.write(store(track), part.ring(step) + lane, there)
                return lanes.where(is_left, after, now)

            start = part.bodies.read(triton.loader(state), lane)
            part.bodies.write(store(state), lane, lanes.repeat(part.ahead, one, start))

        return self._run(kernel, tile.obstacles, head, [x.bodies, x.track, x.records[_SEEN]])

    def _run(
        self, kernel: Any, rows: int, constant: list[Any], changed: list[Any]
    ) -> Sequence[jax.Array]:
        """Run a kernel on ``rows`` x worlds."""
        return triton.call(kernel, self._program, self._tile.worlds, rows, constant, changed)

    def _place(self, first: int) -> tuple[Any, Any, Any, Any]:
        """Row, lanes and worlds of this program, and how its lanes are stored."""
        at, row = triton.place(self._program.lanes)
        row = first + row
        return row, row * self._tile.worlds + at, at, partial(triton.storer, like=at)
