"""How hard a world is: the length of the shortest way, and whether the straight line is free.

Ways go through centres of cells, to any of the 26 neighbours, without cutting corners: a diagonal
move needs all cells of the 2 x 2 or 2 x 2 x 2 block that it spans.
"""

import itertools
import math

import jax
import jax.numpy as jnp


def shortest_way(passable: jax.Array, start: jax.Array, goal: jax.Array) -> jax.Array:
    """Length [] of the shortest way between two cells, in cell edges; inf where there is none.

    Bellman-Ford relaxation of all cells at once, until no cell nearer to the goal than the start
    changes. The grid is padded by a blocked cell on all sides and then flattened, so that every
    neighbour is one slice of a flat array; that is what makes it fast on CPU and GPU.

    Args:
        passable: bool [nx, ny, nz].
        start: int [3] cell.
        goal: int [3] cell.
    """
    free = jnp.pad(passable, 1)
    strides = (free.shape[1] * free.shape[2], free.shape[2], 1)
    moves = _moves(free.ravel(), strides)
    border, n = sum(strides), free.size
    from_index, to_index = (
        sum((cell[a] + 1) * strides[a] for a in range(3)) for cell in (start, goal)
    )
    way = jnp.full(n, jnp.inf).at[to_index].set(jnp.where(free.ravel()[to_index], 0.0, jnp.inf))

    def relax(carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        way, _ = carry
        old = new = way[border : n - border]
        for offset, cost in moves:
            new = jnp.minimum(new, way[border + offset : n - border + offset] + cost)
        unsettled = jnp.any((new < old) & (new < way[from_index]))
        return jnp.pad(new, border, constant_values=jnp.inf), unsettled

    way, _ = jax.lax.while_loop(lambda carry: carry[1], relax, (way, jnp.array(True)))
    return way[from_index]


def _moves(free: jax.Array, strides: tuple[int, int, int]) -> list[tuple[int, jax.Array]]:
    """The 26 moves: flat offset and cost (inf where blocked) for all cells but the border."""
    border, n = sum(strides), free.shape[0]
    costs: dict[tuple[int, ...], jax.Array] = {}
    for n_axis in (1, 2, 3):
        for axes in itertools.combinations(range(3), n_axis):
            block = free
            for axis in axes:
                # What is rolled over the end comes from the padding, which is never free.
                block = block & jnp.roll(block, -strides[axis])
            costs[axes] = jnp.where(block, math.sqrt(n_axis), jnp.inf)
    moves = []
    for axes, cost in costs.items():
        for side in itertools.product((0, 1), repeat=len(axes)):
            # The cell stands at corner `side` of the block whose lowest cell is at `lowest`.
            lowest = -sum(s * strides[a] for s, a in zip(side, axes, strict=True))
            offset = sum((1 - 2 * s) * strides[a] for s, a in zip(side, axes, strict=True))
            moves.append((offset, cost[border + lowest : n - border + lowest]))
    return moves


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
        inside = (start[axis] > lower) & (start[axis] < lower + 1)
        t0 = jnp.where(still, jnp.where(inside, -jnp.inf, jnp.inf), t0)
        t1 = jnp.where(still, jnp.where(inside, jnp.inf, -jnp.inf), t1)
        enter = jnp.maximum(enter, jnp.minimum(t0, t1))
        leave = jnp.minimum(leave, jnp.maximum(t0, t1))
    # Rounding of t is below 1e-6; a shorter stay in a cell is a touch.
    return ~jnp.any(occupied & (leave - enter > 1e-5))
