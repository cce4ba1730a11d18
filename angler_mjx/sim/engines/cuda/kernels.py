"""The kernels of the fused engine: one a phase of robots, and the obstacles ahead of them."""

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from functools import partial
from typing import Any

import jax

from angler_kernels import lanes
from angler_mjx.sim.engines.cuda import launch
from angler_mjx.sim.engines.cuda.context import KernelBodies, KernelGroup
from angler_mjx.sim.engines.cuda.segment import Segment, SegmentArrays, TrackedObstacle
from angler_mjx.sim.engines.lanes import judge as lane_judge
from angler_mjx.sim.fleet import VehicleGroup
from angler_mjx.sim.phase import Phase
from angler_mjx.sim.state import SimSpec
from angler_mjx.sim.step import (
    DECIDE,
    JUDGE,
    MOVE,
    OBSTACLES,
)
from angler_mjx.world.obstacles import ObstacleState

OPTIONAL_SLOTS = {
    "command": ("command", "approach"),
    "loaded": ("params",),
    "finished": ("finished",),
    "last_approach_s": ("approach",),
    "approaching": ("approach",),
}
"""Fields of phases' inputs that are made of a slot, by the slot, where something gives it."""

_OBSTACLE_RECORD = OBSTACLES.name
"""Record of the obstacles."""

type KernelLaunch = Callable[[jax.Array, jax.Array, SegmentArrays], SegmentArrays]
"""What is done in control step ``base + k``."""


class Kernels:
    """The four kernels for one segment, each as one launch of it.

    Every launch is for control step ``base + k``, both int32 [1], counted from the segment's first.
    """

    def __init__(self, shape: launch.LaunchShape, spec: SimSpec, part: Segment) -> None:
        """Bind them to a segment."""
        self._shape, self._spec, self._part = shape, spec, part
        self._tile = part.tile

    def build_launches(self) -> tuple[KernelLaunch, KernelLaunch]:
        """Move obstacles for `SegmentResult.ahead` control steps, and robots for one."""
        groups = self._tile.groups
        # Functions of their own, so that each is traced and lowered once for all launches.
        alone = [
            (phase, jax.jit(partial(self.run_phase, phase, g)))
            for g in groups
            for phase in (DECIDE, MOVE)
        ]
        meet = [
            (phase, jax.jit(partial(self.run_phase, phase, g)))
            for phase in (JUDGE,)
            for g in groups
        ]
        advance_obstacles = jax.jit(self.advance_obstacles)

        def obstacles(base: jax.Array, at: jax.Array, x: SegmentArrays) -> SegmentArrays:
            if not self._tile.some_obstacle:
                return x
            bodies, track, seen = advance_obstacles(base, at, x)
            return replace(
                x, bodies=bodies, track=track, records={**x.records, _OBSTACLE_RECORD: seen}
            )

        def robots(base: jax.Array, at: jax.Array, x: SegmentArrays) -> SegmentArrays:
            for phase, run in (*alone, *meet):
                changed = run(base, at, x)
                gives = [entry.name for entry in fields(phase.gives)]
                changed_slots = dict(zip(gives, changed, strict=False))
                records = {phase.name: changed[-1]} if phase.name in x.records else {}
                x = replace(x, slots={**x.slots, **changed_slots}, records={**x.records, **records})
            return x

        return obstacles, robots

    def run_phase(
        self,
        phase: Phase[Any, Any],
        group: VehicleGroup,
        base: jax.Array,
        k: jax.Array,
        x: SegmentArrays,
    ) -> Sequence[jax.Array]:
        """One phase of the robots of a group, and its record: what it gives, in that order."""
        part, tile = self._part, self._tile
        names = [entry.name for entry in fields(phase.takes)]
        gives = [entry.name for entry in fields(phase.gives)]
        read = [part.layout(name)[0] for name in names if part.has_slot(name)]
        constant = {slot: x.slots[slot] for slot in read if slot not in gives}
        constant |= {
            slot: x.slots[slot]
            for slot, made in OPTIONAL_SLOTS.items()
            if slot in x.slots and not set(made).isdisjoint(names)
        }
        if phase.meets:
            constant["track"] = x.track
        changed = {slot: x.slots[slot] for slot in gives}
        if phase.name in part.buffers:
            changed["record"] = x.records[phase.name]
        head = [part.first, base, k, *tile.arrays]

        def kernel(at: jax.Array, row: jax.Array, *refs: jax.Ref) -> None:
            (first, base, k), data = refs[:3], refs[3 : len(head)]
            slot_refs = dict(zip(constant, refs[len(head) :], strict=False))
            slot_refs |= dict(zip(changed, refs[-len(changed) :], strict=True))
            row, lane, store = self._locate_lanes(at, row, group.first)
            count = base[0] + k[0]
            context = KernelGroup(
                self._spec,
                part,
                group,
                slot_refs,
                data,
                row=row,
                at=at,
                first=part.steps_taken(first, at),
                count=count,
            )
            done = phase.run(context, context.read_input(phase))
            if "record" in slot_refs:

                def write_record() -> None:
                    sample, keep = count // part.every, store(slot_refs["record"])
                    part.buffers[phase.name].write_lanes(keep, sample, row, at, done.record())

                with context.discard_loads():
                    launch.run_when(count % part.every == 0, write_record)
            after = done.output()
            for slot in gives:
                part.layouts[slot].write_lanes(store(slot_refs[slot]), lane, getattr(after, slot))

        values, kept = [*head, *constant.values()], list(changed.values())
        return self._call_kernel(kernel, group.count, values, kept)

    def advance_obstacles(
        self, base: jax.Array, k: jax.Array, x: SegmentArrays
    ) -> Sequence[jax.Array]:
        """Control steps of the obstacles, up to `SegmentResult.ahead`, and their record."""
        part, tile = self._part, self._tile
        head = [part.first, base, k, *tile.arrays]

        def kernel(at: jax.Array, row: jax.Array, *refs: jax.Ref) -> None:
            (first, base, k), data = refs[:3], refs[3 : len(head)]
            state, track, seen = refs[-3:]
            row, lane, store = self._locate_lanes(at, row, 0)
            count = base[0] + k[0]
            context = KernelBodies(self._spec, part, data, row, at)
            context.load_constants()
            taken = part.steps_taken(first, at)

            def advance_step(i: jax.Array, now: ObstacleState) -> ObstacleState:
                step = count + i
                context.t = part.elapsed_s(taken + step, self._spec)
                done = OBSTACLES.run(context, now)

                def write_record() -> None:
                    keep = store(seen)
                    part.buffers[_OBSTACLE_RECORD].write_lanes(
                        keep, step // part.every, row, at, done.record()
                    )

                is_left = step < part.steps
                launch.run_when(is_left & (step % part.every == 0), write_record)
                after = done.output()
                tracked = TrackedObstacle(
                    p=after.p, q=after.q, v=lane_judge.centre_velocity(after.q, after.nu)
                )
                part.track_layout.write_lanes(store(track), part.track_offset(step) + lane, tracked)
                return lanes.select_lanes(is_left, after, now)

            start = part.bodies.read_lanes(launch.make_loader(state), lane)
            part.bodies.write_lanes(
                store(state), lane, lanes.repeat(part.ahead, advance_step, start)
            )

        return self._call_kernel(
            kernel, tile.obstacles, head, [x.bodies, x.track, x.records[_OBSTACLE_RECORD]]
        )

    def _call_kernel(
        self,
        kernel: Callable[..., None],
        rows: int,
        constant: list[jax.Array],
        changed: list[jax.Array],
    ) -> Sequence[jax.Array]:
        """Run a kernel on ``rows`` x worlds."""
        return launch.call_kernel(kernel, self._shape, self._tile.worlds, rows, constant, changed)

    def _locate_lanes(
        self, at: jax.Array, row: jax.Array, first: int
    ) -> tuple[jax.Array, jax.Array, Callable[[jax.Ref], Callable[..., None]]]:
        """Return row and lanes of worlds ``at``, and how they are stored."""
        row = first + row
        return row, row * self._tile.worlds + at, partial(launch.make_storer, like=at)
