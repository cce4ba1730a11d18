"""Resampling of a world until it fits: its cells, and the positions of the fleet.

A single world is sampled in a loop until it can hold its fleet. Under ``vmap`` that loop would
repeat for all worlds the iterations that only a few need, so `sample_world` brings its own rule for
a batch: group by group all worlds are sampled once, and then only those that failed (`groups`).
Large batches are split into tiles of worlds that the device's caches and memory can hold. A world
depends on its key alone. The functions behind `sample_world` have their axis of worlds last (see
`angler_kernels.bit_grid`).
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_kernels.bit_grid import count_cells, full_grid, pack_grid, unpack_grid
from angler_mjx.world import groups
from angler_mjx.world.config import WorldNumbers, WorldRecipe
from angler_mjx.world.difficulty import line_is_free, open_path_lengths, shortest_paths
from angler_mjx.world.obstacles.explicit import explicit_rows
from angler_mjx.world.placement import (
    cell_centres,
    cell_of,
    choose_positions,
    obstacle_gap,
    passable_cells,
)
from angler_mjx.world.rock.rules import sample_cells

_GROUP_DIVISOR = 4
"""Number of groups into which a tile is divided for sampling."""
_TILE_NUMBERS = {"cpu": 1 << 21}
"""Max number of path lengths in a tile, by platform: 8 MiB, the size of caches, on a CPU."""
_TILE_NUMBERS_ELSEWHERE = 1 << 28
"""512 MiB: enough work for every thread of a GPU, and a small part of its memory."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class WorldSample:
    """Cells of one world, positions of its fleet, and difficulty of its paths."""

    occupied: jax.Array
    """bool [nx, ny, nz]."""
    start: jax.Array
    """[n_robot, 3] m, W."""
    goal: jax.Array
    """[n_robot, 3] m, W."""
    path_ratio: jax.Array
    """[n_robot] shortest path over straight line."""
    line_free: jax.Array
    """bool [n_robot] whether the straight line is free."""
    redraws: jax.Array
    """int32 [] samples rejected before this one."""
    fits: jax.Array
    """bool [] whether the world holds the fleet."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _WorldAttempt:
    """One attempt at each of many worlds; the axis of worlds is the last of every leaf."""

    occupied: jax.Array
    """Packed cells."""
    passable: jax.Array
    """Packed cells passable for the widest robot."""
    start: jax.Array
    goal: jax.Array
    fits: jax.Array
    redraws: jax.Array


def sample_world(
    recipe: WorldRecipe,
    numbers: WorldNumbers,
    radius_m: jax.Array,
    key: jax.Array,
    rock: jax.Array | None = None,
) -> WorldSample:
    """Sample cells and positions of a world until the fleet fits or the recipe's limit is reached.

    Args:
        recipe: static.
        numbers: of the recipe; the same in all worlds of a batch.
        radius_m: [n_robot] radius of each robot's bounding sphere; below 1.5 cells.
        key: random key of this world's cells.
        rock: bool [nx, ny, nz] cells that are always occupied; none if left out.
    """
    inputs = (radius_m, key) if rock is None else (radius_m, key, rock)

    @jax.custom_batching.custom_vmap
    def sample_one(numbers: WorldNumbers, *inputs: jax.Array) -> WorldSample:
        alone: WorldSample = jax.tree.map(
            lambda leaf: leaf[0], _sample_tile(recipe, numbers, *(part[None] for part in inputs))
        )
        return alone

    @sample_one.def_vmap
    def _batch(
        n_world: int, batched: list[bool], numbers: WorldNumbers, *inputs: jax.Array
    ) -> tuple[WorldSample, WorldSample]:
        worlds = sample_worlds(
            recipe,
            numbers,
            *(
                part if is_one else jnp.broadcast_to(part, (n_world, *part.shape))
                for part, is_one in zip(inputs, batched[1:], strict=True)
            ),
        )
        return worlds, jax.tree.map(lambda _: True, worlds)

    sample: WorldSample = sample_one(numbers, *inputs)
    return sample


def sample_worlds(
    recipe: WorldRecipe,
    numbers: WorldNumbers,
    radius_m: jax.Array,
    keys: jax.Array,
    rock: jax.Array | None = None,
) -> WorldSample:
    """Sample worlds [n_world, n_robot] and [n_world] as `sample_world` does, tile by tile."""
    n_world, n_robot = radius_m.shape
    max_worlds = tile_size(recipe, n_robot)
    if n_world <= max_worlds:
        return _sample_tile(recipe, numbers, radius_m, keys, rock)
    n_tile = -(-n_world // max_worlds)
    tile = -(-n_world // n_tile)
    # The last tile is padded with the first worlds; the copies are cut off again.
    index = jnp.arange(n_tile * tile).reshape(n_tile, tile) % n_world
    inputs = (radius_m, keys) if rock is None else (radius_m, keys, rock)
    tiles = jax.lax.map(
        lambda i: _sample_tile(recipe, numbers, *(part[i] for part in inputs)), index
    )
    worlds: WorldSample = jax.tree.map(
        lambda leaf: leaf.reshape(-1, *leaf.shape[2:])[:n_world], tiles
    )
    return worlds


def tile_size(recipe: WorldRecipe, n_robot: int) -> int:
    """Return the max number of worlds sampled at once on the platform that JAX computes on."""
    numbers = _TILE_NUMBERS.get(jax.default_backend(), _TILE_NUMBERS_ELSEWHERE)
    nx, ny, nz = recipe.shape
    return max(1, numbers // (nx * ny * nz * n_robot))


def _sample_tile(
    recipe: WorldRecipe,
    numbers: WorldNumbers,
    radius_m: jax.Array,
    keys: jax.Array,
    rock: jax.Array | None = None,
) -> WorldSample:
    """Sample worlds [n_world, n_robot], [n_world], all at once."""
    radius = radius_m.T
    packed = None if rock is None else pack_grid(jnp.moveaxis(rock, 0, -1))
    made = _resample_worlds(recipe, numbers, radius, keys, packed)
    occupied = unpack_grid(made.occupied, recipe.shape[2])
    path_ratio, line_free = measure_difficulty(
        recipe, occupied, made.passable, made.start, made.goal
    )
    last = WorldSample(
        occupied=occupied,
        start=made.start,
        goal=made.goal,
        path_ratio=path_ratio,
        line_free=line_free,
        redraws=made.redraws,
        fits=made.fits,
    )
    worlds: WorldSample = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0), last)
    return worlds


def _resample_worlds(
    recipe: WorldRecipe,
    numbers: WorldNumbers,
    radius: jax.Array,
    keys: jax.Array,
    rock: jax.Array | None,
) -> _WorldAttempt:
    """Sample worlds until each holds its fleet or reached the limit.

    Args:
        recipe: static.
        numbers: of the recipe.
        radius: [n_robot, n_world].
        keys: [n_world].
        rock: packed cells that are always occupied; None for none.
    """
    n_world = keys.shape[0]
    size = -(-n_world // _GROUP_DIVISOR)

    def unfit(worlds: _WorldAttempt) -> jax.Array:
        return ~worlds.fits & (worlds.redraws < numbers.redraw_limit)

    def sample_group(carry: tuple[jax.Array, _WorldAttempt]) -> tuple[jax.Array, _WorldAttempt]:
        turn, worlds = carry
        group = groups.choose_group(turn, unfit(worlds), size)
        read = group.read
        always = None if rock is None else rock[..., read]
        new = attempt_worlds(
            recipe, numbers, radius[:, read], keys[read], worlds.redraws[read] + 1, always
        )
        renewed: _WorldAttempt = jax.tree.map(
            lambda old, some: old.at[..., group.index].set(some, mode="drop"), worlds, new
        )
        return turn + 1, renewed

    def unfinished(carry: tuple[jax.Array, _WorldAttempt]) -> jax.Array:
        turn, worlds = carry
        return ~groups.all_had_turn(turn, n_world, size) | jnp.any(unfit(worlds))

    cells = jnp.zeros((*full_grid(recipe.shape).shape, n_world), jnp.uint32)
    positions = jnp.zeros((radius.shape[0], 3, n_world))
    none = _WorldAttempt(
        occupied=cells,
        passable=cells,
        start=positions,
        goal=positions,
        fits=jnp.zeros(n_world, bool),
        redraws=jnp.full(n_world, -1, jnp.int32),
    )
    _, last = jax.lax.while_loop(unfinished, sample_group, (jnp.int32(0), none))
    return last


def attempt_worlds(
    recipe: WorldRecipe,
    numbers: WorldNumbers,
    radius: jax.Array,
    keys: jax.Array,
    redraws: jax.Array,
    rock: jax.Array | None = None,
) -> _WorldAttempt:
    """Return one attempt at each world.

    Args:
        recipe: static.
        numbers: of the recipe.
        radius: [n_robot, n_world].
        keys: [n_world].
        redraws: int32 [n_world] index of the attempt at its world.
        rock: packed cells that are always occupied; none if left out.
    """

    def keys_of_try(key: jax.Array, redraws: jax.Array) -> jax.Array:
        return jax.random.split(jax.random.fold_in(key, redraws))

    cells_keys, position_keys = jax.vmap(keys_of_try, out_axes=1)(keys, redraws)
    occupied = sample_cells(recipe.rule, recipe.shape, numbers.fill, cells_keys)
    sampled = occupied
    occupied = sampled if rock is None else sampled | rock
    free = ~occupied & full_grid(recipe.shape)[..., None]
    ground, start_gap = _obstacle_gaps(recipe, numbers.floor_z_m)
    passable = passable_cells(free, ground, recipe.cell_m, jnp.max(radius, axis=0))
    start, goal, fits = choose_positions(
        recipe, numbers.clearance_m, free, passable, start_gap, radius, position_keys
    )
    return _WorldAttempt(
        occupied=occupied,
        passable=passable,
        start=start,
        goal=goal,
        fits=fits & (count_cells(sampled) >= numbers.min_obstacles),
        redraws=redraws,
    )


def measure_difficulty(
    recipe: WorldRecipe,
    occupied: jax.Array,
    passable: jax.Array,
    start: jax.Array,
    goal: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Return the path ratio and whether the straight line is free, [n_robot, n_world] each.

    Args:
        recipe: static.
        occupied: bool [nx, ny, nz, n_world].
        passable: packed cells.
        start: [n_robot, 3, n_world] m, W.
        goal: as ``start``.
    """
    start, goal = (jnp.moveaxis(p, 1, -1) for p in (start, goal))
    from_cell, to_cell = (jnp.moveaxis(cell_of(recipe, p), -1, 0) for p in (start, goal))
    path_lengths = open_path_lengths if recipe.is_empty else shortest_paths
    length = path_lengths(passable, recipe.shape[2], from_cell, to_cell)
    straight = jnp.sqrt(jnp.sum((to_cell - from_cell) ** 2, axis=0).astype(length.dtype))
    ratio = jnp.where(straight > 0, length / jnp.maximum(straight, 1.0), 1.0)
    origin = jnp.array(recipe.origin_m, float)
    in_cells = (jnp.moveaxis((p - origin) / recipe.cell_m, -1, 0) for p in (start, goal))
    # XLA 0.11.2 computes what follows wrongly for CPUs with AVX2 when it fuses this into it without
    # optimisation by LLVM, as the tests compile.
    ends = jax.lax.optimization_barrier(tuple(in_cells))
    line_free = line_is_free(occupied[:, :, :, None], *ends)
    # A lattice path is never shorter than the line; 1 - 1e-7 would be rounding.
    return jnp.maximum(ratio, 1.0), line_free


def _obstacle_gaps(recipe: WorldRecipe, floor_z_m: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the distances [nx, ny, nz] of the cells' centres to the unsampled obstacles, m.

    The first to floor and explicit static obstacles, the second to all explicit obstacles at the
    start.
    """
    centres = cell_centres(recipe)
    ground = centres[..., 2] - floor_z_m
    start_gap = jnp.full(recipe.shape, jnp.inf)
    if recipe.obstacles.explicit:
        rows = explicit_rows(recipe.obstacles.explicit, 1000.0)  # Density does not change shapes.
        start_gap = obstacle_gap(rows, centres, only_static=False)
        ground = jnp.minimum(ground, obstacle_gap(rows, centres, only_static=True))
    return ground, start_gap
