"""Where everything that changes in a segment lies for the kernels: states, scratch and records."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from angler_kernels.lanes.planes import PlaneLayout, Shelf
from angler_mjx.robot.control.stack import Command
from angler_mjx.sim import record, step
from angler_mjx.sim.engines.triton.tile import Tile
from angler_mjx.sim.phase import Phase
from angler_mjx.sim.record import Sample
from angler_mjx.sim.state import SimSpec, WorldState
from angler_mjx.sim.step import ALONE, KEPT, MEETING, OBSTACLES
from angler_mjx.sim.world_phases.running import WorldMemory, WorldPhaseOutput

AHEAD = 5
"""Control steps that obstacles are moved ahead of the robots, where no policy watches them."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Drift:
    """Where an obstacle is after a control step: what detection wants to know."""

    p: Any
    q: Any
    v: Any


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Arrays:
    """Flat arrays that change from launch to launch."""

    slots: dict[str, jax.Array]
    """What the phases of robots read and give, by name; see `angler_mjx.sim.step.Slots`. Also
    what `WorldPhaseOutput.given` gives, and ``command`` where one drives them."""
    bodies: jax.Array
    """`ObstacleState`, as far ahead as they were moved."""
    track: jax.Array
    """`Drift` of as many steps as obstacles are moved ahead."""
    records: dict[str, jax.Array]
    """What each phase of robots and obstacles recorded, by the phase's name."""
    minds: WorldMemory
    """[W] leads: what robots know of themselves is not the kernels' work."""
    told: dict[str, Any]
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
        told: WorldPhaseOutput | None,
        *,
        ahead: int = AHEAD,
        also: tuple[str, ...] = (),
        last_approach_s: jax.Array | None = None,
    ) -> None:
        """Lay everything out.

        Args:
            tile: constants of the worlds.
            state: of the worlds.
            n_sample: samples of each.
            every: control steps from one sample to the next.
            command: what drives the controllers instead of the paths; if anything does.
            told: shapes of what the phases of worlds give; if they give anything.
            ahead: control steps that obstacles are moved ahead of the robots.
            also: what is recorded because it is asked for.
            last_approach_s: [W, R], of `last_approaches_s`; None where no plans are flown.
        """
        self._also = also
        self.ahead = ahead
        self.tile, self._state = tile, state
        self._samples, self.every, self.steps = n_sample, every, n_sample * every
        self.first = state.step if tile.some_rows else state.step[:1]
        given = {"vehicle": state.vehicles, "memory": state.carry, "tally": state.tally}
        if command is not None:
            given["command"] = command
        if last_approach_s is not None:
            given["last_approach_s"] = last_approach_s
        packed = {name: tile.pack(tree, 2) for name, tree in given.items()}
        self.bodies, bodies = tile.pack(state.obstacles, 2)
        self.layouts = {name: layout for name, (layout, _) in packed.items()}
        self.layouts |= self._scratch(told)
        three, four = tile.shape(3), tile.shape(4)
        self.drift = tile.layout(Drift(p=three, q=four, v=three), tile.obstacles)
        self.shelves = {
            phase.name: shelf
            for phase in (*ALONE, OBSTACLES, *MEETING)
            if (shelf := self._shelf(phase)) is not None
        }
        # Written before it is read: it need not be filled.
        room = partial(_room, dtype=tile.dtype)
        self.start = Arrays(
            slots={
                name: packed[name][1] if name in packed else room(layout.size)
                for name, layout in self.layouts.items()
            },
            bodies=bodies,
            track=room(ahead * self.drift.size if tile.some_obstacle else 1),
            records={name: room(shelf.size) for name, shelf in self.shelves.items()},
            minds=WorldMemory.of(state),
            told={}
            if told is None
            else jax.tree.map(
                lambda leaf: jnp.zeros((n_sample, *leaf.shape), leaf.dtype), told.record
            ),
        )

    def layout(self, slot: str) -> tuple[str, PlaneLayout]:
        """The slot that one is read from, and its layout: what is known may be the truth."""
        name = "vehicle" if slot == "known" and slot not in self.layouts else slot
        return name, self.layouts[name]

    def taken(self, first: Any, at: Any) -> Any:
        """Control steps that worlds number ``at`` took before, of `first` in a kernel."""
        return first[at] if self.tile.some_rows else first[0]

    def time(self, count: Any, spec: SimSpec) -> jax.Array:
        """[] s when so many control steps were taken."""
        t: jax.Array = count.astype(self.tile.dtype) * spec.control_dt_s
        return t

    def ring(self, count: Any) -> Any:
        """Where in the track a control step begins, counted from the segment's first."""
        return count % self.ahead * self.drift.size

    def result(self, end: Arrays) -> tuple[WorldState, Sample]:
        """The state after all steps, and the samples."""
        tile, state = self.tile, self._state
        of_robot, of_body = (tile.worlds, tile.robots), (tile.worlds, tile.obstacles)
        kept = {name: self.layouts[name].unpack(end.slots[name], of_robot) for name in KEPT}
        after = WorldState(
            vehicles=kept["vehicle"],
            carry=kept["memory"],
            obstacles=self.bodies.unpack(end.bodies, of_body),
            tally=kept["tally"],
            step=state.step + self.steps,
            **vars(end.minds),
        )
        seen = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, 1), end.told)
        for name, shelf in self.shelves.items():
            seen |= shelf.unpack(end.records[name])
        if not tile.some_obstacle:  # rows of padding stay where they are
            repeated = partial(_repeated, times=self._samples)
            seen |= jax.tree.map(repeated, step.record_obstacles(state.obstacles))
        return after, Sample(**seen)

    def _scratch(self, told: WorldPhaseOutput | None) -> dict[str, PlaneLayout]:
        """Layouts of what is made anew in every step."""
        tile = self.tile
        thrusters = tile.shape(self._state.vehicles.thrust.shape[-1])
        shapes = step.handed_on(tile.shape(), thrusters)
        found = {name: tile.layout(shape, tile.robots) for name, shape in shapes.items()}
        if told is not None:
            found |= {name: PlaneLayout.of(tree, 2) for name, tree in told.given().items()}
        return found

    def _shelf(self, phase: Phase) -> Shelf | None:
        """Room for what a phase records, if it records anything."""
        tile, fields = self.tile, record.of_phase(phase.name, self._also)
        if not fields or (phase.of == "obstacle" and not tile.some_obstacle):
            return None
        rows = tile.obstacles if phase.of == "obstacle" else tile.robots
        sizes = {"thruster": self._state.vehicles.thrust.shape[-1]}
        shapes = {
            field.path[0]: jax.ShapeDtypeStruct(
                field.of_one(sizes), jnp.int32 if field.about.whole else tile.dtype
            )
            for field in fields
        }
        return tile.shelf(tile.layout(shapes, rows), self._samples)


def _room(size: int, dtype: Any) -> jax.Array:
    """An array [size] that holds anything."""
    room: jax.Array = jax.lax.empty((size,), dtype)
    return room


def _repeated(values: jax.Array, times: int) -> jax.Array:
    """Arrays [W, ...] as samples [W, times, ...]."""
    return jnp.broadcast_to(values[:, None], (values.shape[0], times, *values.shape[1:]))
