"""Where everything that changes in a segment lies for the kernels: states, scratch and records."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from angler_kernels.lanes.planes import Layout
from angler_mjx.control.stack import Command
from angler_mjx.engines.triton.tile import Tile
from angler_mjx.sim.state import Belief, Sample, Senses, WorldState

AHEAD = 5
"""Control steps that obstacles are moved ahead of the robots."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Order:
    """What the controller hands to the physics and the tally."""

    thrust_n: Any
    power_w: Any


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Deed:
    """What the physics hands to the tally."""

    before_m: Any
    broken: Any


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class ControlSample:
    """The controller's part of a `Sample`."""

    pwm_us: Any
    target_m: Any


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class MotionSample:
    """The physics' part of a `Sample`."""

    p: Any
    q: Any
    nu: Any
    current_mps: Any
    outcome: Any


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class ObstacleSample:
    """The obstacles' part of a `Sample`."""

    obstacle_p: Any
    obstacle_q: Any


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

    robots: jax.Array
    """`VehicleState`."""
    memory: jax.Array
    """The controllers'."""
    tally: jax.Array
    order: jax.Array
    deed: jax.Array
    said: jax.Array
    """Record of the controllers."""
    moved: jax.Array
    """Record of the motion."""
    bodies: jax.Array
    """`ObstacleState`, as far ahead as they were moved."""
    track: jax.Array
    """`Drift` of `AHEAD` steps."""
    seen: jax.Array
    """Record of the obstacles."""
    senses: tuple[Senses | None, ...]
    """As in `WorldState`, [W] leads: what robots know of themselves is not the kernels' work."""
    known: jax.Array | None
    """`Belief`, for the controllers; None where they are told the truth."""
    believed: Belief | None
    """Record of it, [samples, W, R, ...]."""


class Segment:
    """Control steps of one tile, with a sample of the first of every ``every``.

    Attributes:
        tile: constants of the worlds.
        steps: how many control steps.
        every: control steps from one sample to the next.
        first: int32 [1] control steps taken before.
        start: arrays at the beginning.
        vehicle, memory, tally, bodies, order, deed, drift: layouts of their parts.
        command: what drives the controllers instead of the paths, and its layout; if there is.
        said, moved, seen: shelves of the samples.
        known: layout of what the controllers are told, from shapes of it; if it is not the truth.
    """

    def __init__(
        self,
        tile: Tile,
        state: WorldState,
        n_sample: int,
        every: int,
        command: Command | None,
        belief: Belief | None,
    ) -> None:
        self.tile, self._state = tile, state
        self._samples, self.every, self.steps = n_sample, every, n_sample * every
        self.first = state.step[:1]
        self.vehicle, robots = tile.pack(state.vehicles, 2)
        self.memory, memory = tile.pack(state.carry, 2)
        self.tally, tally = tile.pack(state.tally, 2)
        self.bodies, bodies = tile.pack(state.obstacles, 2)
        self.command = [] if command is None else [tile.pack(command, 2)]
        number, three, four = tile.shape(), tile.shape(3), tile.shape(4)
        each = tile.shape(state.vehicles.thrust.shape[-1])
        broken = jax.ShapeDtypeStruct((), jnp.bool_)
        self.order = tile.layout(Order(thrust_n=each, power_w=number), tile.robots)
        self.deed = tile.layout(Deed(before_m=three, broken=broken), tile.robots)
        self.drift = tile.layout(Drift(p=three, q=four, v=three), tile.obstacles)
        motion = MotionSample(
            p=three,
            q=four,
            nu=tile.shape(6),
            current_mps=three,
            outcome=jax.ShapeDtypeStruct((), jnp.int32),
        )
        control = ControlSample(pwm_us=each, target_m=three)
        obstacle = ObstacleSample(obstacle_p=three, obstacle_q=four)
        self.said = tile.shelf(tile.layout(control, tile.robots), n_sample)
        self.moved = tile.shelf(tile.layout(motion, tile.robots), n_sample)
        self.seen = tile.shelf(tile.layout(obstacle, tile.obstacles), n_sample)
        self.known = None if belief is None else Layout.of(belief, 2)
        # Written before it is read: it need not be filled.
        room = partial(_room, dtype=tile.dtype)
        self.start = Arrays(
            robots=robots,
            memory=memory,
            tally=tally,
            order=room(self.order.size),
            deed=room(self.deed.size),
            said=room(self.said.size),
            moved=room(self.moved.size),
            bodies=bodies,
            track=room(AHEAD * self.drift.size if tile.some_obstacle else 1),
            seen=room(self.seen.size if tile.some_obstacle else 1),
            senses=state.senses,
            known=None if self.known is None else room(self.known.size),
            believed=jax.tree.map(
                lambda leaf: jnp.zeros((n_sample, *leaf.shape), leaf.dtype), belief
            ),
        )

    def result(self, end: Arrays) -> tuple[WorldState, Sample]:
        """The state after all steps, and the samples."""
        tile, state = self.tile, self._state
        of_robot, of_body = (tile.worlds, tile.robots), (tile.worlds, tile.obstacles)
        if tile.some_obstacle:
            seen = self.seen.unpack(end.seen)
        else:  # rows of padding stay where they are
            seen = ObstacleSample(
                obstacle_p=_repeated(state.obstacles.p, self._samples),
                obstacle_q=_repeated(state.obstacles.q, self._samples),
            )
        after = WorldState(
            vehicles=self.vehicle.unpack(end.robots, of_robot),
            carry=self.memory.unpack(end.memory, of_robot),
            obstacles=self.bodies.unpack(end.bodies, of_body),
            tally=self.tally.unpack(end.tally, of_robot),
            step=state.step + self.steps,
            senses=end.senses,
        )
        said, moved = self.said.unpack(end.said), self.moved.unpack(end.moved)
        belief = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, 1), end.believed)
        return after, Sample(**vars(said), **vars(moved), **vars(seen), belief=belief)


def _room(size: int, dtype: Any) -> jax.Array:
    """An array [size] that holds anything."""
    room: jax.Array = jax.lax.empty((size,), dtype)
    return room


def _repeated(values: jax.Array, times: int) -> jax.Array:
    """Arrays [W, ...] as samples [W, times, ...]."""
    return jnp.broadcast_to(values[:, None], (values.shape[0], times, *values.shape[1:]))
