"""How hard a world is: the length of the shortest way, and whether the straight line is free.

Ways go through centres of cells, to any of the 26 neighbours, without cutting corners: a diagonal
move needs all cells of the 2 x 2 or 2 x 2 x 2 block that it spans.
"""

import itertools
import math

import jax
import jax.numpy as jnp


def shortest_ways(passable: jax.Array, start: jax.Array, goal: jax.Array) -> jax.Array:
    """Length [n] of the shortest way between pairs of cells, in cell edges; inf where none is.

    Bellman-Ford relaxation of all cells at once, until no cell nearer to a goal than its start
    changes. The grid is padded by a blocked cell on all sides and then flattened, so that every
    neighbour is one slice of a flat array; that is what makes it fast on CPU and GPU.

    Args:
        passable: bool [nx, ny, nz].
        start: int [n, 3] cells.
        goal: int [n, 3] cells.
    """
    padded = jnp.pad(passable, 1)
    strides = (padded.shape[1] * padded.shape[2], padded.shape[2], 1)
    free = padded.ravel()
    costs = _block_costs(free, strides)
    border, last = sum(strides), free.size - sum(strides)
    flat = jnp.array(strides)
    pair = jnp.arange(start.shape[0])
    from_index, to_index = (jnp.sum((cell + 1) * flat, axis=1) for cell in (start, goal))
    at_goal = jnp.where(free[to_index], 0.0, jnp.inf)
    way = jnp.full((start.shape[0], free.size), jnp.inf).at[pair, to_index].set(at_goal)

    def relax(carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        way, _ = carry
        old = new = way[:, border:last]
        for axes, cost in costs.items():
            for side in itertools.product((0, 1), repeat=len(axes)):
                # The cell stands at corner `side` of the block whose lowest cell is at `lowest`.
                lowest = -sum(s * strides[a] for s, a in zip(side, axes, strict=True))
                move = sum((1 - 2 * s) * strides[a] for s, a in zip(side, axes, strict=True))
                step = cost[border + lowest : last + lowest]
                new = jnp.minimum(new, way[:, border + move : last + move] + step)
        unsettled = jnp.any((new < old) & (new < way[pair, from_index][:, None]))
        return jnp.pad(new, ((0, 0), (border, border)), constant_values=jnp.inf), unsettled

    way, _ = jax.lax.while_loop(lambda carry: carry[1], relax, (way, jnp.array(True)))
    return way[pair, from_index]


def _block_costs(
    free: jax.Array, strides: tuple[int, int, int]
) -> dict[tuple[int, ...], jax.Array]:
    """Cost of a move along some axes within the block whose lowest cell this is; inf if blocked."""
    costs = {}
    for n_axis in (1, 2, 3):
        for axes in itertools.combinations(range(3), n_axis):
            block = free
            for axis in axes:
                # What is rolled over the end comes from the padding, which is never free.
                block = block & jnp.roll(block, -strides[axis])
            costs[axes] = jnp.where(block, math.sqrt(n_axis), jnp.inf)
    return costs


def line_is_free(occupied: jax.Array, start: jax.Array, goal: jax.Array) -> jax.Array:
    """Whether the straight segment between two points meets no occupied cell; bool [].

    Exact slab test against all cells; touching a cell's face, edge or corner is not meeting it.

    Args:
        occupied: bool [nx, ny, nz].
        start: [3] in cell edges from the lower corner of the grid.
        goal: [3] likewise.
    """
    enter, leave = jnp.zeros(occupied.shape), jnp.ones(occupied.shape)
    for axis, n in enumerate(occupied.shape):
        lower = jnp.arange(n).reshape([-1 if a == axis else 1 for a in range(3)])
        along = goal[axis] - start[axis]
        still = along == 0
        safe = jnp.where(still, 1.0, along)
        t0, t1 = (lower - start[axis]) / safe, (lower + 1 - start[axis]) / safe
        beside = still & ((start[axis] <= lower) | (start[axis] >= lower + 1))
        first = jnp.where(still, -jnp.inf, jnp.minimum(t0, t1))
        enter = jnp.maximum(enter, jnp.where(beside, jnp.inf, first))
        leave = jnp.minimum(leave, jnp.where(still, jnp.inf, jnp.maximum(t0, t1)))
    # Rounding of t is below 1e-6; a shorter stay in a cell is a touch.
    return ~jnp.any(occupied & (leave - enter > 1e-5))
