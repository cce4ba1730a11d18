"""`search.costs_to_goal` as one GPU program for each robot, which ends when its costs converge.

Costs are lowered in place, so a sweep uses its own results. They only decrease, and converge to the
same numbers in any order of the cells: those of `search`, to the last bit.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_kernels.programs import BlockProgram
from angler_mjx.planning.current.search import NO_PATH_COST, STEPS, max_sweeps

_MAX_LANES = 1024
"""Cells that are relaxed together."""


def costs_to_goal(cost: jax.Array, goal: jax.Array, *, interpret: bool = False) -> jax.Array:
    """Return `search.costs_to_goal` of one robot.

    Args:
        cost: float16 [26, nx, ny, nz].
        goal: int32 [3].
        interpret: run as ordinary JAX, on any device.

    Returns:
        float32 [nx, ny, nz].
    """
    shape = (cost.shape[1], cost.shape[2], cost.shape[3])
    kernel = _CostKernel(shape, BlockProgram.of(min(_MAX_LANES, cost[0].size), interpret=interpret))
    value, _ = kernel.program.run(
        kernel,
        [goal.astype(jnp.int32), cost.reshape(-1)],
        [
            jax.ShapeDtypeStruct((cost[0].size,), jnp.float32),
            jax.ShapeDtypeStruct((kernel.n_padded_cells,), jnp.float32),
        ],
    )
    return value.reshape(shape)


@dataclass(frozen=True)
class _CostKernel:
    shape: tuple[int, int, int]
    program: BlockProgram

    __name__ = "costs_to_goal"

    @property
    def size(self) -> int:
        """Number of cells."""
        nx, ny, nz = self.shape
        return nx * ny * nz

    @property
    def n_padded_cells(self) -> int:
        """Number of cells with one more at both ends of each axis."""
        nx, ny, nz = self.shape
        return (nx + 2) * (ny + 2) * (nz + 2)

    def padded_index[N: (int, jax.Array)](self, x: N, y: N, z: N) -> N:
        """Return the index of a cell among those with one more at both ends."""
        _, ny, nz = self.shape
        return ((x + 1) * (ny + 2) + y + 1) * (nz + 2) + z + 1

    def __call__(self, goal: jax.Ref, cost: jax.Ref, value: jax.Ref, padded: jax.Ref) -> None:
        program = self.program
        lane = jnp.arange(program.lanes, dtype=jnp.int32)
        no_path = jnp.full((program.lanes,), NO_PATH_COST, jnp.float32)

        def clear_values(k: jax.Array, unchanged: jax.Array) -> jax.Array:
            at = k * program.lanes + lane
            program.store(padded, at, no_path, at < self.n_padded_cells)
            return unchanged

        jax.lax.fori_loop(0, -(-self.n_padded_cells // program.lanes), clear_values, jnp.int32(0))
        program.barrier()
        padded[self.padded_index(goal[0], goal[1], goal[2])] = jnp.float32(0.0)
        program.barrier()
        parts = -(-self.size // program.lanes)

        def sweep(state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            count, _ = state

            def sweep_part(k: jax.Array, has_changed: jax.Array) -> jax.Array:
                # One way and back again, so that what is found is carried along.
                part = jnp.where(count % 2 == 0, k, parts - 1 - k)
                cell, at, is_cell = self._cells_of_part(part, lane)
                before = program.load(padded, at, is_cell, NO_PATH_COST)
                best = before
                for number, step in enumerate(STEPS.tolist()):
                    step_cost = program.load(cost, number * self.size + cell, is_cell, jnp.inf)
                    neighbour_value = program.load(
                        padded, at + self._padded_offset(step), is_cell, NO_PATH_COST
                    )
                    best = jnp.minimum(best, step_cost.astype(jnp.float32) + neighbour_value)
                program.store(padded, at, best, is_cell)
                return has_changed | (best < before).astype(jnp.int32)

            has_changed = jax.lax.fori_loop(0, parts, sweep_part, 0 * lane)
            program.barrier()
            return count + 1, jnp.max(has_changed)

        def is_changing(state: tuple[jax.Array, jax.Array]) -> jax.Array:
            return (state[1] > 0) & (state[0] < max_sweeps(self.shape))

        jax.lax.while_loop(is_changing, sweep, (jnp.int32(0), jnp.int32(1)))

        def write_values(k: jax.Array, unchanged: jax.Array) -> jax.Array:
            cell, at, is_cell = self._cells_of_part(k, lane)
            program.store(value, cell, program.load(padded, at, is_cell, NO_PATH_COST), is_cell)
            return unchanged

        jax.lax.fori_loop(0, parts, write_values, jnp.int32(0))

    def _cells_of_part(
        self, part: jax.Array, lane: jax.Array
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Return the padded indices of the cells of a part, and which of them exist.

        Those beyond the last are the last.
        """
        _, ny, nz = self.shape
        cell = part * self.program.lanes + lane
        is_cell = cell < self.size
        cell = jnp.minimum(cell, self.size - 1)
        return cell, self.padded_index(cell // (ny * nz), cell // nz % ny, cell % nz), is_cell

    def _padded_offset(self, step: list[int]) -> int:
        return self.padded_index(*step) - self.padded_index(0, 0, 0)
