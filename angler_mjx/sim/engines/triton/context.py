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
from angler_mjx.sim.engines.lanes.search import Met, OtherBodies
from angler_mjx.sim.engines.lanes.steps import Cells, OnLanes
from angler_mjx.sim.engines.triton import launch as triton
from angler_mjx.sim.engines.triton.segment import Segment
from angler_mjx.sim.engines.triton.tile import RobotConstants
from angler_mjx.sim.fleet import VehicleGroup
from angler_mjx.sim.phase import Slots
from angler_mjx.sim.state import SimSpec
from angler_mjx.world.currents import Current


class KernelProgram(OnLanes):
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
        self._world = part.tile.world(data, at)
        self.spec, self.shape = spec, part.tile.grid

    @contextmanager
    def forgetting(self) -> Iterator[None]:
        """What is loaded under a condition is not there behind it."""
        before = dict(vars(self))
        yield
        vars(self).clear()
        vars(self).update(before)

    @cached_property
    def current(self) -> Current:
        """See `OnLanes`."""
        return self._tile.current(self._data, self._water)

    @cached_property
    def cells(self) -> Cells:
        """See `OnLanes`."""
        return self._tile.ground(self._data, self._water, self._world)

    @cached_property
    def _water(self) -> Any:
        return self._tile.water(self._data, self._world)


class KernelBodies(KernelProgram):
    """Obstacles."""

    def load(self) -> None:
        """Load everything now, and not in a loop that needs it."""
        for name in ("obstacles", "current", "cells"):
            getattr(self, name)

    @cached_property
    def obstacles(self) -> Any:
        """See `OnLanes`."""
        place = self._tile.body_of(self._row, self._world)
        return self._tile.body(self._data, place, lambda x: x.given)


class KernelGroup(KernelProgram):
    """Robots of a group."""

    def __init__(
        self,
        spec: SimSpec,
        part: Segment,
        group: VehicleGroup,
        places: Mapping[str, Any],
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
            places: references to the slots, by name.
            data: references to the constants of the tile.
            row: which robots of their worlds they are.
            at: numbers of their worlds.
            first: control steps taken before the segment, by all or by each lane's world.
            count: and in it.
        """
        super().__init__(spec, part, data, row, at)
        self._group, self._places, self._count = group, places, count
        self.t = part.time(first + count, spec)

    def slot(self, name: str) -> Any:
        """A slot of these robots."""
        place, layout = self._part.layout(name)
        return layout.read(triton.loader(self._places[place]), self._lane)

    @cached_property
    def _constants(self) -> RobotConstants:
        return self._tile.robot(self._data, self._tile.body_of(self._row, self._world))

    @cached_property
    def params(self) -> ControlParams:
        """See `phase.BatchContext`."""
        loaded = self.slot("loaded")[()] if "loaded" in self._places else None
        return self._tile.params(self._data, self._group, self._constants, loaded)

    @property
    def command(self) -> Any:
        """See `phase.BatchContext`."""
        if "command" in self._places:
            return self.slot("command")
        return plans.checked(self.spec.stages, self._constants.path)

    @property
    def goal_m(self) -> Any:
        """See `phase.BatchContext`."""
        return self._constants.goal_m

    @property
    def finished(self) -> Any:
        """See `phase.BatchContext`."""
        return self.slot("finished") if "finished" in self._places else None

    @property
    def last_approach_s(self) -> Any:
        """See `phase.BatchContext`."""
        return self.slot("last_approach_s") if "last_approach_s" in self._places else None

    @property
    def approaching(self) -> Any:
        """See `phase.BatchContext`."""
        return self.slot("approaching") if "approaching" in self._places else None

    @property
    def fails_at_s(self) -> Any:
        """See `phase.BatchContext`."""
        return self._constants.fails_at_s

    def contact(self, now: Slots) -> Contact:
        """See `phase.BatchContext`."""
        tile, places = self._tile, self._places
        others = [self._robots_met(places["vehicle"], other) for other in tile.groups]
        return lane_judge.contact(
            self.shape,
            lane_judge.hull_of(self.params.vehicle),
            self.cells,
            now["tally"],
            now["vehicle"],
            self._obstacles_met(places["track"]),
            others if tile.robots > 1 else [],
            self._row,
        )

    def _robots_met(self, robots: Any, other: VehicleGroup) -> OtherBodies:
        """The robots of a group, as those of the same worlds meet them."""
        tile, data, at = self._tile, self._data, self._at

        def load(i: jax.Array) -> Met:
            place = (other.first + i) * tile.worlds + at
            mine = tile.body_of(other.first + i, self._world)
            layout = self._part.layouts["vehicle"]
            state = partial(layout.read, triton.loader(robots), place)

            def details() -> Any:
                q, nu = state(lambda x: (x.q, x.nu))
                hull = lane_judge.hull_of(tile.params_at(data, other, mine).vehicle)
                return hull, q, lane_judge.velocity(q, nu)

            reach = tile.params_at(data, other, mine).vehicle.radius_m[()]
            return Met(p=state(lambda x: x.p), reach=reach, details=details)

        return OtherBodies(count=other.count, load=load, first=other.first)

    def _obstacles_met(self, track: Any) -> OtherBodies:
        """The obstacles after a control step, as robots of the same worlds meet them."""
        tile, data, at = self._tile, self._data, self._at

        def load(i: jax.Array) -> Met:
            place, mine = i * tile.worlds + at, tile.body_of(i, self._world)
            drift = partial(
                self._part.drift.read, triton.loader(track), self._part.ring(self._count) + place
            )

            def details() -> Any:
                return tile.body(data, mine, lambda x: x.given), *drift(lambda x: (x.q, x.v))

            reach = tile.body(data, mine, lambda x: x.reach)[()]
            return Met(p=drift(lambda x: x.p), reach=reach, details=details)

        return OtherBodies(count=tile.obstacles if tile.some_obstacle else 0, load=load)
