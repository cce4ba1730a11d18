"""`search.costs_to_goal` as one GPU program for each robot, which ends when its own costs stand.

Costs are lowered where they are, so that a sweep uses what it has found itself. They only ever
sink, and stand at the same numbers in whatever order cells are looked at: those of `search`, to
the last bit.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from angler_kernels.programs import BlockProgram
from angler_mjx.planning.current.search import FAR, STEPS, most_sweeps

_LANES = 1024
"""Cells that are looked at together."""


def costs_to_goal(cost: jax.Array, goal: jax.Array, *, interpret: bool = False) -> jax.Array:
    """As `search.costs_to_goal`, of one robot.

    Args:
        cost: float16 [26, nx, ny, nz].
        goal: int32 [3].
        interpret: run as ordinary JAX, on any device.

    Returns:
        float32 [nx, ny, nz].
    """
    shape = (cost.shape[1], cost.shape[2], cost.shape[3])
    kernel = _Kernel(shape, BlockProgram.of(min(_LANES, cost[0].size), interpret=interpret))
    value, _ = kernel.program.run(
        kernel,
        [goal.astype(jnp.int32), cost.reshape(-1)],
        [
            jax.ShapeDtypeStruct((cost[0].size,), jnp.float32),
            jax.ShapeDtypeStruct((kernel.total,), jnp.float32),
        ],
    )
    return value.reshape(shape)


@dataclass(frozen=True)
class _Kernel:
    shape: tuple[int, int, int]
    program: BlockProgram

    __name__ = "costs_to_goal"

    @property
    def size(self) -> int:
        """Cells."""
        nx, ny, nz = self.shape
        return nx * ny * nz

    @property
    def total(self) -> int:
        """Cells with one more at both ends of each axis."""
        nx, ny, nz = self.shape
        return (nx + 2) * (ny + 2) * (nz + 2)

    def wide(self, x: Any, y: Any, z: Any) -> Any:
        """Where a cell stands among those with one more at both ends."""
        _, ny, nz = self.shape
        return ((x + 1) * (ny + 2) + y + 1) * (nz + 2) + z + 1

    def __call__(self, goal: Any, cost: Any, value: Any, wide: Any) -> None:
        program = self.program
        lane = jnp.arange(program.lanes, dtype=jnp.int32)
        nowhere = jnp.full((program.lanes,), FAR, jnp.float32)

        def empty(k: Any, unchanged: Any) -> Any:
            at = k * program.lanes + lane
            program.store(wide, at, nowhere, at < self.total)
            return unchanged

        jax.lax.fori_loop(0, -(-self.total // program.lanes), empty, jnp.int32(0))
        program.barrier()
        wide[self.wide(goal[0], goal[1], goal[2])] = jnp.float32(0.0)
        program.barrier()
        parts = -(-self.size // program.lanes)

        def sweep(state: Any) -> Any:
            count, _ = state

            def some(k: Any, sunk: Any) -> Any:
                # One way and back again, so that what is found is carried along.
                part = jnp.where(count % 2 == 0, k, parts - 1 - k)
                cell, at, real = self._cells(part, lane)
                before = program.load(wide, at, real, FAR)
                least = before
                for number, step in enumerate(STEPS.tolist()):
                    of_step = program.load(cost, number * self.size + cell, real, jnp.inf)
                    beside = program.load(wide, at + self._offset(step), real, FAR)
                    least = jnp.minimum(least, of_step.astype(jnp.float32) + beside)
                program.store(wide, at, least, real)
                return sunk | (least < before).astype(jnp.int32)

            sunk = jax.lax.fori_loop(0, parts, some, 0 * lane)
            program.barrier()
            return count + 1, jnp.max(sunk)

        def going(state: Any) -> Any:
            return (state[1] > 0) & (state[0] < most_sweeps(self.shape))

        jax.lax.while_loop(going, sweep, (jnp.int32(0), jnp.int32(1)))

        def give(k: Any, unchanged: Any) -> Any:
            cell, at, real = self._cells(k, lane)
            program.store(value, cell, program.load(wide, at, real, FAR), real)
            return unchanged

        jax.lax.fori_loop(0, parts, give, jnp.int32(0))

    def _cells(self, part: Any, lane: Any) -> tuple[Any, Any, Any]:
        """Cells of a part, where they stand among those with ends, and whether there are so many.

        Those beyond the last are the last.
        """
        _, ny, nz = self.shape
        cell = part * self.program.lanes + lane
        real = cell < self.size
        cell = jnp.minimum(cell, self.size - 1)
        return cell, self.wide(cell // (ny * nz), cell // nz % ny, cell % nz), real

    def _offset(self, step: list[int]) -> int:
        return int(self.wide(*step)) - int(self.wide(0, 0, 0))
