"""Where phases run in a kernel: lanes whose constants are loaded when they are asked for."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property, partial
from typing import Any

import jax

from angler_mjx.robot.control import plans
from angler_mjx.robot.control.stack import ControlParams
from angler_mjx.sim.detection import Contact
from angler_mjx.sim.engines.lanes import judge as lane_judge
from angler_mjx.sim.engines.lanes.search import CandidateBody, OtherBodies
from angler_mjx.sim.engines.lanes.steps import Cells, LaneContext
from angler_mjx.sim.engines.triton import launch as triton
from angler_mjx.sim.engines.triton.segment import Segment
from angler_mjx.sim.engines.triton.tile import RobotConstants
from angler_mjx.sim.fleet import VehicleGroup
from angler_mjx.sim.phase import Slots
from angler_mjx.sim.state import SimSpec
from angler_mjx.world.currents import Current


class KernelProgram(LaneContext):
    """Lanes of a program of a kernel: constants are loaded when they are asked for."""

    def __init__(self, spec: SimSpec, part: Segment, data: Any, row: Any, at: Any) -> None:
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
        """See `LaneContext`."""
        return self._tile.current(self._data, self._water)

    @cached_property
    def cells(self) -> Cells:
        """See `LaneContext`."""
        return self._tile.read_cells(self._data, self._water, self._world)

    @cached_property
    def _water(self) -> Any:
        return self._tile.read_water(self._data, self._world)


class KernelBodies(KernelProgram):
    """Obstacles."""

    def load_constants(self) -> None:
        """Load everything now, and not in a loop that needs it."""
        for name in ("obstacles", "current", "cells"):
            getattr(self, name)

    @cached_property
    def obstacles(self) -> Any:
        """See `LaneContext`."""
        body_index = self._tile.body_of(self._row, self._world)
        return self._tile.read_body(self._data, body_index, lambda x: x.obstacle)


class KernelGroup(KernelProgram):
    """Robots of a group."""

    def __init__(
        self,
        spec: SimSpec,
        part: Segment,
        group: VehicleGroup,
        slot_refs: Mapping[str, Any],
        data: Any,
        *,
        row: Any,
        at: Any,
        first: Any,
        count: Any,
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

    def read_slot(self, name: str) -> Any:
        """A slot of these robots."""
        slot_name, layout = self._part.layout(name)
        return layout.read_lanes(triton.make_loader(self._slot_refs[slot_name]), self._lane)

    @cached_property
    def _constants(self) -> RobotConstants:
        return self._tile.read_robot(self._data, self._tile.body_of(self._row, self._world))

    @cached_property
    def params(self) -> ControlParams:
        """See `phase.BatchContext`."""
        loaded = self.read_slot("loaded")[()] if "loaded" in self._slot_refs else None
        return self._tile.params(self._data, self._group, self._constants, loaded)

    @property
    def command(self) -> Any:
        """See `phase.BatchContext`."""
        if "command" in self._slot_refs:
            return self.read_slot("command")
        return plans.check_plan(self.spec.stages, self._constants.path)

    @property
    def goal_m(self) -> Any:
        """See `phase.BatchContext`."""
        return self._constants.goal_m

    @property
    def finished(self) -> Any:
        """See `phase.BatchContext`."""
        return self.read_slot("finished") if "finished" in self._slot_refs else None

    @property
    def last_approach_s(self) -> Any:
        """See `phase.BatchContext`."""
        return self.read_slot("last_approach_s") if "last_approach_s" in self._slot_refs else None

    @property
    def approaching(self) -> Any:
        """See `phase.BatchContext`."""
        return self.read_slot("approaching") if "approaching" in self._slot_refs else None

    @property
    def fails_at_s(self) -> Any:
        """See `phase.BatchContext`."""
        return self._constants.fails_at_s

    def contact(self, now: Slots) -> Contact:
        """See `phase.BatchContext`."""
        tile, slot_refs = self._tile, self._slot_refs
        others = [self._candidate_robots(slot_refs["vehicle"], other) for other in tile.groups]
        return lane_judge.find_contact(
            self.shape,
            lane_judge.hull_of(self.params.vehicle),
            self.cells,
            now["tally"],
            now["vehicle"],
            self._candidate_obstacles(slot_refs["track"]),
            others if tile.robots > 1 else [],
            self._row,
        )

    def _candidate_robots(self, robots: Any, other: VehicleGroup) -> OtherBodies:
        """The robots of a group, as those of the same worlds meet them."""
        tile, data, at = self._tile, self._data, self._at

        def load(i: jax.Array) -> CandidateBody:
            lane = (other.first + i) * tile.worlds + at
            constants_index = tile.body_of(other.first + i, self._world)
            layout = self._part.layouts["vehicle"]
            state = partial(layout.read_lanes, triton.make_loader(robots), lane)

            def details() -> Any:
                q, nu = state(lambda x: (x.q, x.nu))
                hull = lane_judge.hull_of(tile.params_at(data, other, constants_index).vehicle)
                return hull, q, lane_judge.centre_velocity(q, nu)

            reach = tile.params_at(data, other, constants_index).vehicle.radius_m[()]
            return CandidateBody(p=state(lambda x: x.p), reach=reach, details=details)

        return OtherBodies(count=other.count, load=load, first=other.first)

    def _candidate_obstacles(self, track: Any) -> OtherBodies:
        """The obstacles after a control step, as robots of the same worlds meet them."""
        tile, data, at = self._tile, self._data, self._at

        def load(i: jax.Array) -> CandidateBody:
            lane, constants_index = i * tile.worlds + at, tile.body_of(i, self._world)
            drift = partial(
                self._part.track_layout.read_lanes,
                triton.make_loader(track),
                self._part.track_offset(self._count) + lane,
            )

            def details() -> Any:
                return tile.read_body(data, constants_index, lambda x: x.obstacle), *drift(
                    lambda x: (x.q, x.v)
                )

            reach = tile.read_body(data, constants_index, lambda x: x.reach)[()]
            return CandidateBody(p=drift(lambda x: x.p), reach=reach, details=details)

        return OtherBodies(count=tile.obstacles if tile.some_obstacle else 0, load=load)
