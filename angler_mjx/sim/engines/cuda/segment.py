"""Where everything that changes in a segment lies for the kernels: states, scratch and records."""

from dataclasses import dataclass, fields
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike

from angler_kernels.lanes.planes import PlaneLayout, SampleBuffer
from angler_mjx.robot.control.stack import Command
from angler_mjx.sim import record, step
from angler_mjx.sim.engines.cuda.launch import LaunchShape
from angler_mjx.sim.engines.cuda.packing import fits_kernel, pack_trees
from angler_mjx.sim.engines.cuda.tile import Tile
from angler_mjx.sim.phase import Phase, Record
from angler_mjx.sim.record import Sample, WorldRecord, build_sample
from angler_mjx.sim.state import SimSpec, WorldState
from angler_mjx.sim.step import DECIDE, JUDGE, MOVE, OBSTACLES, RobotState
from angler_mjx.sim.world_phases import WorldMemory, WorldPhaseOutput

_ALWAYS_SLOTS = ("estimate", "thrust_n", "power_w", "before_m", "broken")
"""Slots that do not last from step to step; `step.scratch_shapes` and the estimate."""

MAX_STEPS_AHEAD = 5
"""Control steps that obstacles are moved ahead of the robots, where no policy watches them."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class TrackedObstacle:
    """Where an obstacle is after a control step: what detection wants to know."""

    p: jax.Array | jax.ShapeDtypeStruct
    q: jax.Array | jax.ShapeDtypeStruct
    v: jax.Array | jax.ShapeDtypeStruct


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class SegmentArrays:
    """Flat arrays that change from launch to launch."""

    slots: dict[str, jax.Array]
    """Slots of the phases of robots, by field of their inputs and outputs (`angler_mjx.sim.step`);
    those of `WorldPhaseOutput.to_slots`; ``command`` where one drives the robots."""
    bodies: jax.Array
    """`ObstacleState`, as far ahead as they were moved."""
    track: jax.Array
    """`TrackedObstacle` of as many steps as obstacles are moved ahead."""
    records: dict[str, jax.Array]
    """What each phase of robots and obstacles recorded, by the phase's name."""
    memory: WorldMemory
    """[W] leads: what robots know of themselves is not the kernels' work."""
    phase_records: WorldRecord
    """Record of the phases of worlds, [samples, W, ...]."""


class Segment:
    """Control steps of one tile, with a sample of the first of every ``every``.

    Attributes:
        tile: constants of the worlds.
        steps: how many control steps.
        every: control steps from one sample to the next.
        ahead: control steps that obstacles are moved ahead of the robots.
        first: int32 [1] control steps taken before; [W] where lanes look up which world they are.
        start: arrays at the beginning.
        layouts: of the slots, by name.
        bodies, drift: layouts of the obstacles.
        shelves: of the samples, by the phase that records them.
    """

    def __init__(
        self,
        tile: Tile,
        state: WorldState,
        n_sample: int,
        every: int,
        command: Command | None,
        output: WorldPhaseOutput | None,
        *,
        ahead: int = MAX_STEPS_AHEAD,
        also: tuple[str, ...] = (),
        last_approach_s: jax.Array | None = None,
        packing: LaunchShape | None = None,
    ) -> None:
        """Lay everything out.

        Args:
            tile: constants of the worlds.
            state: of the worlds.
            n_sample: samples of each.
            every: control steps from one sample to the next.
            command: what drives the controllers instead of the paths; if anything does.
            output: shapes of what the phases of worlds give; if they give anything.
            ahead: control steps that obstacles are moved ahead of the robots.
            also: what is recorded because it is asked for.
            last_approach_s: [W, R], of `last_approaches_s`; None where no plans are flown.
            packing: threads of the kernels that pack states; None to leave it to XLA.
        """
        self._also = also
        self.ahead = ahead
        self.tile, self._state, self._packing = tile, state, packing
        self._samples, self.every, self.steps = n_sample, every, n_sample * every
        self.first = state.step if tile.some_rows else state.step[:1]
        slot_trees = {"vehicle": state.vehicles, "memory": state.carry, "tally": state.tally}
        if command is not None:
            slot_trees["command"] = command
        if last_approach_s is not None:
            slot_trees["last_approach_s"] = last_approach_s
        packed = self._pack(slot_trees)
        self.layouts: dict[str, PlaneLayout[Any]] = {
            name: layout for name, (layout, _) in packed.items()
        }
        self.bodies, bodies = self._pack({"": state.obstacles})[""]
        self.layouts |= self._scratch_layouts(output)
        three, four = tile.shape(3), tile.shape(4)
        self.track_layout = tile.layout(TrackedObstacle(p=three, q=four, v=three), tile.obstacles)
        self.buffers = {
            phase.name: shelf
            for phase in (DECIDE, MOVE, OBSTACLES, JUDGE)
            if (shelf := self._sample_buffer(phase)) is not None
        }
        # Written before it is read: it need not be filled.
        allocate = partial(_allocate_array, dtype=tile.dtype)
        self.start = SegmentArrays(
            slots={
                name: packed[name][1] if name in packed else allocate(layout.size)
                for name, layout in self.layouts.items()
            },
            bodies=bodies,
            track=allocate(ahead * self.track_layout.size if tile.some_obstacle else 1),
            records={name: allocate(buffer.size) for name, buffer in self.buffers.items()},
            memory=WorldMemory.of(state),
            phase_records=WorldRecord()
            if output is None
            else jax.tree.map(
                lambda leaf: jnp.zeros((n_sample, *leaf.shape), leaf.dtype), output.record
            ),
        )

    def has_slot(self, name: str) -> bool:
        """Return whether a field of the input of a phase is a slot."""
        return name in (*_ALWAYS_SLOTS, *(entry.name for entry in fields(RobotState)))

    def layout(self, slot: str) -> tuple[str, PlaneLayout[Any]]:
        """The slot that one is read from, and its layout: what is known may be the truth."""
        name = "vehicle" if slot == "estimate" and slot not in self.layouts else slot
        return name, self.layouts[name]

    def steps_taken(self, first: jax.Ref, at: jax.Array) -> jax.Array:
        """Control steps that worlds number ``at`` took before, of `first` in a kernel."""
        steps: jax.Array = first[at] if self.tile.some_rows else first[0]
        return steps

    def elapsed_s(self, count: jax.Array, spec: SimSpec) -> jax.Array:
        """[] s when so many control steps were taken."""
        return count.astype(self.tile.dtype) * spec.control_dt_s

    def track_offset(self, count: jax.Array) -> jax.Array:
        """Where in the track a control step begins, counted from the segment's first."""
        return count % self.ahead * self.track_layout.size

    def collect_result(self, end: SegmentArrays) -> tuple[WorldState, Sample]:
        """The state after all steps, and the samples."""
        tile, state = self.tile, self._state
        of_robot, of_body = (tile.worlds, tile.robots), (tile.worlds, tile.obstacles)
        kept = RobotState(
            **{
                entry.name: self.layouts[entry.name].unpack(end.slots[entry.name], of_robot)
                for entry in fields(RobotState)
            }
        )
        after = WorldState(
            vehicles=kept.vehicle,
            carry=kept.memory,
            obstacles=self.bodies.unpack(end.bodies, of_body),
            tally=kept.tally,
            step=state.step + self.steps,
            **vars(end.memory),
        )
        worlds: WorldRecord = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, 1), end.phase_records)
        seen: Record = {}
        for name, buffer in self.buffers.items():
            seen |= buffer.unpack(end.records[name])
        if not tile.some_obstacle:  # rows of padding stay where they are
            repeat_samples = partial(_repeat_samples, times=self._samples)
            seen |= jax.tree.map(repeat_samples, step.record_obstacles(state.obstacles))
        return after, build_sample(worlds, seen)

    def _pack(self, trees: dict[str, Any]) -> dict[str, tuple[PlaneLayout[Any], jax.Array]]:
        """Return layouts and flat arrays of trees of arrays [W, rows, ...] with the same rows."""
        layouts = {name: PlaneLayout.of(tree, 2) for name, tree in trees.items()}
        small = [name for name in trees if fits_kernel(layouts[name])]
        flats = {
            name: layout.pack(trees[name], self.tile.dtype)
            for name, layout in layouts.items()
            if name not in small
        }
        packed = pack_trees(
            self._packing,
            [layouts[name] for name in small],
            [trees[name] for name in small],
            self.tile.dtype,
        )
        flats |= dict(zip(small, packed, strict=True))
        return {name: (layout, flats[name]) for name, layout in layouts.items()}

    def _scratch_layouts(self, output: WorldPhaseOutput | None) -> dict[str, PlaneLayout[Any]]:
        """Layouts of what is made anew in every step."""
        tile = self.tile
        thrusters = tile.shape(self._state.vehicles.thrust.shape[-1])
        shapes = step.scratch_shapes(tile.shape(), thrusters)
        layouts: dict[str, PlaneLayout[Any]] = {
            name: tile.layout(shape, tile.robots) for name, shape in shapes.items()
        }
        if output is not None:
            layouts |= {name: PlaneLayout.of(tree, 2) for name, tree in output.to_slots().items()}
        return layouts

    def _sample_buffer(self, phase: Phase[Any, Any]) -> SampleBuffer[Record] | None:
        """Room for what a phase records, if it records anything."""
        tile, fields = self.tile, record.of_phase(phase.name, self._also)
        if not fields or (phase.of == "obstacle" and not tile.some_obstacle):
            return None
        rows = tile.obstacles if phase.of == "obstacle" else tile.robots
        sizes = {"thruster": self._state.vehicles.thrust.shape[-1]}
        shapes = {
            field.path[0]: jax.ShapeDtypeStruct(
                field.element_shape(sizes), jnp.int32 if field.about.whole else tile.dtype
            )
            for field in fields
        }
        return tile.sample_buffer(tile.layout(shapes, rows), self._samples)


def _allocate_array(size: int, dtype: DTypeLike) -> jax.Array:
    """An array [size] that holds anything."""
    room: jax.Array = jax.lax.empty((size,), dtype)
    return room


def _repeat_samples(values: jax.Array, times: int) -> jax.Array:
    """Arrays [W, ...] as samples [W, times, ...]."""
    return jnp.broadcast_to(values[:, None], (values.shape[0], times, *values.shape[1:]))
