"""The fused engine as Pallas kernels, lowered by Triton: a control period in registers.

Four kernels make a control step: controller, physics steps, obstacles, and detection with the
tally. A program works on neighbouring worlds of one robot of the fleet; its state stays in
registers over all physics steps of the control period, and it writes the record itself. Other
shapes are read from memory, so fleets of any size fit. Robots of one vehicle share a program.
Instruments and navigation filters, where robots have any, are plain JAX between the kernels.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from angler_kernels.lanes.planes import Layout
from angler_mjx.control.stack import Command
from angler_mjx.engines.lanes.engine import FusedEngine
from angler_mjx.engines.triton import launch as triton
from angler_mjx.engines.triton.kernels import Kernels, Launch
from angler_mjx.engines.triton.segment import AHEAD, Arrays, Segment
from angler_mjx.engines.triton.tile import Tile
from angler_mjx.physics.step import VehicleState
from angler_mjx.sim import senses
from angler_mjx.sim.fleet import Fleet
from angler_mjx.sim.state import Belief, Sample, SimSpec, World, WorldState

UNROLLED = 10
"""Control steps in the body of the loop, whose bookkeeping costs launches; `AHEAD` divides it."""

LANES = 32
"""Lanes of one program: one warp, so that a program skips what none of its lanes needs."""


class TritonEngine:
    """Closed-form rigid bodies in Pallas kernels."""

    def __init__(self, *, lanes: int = LANES, warps: int = 1, interpret: bool = False) -> None:
        """Choose the shape of a program.

        Args:
            lanes: robots in one program, a power of two.
            warps: warps in one program.
            interpret: run the kernels as ordinary JAX, on any device.
        """
        self._program = triton.Program(lanes=lanes, warps=warps, interpret=interpret)

    def reset(self, spec: SimSpec, fleet: Fleet, worlds: World) -> WorldState:
        """See `Engine.reset`."""
        return FusedEngine().reset(spec, fleet, worlds)

    def control_step(
        self,
        spec: SimSpec,
        fleet: Fleet,
        worlds: World,
        state: WorldState,
        command: Command | None,
    ) -> tuple[WorldState, Sample]:
        """See `Engine.control_step`."""
        after, sample = self._segment(spec, fleet, worlds, state, 1, 1, command)
        return after, jax.tree.map(lambda leaf: leaf[:, 0], sample)

    def segment(
        self,
        spec: SimSpec,
        fleet: Fleet,
        worlds: World,
        state: WorldState,
        *,
        n_sample: int,
        steps_per_sample: int,
        command: Command | None = None,
    ) -> tuple[WorldState, Sample]:
        """See `Engine.segment`."""
        count = {"n_sample": n_sample, "steps_per_sample": steps_per_sample}

        def plain(
            fleet: Fleet, worlds: World, state: WorldState, command: Command | None
        ) -> tuple[WorldState, Sample]:
            return FusedEngine().segment(spec, fleet, worlds, state, command=command, **count)

        def fast(
            fleet: Fleet, worlds: World, state: WorldState, command: Command | None
        ) -> tuple[WorldState, Sample]:
            return self._segment(spec, fleet, worlds, state, n_sample, steps_per_sample, command)

        both = triton.with_gradient_of(plain, fast)
        after: tuple[WorldState, Sample] = both(fleet, worlds, state, command)
        return after

    def _segment(
        self,
        spec: SimSpec,
        fleet: Fleet,
        worlds: World,
        state: WorldState,
        n_sample: int,
        steps_per_sample: int,
        command: Command | None,
    ) -> tuple[WorldState, Sample]:
        """Whole programs: the last world is repeated until they are full, and cut off again."""
        count = state.step.shape[0]
        extra = -count % self._program.lanes

        def fill(leaf: jax.Array) -> jax.Array:
            return jnp.concatenate([leaf, jnp.repeat(leaf[-1:], extra, axis=0)]) if extra else leaf

        worlds, state, command = jax.tree.map(fill, (worlds, state, command))
        sense, belief = partial(senses.step_tile, spec, worlds), None
        if spec.crews:
            _, belief = jax.eval_shape(sense, state.senses, state.step[0], state.vehicles)
        tile = Tile(fleet, worlds)
        part = Segment(tile, state, n_sample, steps_per_sample, command, belief)
        kernels = Kernels(self._program, spec, part)
        if part.known is not None:
            end = _fly_looped(kernels, part, partial(_look, sense, part, part.known))
        elif self._program.interpret:
            end = _fly_looped(kernels, part, None)
        else:
            end = _fly(kernels, part)
        cut: tuple[WorldState, Sample] = jax.tree.map(lambda leaf: leaf[:count], part.result(end))
        return cut


def _look(
    sense: Callable[[Any, jax.Array, VehicleState], tuple[Any, Belief]],
    part: Segment,
    layout: Layout,
    base: jax.Array,
    k: jax.Array,
    x: Arrays,
) -> Arrays:
    """What the controllers are told in control step ``base + k``, and its record: no kernel."""
    tile, count = part.tile, base[0] + k[0]
    vehicles = part.vehicle.unpack(x.robots, (tile.worlds, tile.robots))
    sensed, belief = sense(x.senses, part.first[0] + count, vehicles)
    place, is_sample = count // part.every, count % part.every == 0

    def record(kept: jax.Array, new: jax.Array) -> jax.Array:
        return kept.at[place].set(jnp.where(is_sample, new, kept[place]))

    return replace(
        x,
        senses=sensed,
        known=layout.pack(belief, tile.dtype),
        believed=jax.tree.map(record, x.believed, belief),
    )


def _fly(kernels: Kernels, part: Segment) -> Arrays:
    """The arrays after all steps of a segment."""
    obstacles, robots = kernels.launches()

    def steps(base: jax.Array, count: int, x: Arrays) -> Arrays:
        for k in range(count):
            at = jnp.array([k], jnp.int32)
            if k % AHEAD == 0:
                x = obstacles(base, at, x)
            x = robots(base, at, x)
        return x

    return _chunks(steps, UNROLLED, part)


def _fly_looped(kernels: Kernels, part: Segment, look: Launch | None) -> Arrays:
    """As `_fly`, with ``look`` before the robots act, and the long body once in the program."""
    obstacles, robots = kernels.launches()

    def steps(base: jax.Array, count: int, x: Arrays) -> Arrays:
        def one(x: Arrays, k: jax.Array) -> tuple[Arrays, None]:
            seen = x if look is None else look(base, k[None], x)
            return robots(base, k[None], seen), None

        x = obstacles(base, jnp.zeros(1, jnp.int32), x)
        return jax.lax.scan(one, x, jnp.arange(count, dtype=jnp.int32))[0]

    return _chunks(steps, AHEAD, part)


def _chunks(steps: Callable[[jax.Array, int, Arrays], Arrays], size: int, part: Segment) -> Arrays:
    """All control steps of a segment: of a base int32 [1], a number of them, and the arrays."""

    def some(carry: tuple[jax.Array, Arrays], _: None) -> tuple[Any, None]:
        base, x = carry
        x = steps(base, size, x)
        return (base + size, x), None

    chunks, rest = divmod(part.steps, size)
    base, x = jnp.zeros(1, jnp.int32), part.start
    if chunks:
        (base, x), _ = jax.lax.scan(some, (base, x), length=chunks)
    return steps(base, rest, x) if rest else x
