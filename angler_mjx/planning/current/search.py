"""Least cost from every cell to a goal, and the path there; for batches, not single robots.

Value iteration over cells and their 26 neighbours: a cell's cost is the least of a step's and its
neighbour's. All cells at once, until none changes; loops end for the batch as a whole.
"""

import itertools

import jax
import jax.numpy as jnp
import numpy as np

NO_PATH_COST = 1e9
"""Cost of a cell without a path, metres of still water."""

STEPS = np.array([s for s in itertools.product((-1, 0, 1), repeat=3) if s != (0, 0, 0)])
"""[26, 3] cells."""


def max_sweeps(shape: tuple[int, ...]) -> int:
    """Return the limit of sweeps over cells of this shape."""
    return 4 * sum(shape)


def costs_to_goal(cost: jax.Array, goal: jax.Array) -> jax.Array:
    """Return the least cost from every cell.

    Args:
        cost: [B, 26, nx, ny, nz] of the step from a cell along each of `STEPS`; `NO_PATH_COST` for
            none.
        goal: int32 [B, 3] cells.

    Returns:
        [B, nx, ny, nz]; `NO_PATH_COST` or more where there is no way.
    """
    shape = cost.shape[2:]
    axes = [jnp.arange(n) for n in shape]
    at = jnp.stack(jnp.meshgrid(*axes, indexing="ij"), axis=-1)
    is_goal = jnp.all(at == goal[:, None, None, None, :], axis=-1)
    begin = jnp.where(is_goal, 0.0, NO_PATH_COST).astype(jnp.float32)

    def is_changing(state: tuple[jax.Array, jax.Array, jax.Array]) -> jax.Array:
        _, changed, count = state
        return changed & (count < max_sweeps(shape))

    def sweep(
        state: tuple[jax.Array, jax.Array, jax.Array],
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        value, _, count = state
        new = value
        padded = jnp.pad(value, ((0, 0), (1, 1), (1, 1), (1, 1)), constant_values=NO_PATH_COST)
        for number, (x, y, z) in enumerate(STEPS):
            neighbour_value = padded[
                :,
                1 + x : 1 + x + shape[0],
                1 + y : 1 + y + shape[1],
                1 + z : 1 + z + shape[2],
            ]
            new = jnp.minimum(new, cost[:, number].astype(jnp.float32) + neighbour_value)
        return new, jnp.any(new < value), count + 1

    value, _, _ = jax.lax.while_loop(is_changing, sweep, (begin, jnp.array(True), jnp.array(0)))
    return value


def trace_path(
    cost: jax.Array, value: jax.Array, start: jax.Array, length: int
) -> tuple[jax.Array, jax.Array]:
    """Return the cells of the path of one robot.

    Args:
        cost: [26, nx, ny, nz], as above.
        value: [nx, ny, nz] least costs.
        start: int32 [3].
        length: cells, static.

    Returns:
        Cells int32 [length, 3] from the start on, the last repeated; and whether the goal is
        reached, bool [].
    """
    shape = np.array(value.shape)
    steps = jnp.asarray(STEPS)

    def step(cell: jax.Array, _: None) -> tuple[jax.Array, jax.Array]:
        neighbours = cell + steps
        inside = jnp.all((neighbours >= 0) & (neighbours < shape), axis=-1)
        neighbour_cells = jnp.clip(neighbours, 0, shape - 1)
        total = cost[:, cell[0], cell[1], cell[2]].astype(jnp.float32)
        total += jnp.where(
            inside,
            value[neighbour_cells[:, 0], neighbour_cells[:, 1], neighbour_cells[:, 2]],
            NO_PATH_COST,
        )
        best = jnp.argmin(total)
        cell_value = value[cell[0], cell[1], cell[2]]
        can_step = (cell_value > 0.0) & (cell_value < NO_PATH_COST) & (total[best] < NO_PATH_COST)
        after = jnp.where(can_step, neighbour_cells[best], cell)
        return after, cell

    last, cells = jax.lax.scan(step, start, None, length=length)
    return cells, value[last[0], last[1], last[2]] == 0.0
