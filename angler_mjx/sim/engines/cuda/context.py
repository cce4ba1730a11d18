"""Where phases run in a kernel: lanes whose constants are loaded when they are asked for."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import jax

from angler_mjx.robot.control import plans
from angler_mjx.robot.control.mixed import MixedCommand
from angler_mjx.robot.control.plans import Plan
from angler_mjx.robot.control.stack import Command, ControlParams
from angler_mjx.sim import step
from angler_mjx.sim.detection import Contact
from angler_mjx.sim.engines.cuda import launch
from angler_mjx.sim.engines.cuda.segment import Segment
from angler_mjx.sim.engines.cuda.tile import Refs, RobotConstants, WorldConstants
from angler_mjx.sim.engines.lanes import judge as lane_judge
from angler_mjx.sim.engines.lanes.search import CandidateBody, OtherBodies, search_lanes
from angler_mjx.sim.engines.lanes.steps import Cells, LaneBatch, Lanes
from angler_mjx.sim.fleet import VehicleGroup
from angler_mjx.sim.phase import Phase
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.record import Belief
from angler_mjx.sim.state import SimSpec, Tally
from angler_mjx.world.currents import Current
from angler_mjx.world.obstacles import Obstacles

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


class KernelProgram(LaneBatch):
    """Lanes of a program of a kernel: constants are loaded when they are asked for."""

    def __init__(
        self, spec: SimSpec, part: Segment, data: Refs, row: jax.Array, at: jax.Array
    ) -> None:
        """Nothing is loaded yet but whose constants these are.

        Args:
            spec: settings.
            part: where things lie.
            data: references to the constants of the tile.
            row: which bodies of their worlds they are.
            at: numbers of their worlds.
        """
        self._part, self._data, self._row, self._at = part, data, row, at
        self._tile = part.tile
        self._lane = row * part.tile.worlds + at
        self._world = part.tile.world_index(data, at)
        self.spec, self.shape = spec, part.tile.grid

    @contextmanager
    def discard_loads(self) -> Iterator[None]:
        """What is loaded under a condition is not there behind it."""
        before = dict(vars(self))
        yield
        vars(self).clear()
        vars(self).update(before)

    @cached_property
    def current(self) -> Current:
        """See `LaneBatch`."""
        return self._tile.current(self._data, self._water)

    @cached_property
    def cells(self) -> Cells:
        """See `LaneBatch`."""
        return self._tile.read_cells(self._data, self._water, self._world)

    @cached_property
    def _water(self) -> WorldConstants:
        return self._tile.read_water(self._data, self._world)


class KernelBodies(KernelProgram):
    """Obstacles."""

    def load_constants(self) -> None:
        """Load everything now, and not in a loop that needs it."""
        for name in ("obstacles", "current", "cells"):
            getattr(self, name)

    @cached_property
    def obstacles(self) -> Obstacles:
        """See `LaneBatch`."""
        body_index = self._tile.body_of(self._row, self._world)
        return self._tile.read_body(self._data, body_index, lambda x: x.obstacle)


class KernelGroup(KernelProgram):
    """Robots of a group."""

    def __init__(
        self,
        spec: SimSpec,
        part: Segment,
        group: VehicleGroup,
        slot_refs: Mapping[str, jax.Ref],
        data: Refs,
        *,
        row: jax.Array,
        at: jax.Array,
        first: jax.Array,
        count: jax.Array,
    ) -> None:
        """As `KernelProgram`.

        Args:
            spec: settings.
            part: where things lie.
            group: of the fleet.
            slot_refs: references to the slots, by name.
            data: references to the constants of the tile.
            row: which robots of their worlds they are.
            at: numbers of their worlds.
            first: control steps taken before the segment, by all or by each lane's world.
            count: and in it.
        """
        super().__init__(spec, part, data, row, at)
        self._group, self._slot_refs, self._count = group, slot_refs, count
        self.t = part.elapsed_s(first + count, spec)

    def read_input[Input: "DataclassInstance"](self, phase: Phase[Input, Any]) -> Input:
        """Read the input of a phase, field by field."""
        inputs: dict[str, object] = {}
        for entry in fields(phase.takes):
            has_slot = self._part.has_slot(entry.name)
            read = self.read_slot if has_slot else partial(self._read_constant, inputs)
            inputs[entry.name] = read(entry.name)
        return phase.takes(**inputs)

    def _read_constant(self, inputs: Mapping[str, object], name: str) -> object:
        """Return a field of the input of a phase that is no slot of its own."""
        match name, inputs:
            case "flow", {"estimate": VehicleState() | Belief() as estimate}:
                return step.select_flow(self, lambda: self.current, estimate)
            case "contact", {"tally": Tally() as tally, "vehicle": VehicleState() as vehicle}:
                return self._find_contact(tally, vehicle)
        return getattr(self, name)

    def read_slot(self, name: str) -> Any:
        """Return a slot of these robots."""
        slot_name, layout = self._part.layout(name)
        return layout.read_lanes(launch.make_loader(self._slot_refs[slot_name]), self._lane)

    @cached_property
    def _constants(self) -> RobotConstants:
        return self._tile.read_robot(self._data, self._tile.body_of(self._row, self._world))

    def _read_optional(self, name: str) -> jax.Array | None:
        return self.read_slot(name) if name in self._slot_refs else None

    @cached_property
    def params(self) -> ControlParams:
        """See `step.DecideInput`."""
        loaded = self.read_slot("loaded")[()] if "loaded" in self._slot_refs else None
        return self._tile.params(self._data, self._group, self._constants, loaded)

    @property
    def command(self) -> Plan | Command | MixedCommand:
        """See `step.DecideInput`."""
        if "command" in self._slot_refs:
            command: Command | MixedCommand = self.read_slot("command")
            return command
        return plans.check_plan(self.spec.stages, self._constants.path)

    joints = grip = reaching = impacts = None
    """See `step.DecideInput`, `step.MoveInput`, `step.JudgeInput`: kernels fly rigid vehicles."""

    @property
    def actuators(self) -> jax.Array | None:
        """See `step.DecideInput`."""
        if self.params.vehicle.trim is None:
            return None
        vehicle: VehicleState = self.read_slot("vehicle")
        return step.select_actuators(self.params, vehicle)

    @property
    def goal_m(self) -> jax.Array:
        """See `step.JudgeInput`."""
        return self._constants.goal_m

    @property
    def finished(self) -> jax.Array | None:
        """See `step.JudgeInput`."""
        return self._read_optional("finished")

    @property
    def approach(self) -> step.PlanApproach | jax.Array | None:
        """See `step.JudgeInput`."""
        if "last_approach_s" not in self._slot_refs:
            return self._read_optional("approaching")
        return step.PlanApproach(plan=self.command, begin_s=self.read_slot("last_approach_s"))

    @property
    def fails_at_s(self) -> jax.Array | None:
        """See `step.JudgeInput`."""
        return self._constants.fails_at_s

    @property
    def corners(self) -> tuple[jax.Array, jax.Array]:
        """See `step.JudgeInput`."""
        return self.cells.lo, self.cells.hi

    def _find_contact(self, tally: Tally, vehicle: VehicleState) -> Contact:
        """Return the nearest thing to each robot, among all that have moved."""
        tile, slot_refs = self._tile, self._slot_refs
        others = [self._candidate_robots(slot_refs["vehicle"], other) for other in tile.groups]
        return lane_judge.find_contact(
            self.shape,
            lane_judge.hull_of(self.params.vehicle),
            self.cells,
            tally,
            vehicle,
            self._candidate_obstacles(slot_refs["track"]),
            others if tile.robots > 1 else [],
            self._row,
            search_lanes,
        )

    def _candidate_robots(
        self, robots: jax.Ref, other: VehicleGroup
    ) -> OtherBodies[jax.Array, lane_judge.LaneHull]:
        """The robots of a group, as those of the same worlds meet them."""
        tile, data, at = self._tile, self._data, self._at

        def load(i: jax.Array) -> CandidateBody[lane_judge.LaneHull]:
            lane = (other.first + i) * tile.worlds + at
            constants_index = tile.body_of(other.first + i, self._world)
            layout = self._part.layouts["vehicle"]
            state = partial(layout.read_part, launch.make_loader(robots), lane)

            def details() -> tuple[lane_judge.LaneHull, Lanes, Lanes]:
                q, nu = state(lambda x: (x.q, x.nu))
                hull = lane_judge.hull_of(tile.params_at(data, other, constants_index).vehicle)
                return hull, q, lane_judge.centre_velocity(q, nu)

            reach = tile.params_at(data, other, constants_index).vehicle.radius_m[()]
            return CandidateBody(p=state(lambda x: x.p), reach=reach, details=details)

        return OtherBodies(count=other.count, load=load, first=other.first)

    def _candidate_obstacles(self, track: jax.Ref) -> OtherBodies[jax.Array, Obstacles]:
        """The obstacles after a control step, as robots of the same worlds meet them."""
        tile, data, at = self._tile, self._data, self._at

        def load(i: jax.Array) -> CandidateBody[Obstacles]:
            lane, constants_index = i * tile.worlds + at, tile.body_of(i, self._world)
            drift = partial(
                self._part.track_layout.read_part,
                launch.make_loader(track),
                self._part.track_offset(self._count) + lane,
            )

            def details() -> tuple[Obstacles, Lanes, Lanes]:
                return tile.read_body(data, constants_index, lambda x: x.obstacle), *drift(
                    lambda x: (x.q, x.v)
                )

            reach = tile.read_body(data, constants_index, lambda x: x.reach)[()]
            return CandidateBody(p=drift(lambda x: x.p), reach=reach, details=details)

        return OtherBodies(count=tile.obstacles if tile.some_obstacle else 0, load=load)
