"""Sampling of the task of a world: its places."""

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_kernels.matching import match_pairs
from angler_mjx.world.environment import Environment
from angler_mjx.world.rock.grid import Grid
from angler_mjx.world.tasks import allocation, surface, travel
from angler_mjx.world.tasks.spec import TaskSpec, TaskWorld
from angler_mjx.world.tasks.visibility import cell_of, centre_m

type Subregion = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Part of a world's cube: lower and upper corner, as fractions of the cube's edges."""

WHOLE: Subregion = ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))


@dataclass(frozen=True, kw_only=True)
class GoalSampling:
    """Region in which places are sampled, or fixed places."""

    within: Subregion = WHOLE
    fixed_m: tuple[tuple[float, float, float], ...] = ()
    """Places in W, instead of sampling."""


def sample_task(
    spec: TaskSpec,
    begin: GoalSampling,
    end: GoalSampling,
    key: jax.Array,
    environment: Environment,
    reachable: jax.Array,
) -> TaskWorld:
    """Sample the task of one world.

    Args:
        spec: settings.
        begin: places where jobs begin; a survey computes its viewpoints itself.
        end: destinations of goods.
        key: random key of the world's task only.
        environment: environment of the world.
        reachable: bool [nx, ny, nz] cells that robots can reach.
    """
    grid, survey = environment.grid, None
    exists = jnp.ones(spec.jobs, bool)
    if spec.survey is not None:
        positions, exists, fits, survey = surface.choose_viewpoints(
            spec.survey, spec.jobs, spec.tolerance_m, grid, environment.floor_z_m, reachable
        )
        homes = environment.start_m
        position_m = jnp.concatenate([positions, homes])
    else:
        of_begin, of_end = jax.random.split(key)
        positions, fits = _sample_positions(begin, spec.jobs, of_begin, grid, reachable)
        parts = [positions]
        if spec.kind == "deliver":
            ends, fit_too = _sample_positions(end, spec.jobs, of_end, grid, reachable)
            parts, fits = [positions, ends], fits & fit_too
        position_m = jnp.concatenate([*parts, environment.start_m])
    rank = rank_boustrophedon(positions, exists, grid)
    return TaskWorld(
        position_m=position_m,
        exists=exists,
        rank=rank,
        part=_assign_parts(spec, positions, exists, rank, environment.start_m),
        fits=fits,
        survey=survey,
    )


def _sample_positions(
    wanted: GoalSampling, count: int, key: jax.Array, grid: Grid, reachable: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return reachable places [count, 3] in W, and bool [] whether there are enough.

    Sampled places are centres of different cells. A given place whose cell cannot be reached is
    moved to the centre of the nearest reachable cell.
    """
    shape = reachable.shape
    cells = jnp.stack(jnp.meshgrid(*map(jnp.arange, shape), indexing="ij"), axis=-1).reshape(-1, 3)
    centre, may = centre_m(grid, cells), reachable.reshape(-1)
    if wanted.fixed_m:
        fixed_m = jnp.array(wanted.fixed_m, centre.dtype)
        at = cell_of(grid, fixed_m)
        free = reachable[at[:, 0], at[:, 1], at[:, 2]]
        away = jnp.sum((fixed_m[:, None] - centre) ** 2, axis=-1)
        nearest = jnp.argmin(jnp.where(may, away, jnp.inf), axis=1)
        return jnp.where(free[:, None], fixed_m, centre[nearest]), jnp.any(may)
    fraction = (cells + 0.5) / jnp.array(shape)
    low, high = (jnp.array(corner) for corner in wanted.within)
    may &= jnp.all((fraction >= low) & (fraction <= high), axis=-1)
    priority = jnp.where(may, jax.random.uniform(key, may.shape), -1.0)
    best, cell = jax.lax.top_k(priority, count)
    return centre[cell], jnp.all(best >= 0.0)


def rank_boustrophedon(positions: jax.Array, exists: jax.Array, grid: Grid) -> jax.Array:
    """Return each job's index int32 [M] in lanes back and forth; missing jobs come last.

    Lanes lie side by side along y; their number makes each place's part of the area square.
    """
    jobs = positions.shape[0]
    nx, ny, _ = grid.occupied.shape
    lanes = max(1, round(math.sqrt(jobs * ny / nx)))
    across = (positions[:, 1] - grid.origin_m[1]) / (ny * grid.cell_m)
    lane = jnp.clip(jnp.floor(across * lanes), 0, lanes - 1)
    along = (positions[:, 0] - grid.origin_m[0]) / (nx * grid.cell_m)
    along = jnp.where(lane % 2 == 0, along, 1.0 - along)
    order = jnp.argsort(jnp.where(exists, lane + along, jnp.inf), stable=True)
    return jnp.zeros(jobs, jnp.int32).at[order].set(jnp.arange(jobs, dtype=jnp.int32))


def _assign_parts(
    spec: TaskSpec, positions: jax.Array, exists: jax.Array, rank: jax.Array, start_m: jax.Array
) -> jax.Array:
    """Return each robot's part of the order, int32 [R]: the part that begins nearest to it."""
    robots = spec.robots
    part = allocation.part_of(rank, jnp.sum(exists, dtype=jnp.int32), robots)
    first = (part == jnp.arange(robots)[:, None]) & exists
    at = positions[jnp.argmin(jnp.where(first, rank, spec.jobs), axis=1)]
    return match_pairs(travel.straight_lengths(start_m, at))
