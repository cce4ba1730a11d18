"""Steps of one robot between cells, and the cost of each in the current."""

from collections.abc import Callable

import jax
import jax.numpy as jnp

from angler_mjx.planning.current.motion_cost import PowerModel, cost_and_speed
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

_SAMPLE_FRACTIONS = (0.25, 0.75)
"""Positions of water samples, as fractions of a step."""


def step_costs(land: Terrain, team: PowerModel, clearance_m: jax.Array, flow: Flow) -> jax.Array:
    """Return the cost of each of `STEPS` from each cell, metres of still water.

    Args:
        land: the world.
        team: [R] robots.
        clearance_m: [R] to keep from all that stands.
        flow: of the water; it stays.

    Returns:
        float16 [R, 26, nx, ny, nz]; infinite where a step is not free.
    """
    free = jax.vmap(lambda clear: _is_step_free(land.layout, free_space(land, clear)))(clearance_m)
    shape, cell_m = land.layout.shape, land.grid.cell_m
    axes = [jnp.arange(n) for n in shape]
    cells = jnp.stack(jnp.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    centre = land.grid.origin_m + (cells + 0.5) * cell_m
    steps = jnp.asarray(STEPS, centre.dtype)

    def cost_of_step(step: jax.Array) -> jax.Array:
        length = jnp.sqrt(jnp.sum(step * step))
        sample_points_m = [centre + fraction * cell_m * step for fraction in _SAMPLE_FRACTIONS]
        # The water is the same for all robots: looked at once, whatever the compiler would prefer.
        water = jax.lax.optimization_barrier(
            [jax.vmap(flow)(point_m) for point_m in sample_points_m]
        )

        def of_robot(robot: PowerModel) -> jax.Array:
            along = jnp.broadcast_to(step / length, centre.shape)
            total = sum(cost_and_speed(robot, along, flow_mps)[0] for flow_mps in water)
            return (total * (length * cell_m / len(_SAMPLE_FRACTIONS))).astype(jnp.float16)

        return jax.vmap(of_robot)(team)

    cost = jnp.moveaxis(jax.lax.map(cost_of_step, steps), 0, 1).reshape(-1, 26, *shape)
    return jnp.where(free, cost, jnp.inf)


def _is_step_free(layout: LatticeLayout, free: FreeSpace) -> jax.Array:
    """Return whether each step from each cell is free, bool [26, nx, ny, nz]."""
    shape = layout.shape
    at = layout.guard_size + layout.row * jnp.arange(shape[0])[:, None] + jnp.arange(shape[1])
    edge_bits = free.edges[:, at]
    bits = (edge_bits[..., None] >> jnp.arange(shape[2], dtype=jnp.uint32)) & 1
    padded = jnp.pad(bits.astype(bool), ((0, 0), (1, 1), (1, 1), (1, 1)))
    numbers = {tuple(step): number for number, step in enumerate(STEPS.tolist())}
    is_free: list[jax.Array] = [padded[0, 1:-1, 1:-1, 1:-1]] * len(numbers)
    for number, edge in enumerate(EDGES):
        ahead = tuple(b - a for a, b in zip(edge.near, edge.far, strict=True))
        for corner, step in ((edge.near, ahead), (edge.far, tuple(-d for d in ahead))):
            offset = [1 - c for c in corner]
            is_free[numbers[step]] = padded[
                number,
                offset[0] : offset[0] + shape[0],
                offset[1] : offset[1] + shape[1],
                offset[2] : offset[2] + shape[2],
            ]
    return jnp.stack(is_free)
