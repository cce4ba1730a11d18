"""The steps that one robot may make between cells, and what each costs it in the current."""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from angler_mjx.planning.current.pace import PowerModel, pace
from angler_mjx.planning.current.search import STEPS
from angler_mjx.planning.path_search.lattice import (
    EDGES,
    FreeSpace,
    LatticeLayout,
    Terrain,
    free_space,
)

type Flow = Callable[[jax.Array], jax.Array]
"""Velocity [3] m/s of the water at a point [3]."""

_LOOKS = (0.25, 0.75)
"""Where the water is looked at, as shares of a step."""


def step_costs(land: Terrain, team: PowerModel, clearance_m: jax.Array, flow: Flow) -> jax.Array:
    """Cost of each of `STEPS` from each cell, metres of still water.

    Args:
        land: the world.
        team: [R] robots.
        clearance_m: [R] to keep from all that stands.
        flow: of the water; it stays.

    Returns:
        float16 [R, 26, nx, ny, nz]; infinite where a step is not free.
    """
    free = jax.vmap(lambda clear: _free_steps(land.layout, free_space(land, clear)))(clearance_m)
    shape, cell_m = land.layout.shape, land.grid.cell_m
    axes = [jnp.arange(n) for n in shape]
    at = jnp.stack(jnp.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    centre = land.grid.origin_m + (at + 0.5) * cell_m
    steps = jnp.asarray(STEPS, centre.dtype)

    def one(step: jax.Array) -> jax.Array:
        length = jnp.sqrt(jnp.sum(step * step))
        looks = [centre + share * cell_m * step for share in _LOOKS]
        # The water is the same for all robots: looked at once, whatever the compiler would prefer.
        water = jax.lax.optimization_barrier([jax.vmap(flow)(place) for place in looks])

        def of_robot(robot: PowerModel) -> jax.Array:
            along = jnp.broadcast_to(step / length, centre.shape)
            total = sum(pace(robot, along, seen)[0] for seen in water)
            return (total * (length * cell_m / len(_LOOKS))).astype(jnp.float16)

        return jax.vmap(of_robot)(team)

    cost = jnp.moveaxis(jax.lax.map(one, steps), 0, 1).reshape(-1, 26, *shape)
    return jnp.where(free, cost, jnp.inf)


def _free_steps(layout: LatticeLayout, free: FreeSpace) -> jax.Array:
    """Whether each step from each cell is free, bool [26, nx, ny, nz]."""
    shape = layout.shape
    at = layout.guard + layout.row * jnp.arange(shape[0])[:, None] + jnp.arange(shape[1])
    words = free.edges[:, at]
    bits = (words[..., None] >> jnp.arange(shape[2], dtype=jnp.uint32)) & 1
    wide = jnp.pad(bits.astype(bool), ((0, 0), (1, 1), (1, 1), (1, 1)))
    numbers = {tuple(step): number for number, step in enumerate(STEPS.tolist())}
    found: list[jax.Array] = [wide[0, 1:-1, 1:-1, 1:-1]] * len(numbers)
    for number, edge in enumerate(EDGES):
        ahead = tuple(b - a for a, b in zip(edge.near, edge.far, strict=True))
        for corner, step in ((edge.near, ahead), (edge.far, tuple(-d for d in ahead))):
            low = [1 - c for c in corner]
            found[numbers[step]] = wide[
                number,
                low[0] : low[0] + shape[0],
                low[1] : low[1] + shape[1],
                low[2] : low[2] + shape[2],
            ]
    return jnp.stack(found)
