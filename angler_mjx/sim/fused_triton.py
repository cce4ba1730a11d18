"""The fused engine as Pallas kernels, lowered by Triton: a control period in registers.

Four kernels make a control step: controller, physics steps, obstacles, and detection with the
tally. A program works on neighbouring worlds of one robot of the fleet; its state stays in
registers over all physics steps of the control period, and it writes the record itself. Other
shapes are read from memory, so fleets of any size fit. Robots of one vehicle share a program.
"""

from typing import Any

import jax
import jax.numpy as jnp

from angler_mjx.control.stack import Command
from angler_mjx.sim import triton
from angler_mjx.sim.fleet import Fleet
from angler_mjx.sim.fused import FusedEngine
from angler_mjx.sim.segment_layout import Arrays, Segment
from angler_mjx.sim.state import Sample, SimSpec, World, WorldState
from angler_mjx.sim.tile import Tile
from angler_mjx.sim.triton_kernels import Kernels

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
        part = Segment(Tile(fleet, worlds), state, n_sample, steps_per_sample, command)
        end = _fly(Kernels(self._program, spec, part), part)
        cut: tuple[WorldState, Sample] = jax.tree.map(lambda leaf: leaf[:count], part.result(end))
        return cut


def _fly(kernels: Kernels, part: Segment) -> Arrays:
    """The arrays after all steps of a segment."""
    step = kernels.step()

    def some(carry: tuple[jax.Array, Arrays], _: None) -> tuple[Any, None]:
        base, x = carry
        for k in range(UNROLLED):
            x = step(base, k, x)
        return (base + UNROLLED, x), None

    chunks, rest = divmod(part.steps, UNROLLED)
    base, x = jnp.zeros(1, jnp.int32), part.start
    if chunks:
        (base, x), _ = jax.lax.scan(some, (base, x), length=chunks)
    for k in range(rest):
        x = step(base, k, x)
    return x
