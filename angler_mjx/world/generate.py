"""Generation of complete worlds from a recipe and a key.

`generate_world` makes one world and is pure; `generate_batch` is the boundary that compiles and
batches it. World i of a seed does not depend on its batch.
"""

import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels.threefry import seed_key
from angler_mjx.errors import ConfigError
from angler_mjx.world import currents, obstacles
from angler_mjx.world.config import WorldConfig, WorldNumbers, WorldRecipe, resolve_world
from angler_mjx.world.currents import ground
from angler_mjx.world.environment import Environment
from angler_mjx.world.ocean.floor import CellCentres
from angler_mjx.world.placement import check_positions
from angler_mjx.world.rock.grid import Grid
from angler_mjx.world.sampling import sample_world

_SEA_FLOOR = 0x464C4F4F
"""Folded into a world's key for the position of its sea floor: a constant that no other sample
uses."""


def generate_world(
    recipe: WorldRecipe,
    numbers: WorldNumbers,
    radius_m: jax.Array,
    key: jax.Array,
    water_density_kgm3: jax.Array | float = 1000.0,
) -> Environment:
    """Generate a world for a fleet.

    Cells and positions are sampled again, with new keys, until the world holds the fleet or the
    limit of the recipe is reached; then ``valid`` is False.

    Args:
        recipe: static.
        numbers: of the recipe.
        radius_m: [n_robot] radius of each robot's bounding sphere; below 1.5 cells.
        key: random key of this world.
        water_density_kgm3: for the obstacles' mass and added mass.
    """
    cells_key, obstacles_key, current_key = jax.random.split(key, 3)
    current = None
    if recipe.has_ground:
        current, rock = _sample_ground(recipe, numbers, key, current_key)
        sample = sample_world(recipe, numbers, radius_m, cells_key, rock)
    else:
        sample = sample_world(recipe, numbers, radius_m, cells_key)
    lo, hi = _region_corners(recipe, numbers)
    grid = Grid(
        occupied=sample.occupied,
        origin_m=jnp.array(recipe.origin_m, float),
        cell_m=jnp.array(recipe.cell_m, float),
    )
    keep_out = jnp.concatenate([sample.start, sample.goal])
    keep_out_radius = jnp.tile(radius_m + numbers.clearance_m, 2)
    to_goal = sample.goal - sample.start
    return Environment(
        grid=grid,
        floor_z_m=numbers.floor_z_m,
        obstacles=obstacles.sample_obstacles(
            recipe.obstacles.explicit,
            numbers.drifting,
            obstacles_key,
            grid,
            lo,
            hi,
            keep_out,
            keep_out_radius,
            water_density_kgm3,
        ),
        current=(
            currents.sample_current(numbers.currents, current_key, lo, hi)
            if current is None
            else current
        ),
        start_m=sample.start,
        start_yaw_rad=jnp.arctan2(to_goal[:, 1], to_goal[:, 0]),
        goal_m=sample.goal,
        density=jnp.mean(sample.occupied, dtype=lo.dtype),
        path_ratio=sample.path_ratio,
        line_free=sample.line_free,
        redraws=sample.redraws,
        valid=sample.fits,
    )


def sample_current(recipe: WorldRecipe, numbers: WorldNumbers, key: jax.Array) -> currents.Current:
    """Sample only the current of the world of `generate_world`; arguments as there."""
    lo, hi = _region_corners(recipe, numbers)
    return currents.sample_current(numbers.currents, jax.random.split(key, 3)[2], lo, hi)


def _region_corners(recipe: WorldRecipe, numbers: WorldNumbers) -> tuple[jax.Array, jax.Array]:
    """Return the lower and upper corner [3] of the water of the grid, m, W."""
    lo = jnp.array(recipe.origin_m, float)
    hi = lo + jnp.array(recipe.size_m, float)
    return lo.at[2].max(numbers.floor_z_m), hi


def _sample_ground(
    recipe: WorldRecipe, numbers: WorldNumbers, key: jax.Array, current_key: jax.Array
) -> tuple[currents.Current, jax.Array | None]:
    """Sample the current of a world, and return its rock from the file."""
    lo, hi = _region_corners(recipe, numbers)
    current = currents.sample_current(numbers.currents, current_key, lo, hi)
    x, y, z = (
        jnp.array(low + recipe.cell_m * (np.arange(n) + 0.5), float)
        for low, n in zip(recipe.origin_m, recipe.shape, strict=True)
    )
    rock = ground.find_rock(
        recipe.currents,
        current,
        recipe.bathymetry,
        jax.random.fold_in(key, _SEA_FLOOR),
        lo,
        hi,
        CellCentres(x=x, y=y, z=z),
    )
    return current, rock


def generate_batch(
    config: WorldConfig,
    radius_m: np.ndarray | jax.Array,
    seed: int,
    first_index: int,
    count: int,
    horizon_s: float = 120.0,
    water_density_kgm3: float = 1000.0,
) -> Environment:
    """Generate worlds ``first_index`` to ``first_index + count - 1`` of a seed.

    Args:
        config: world config of the scenario.
        radius_m: [n_robot] radius of each robot's bounding sphere, or [count, n_robot] where
            fleets differ between worlds.
        seed: 0 to 2^32 - 1; the key of a world is this seed's, folded with the world's index.
        first_index: index of the first world among all worlds of the seed.
        count: number of worlds.
        horizon_s: time that the current covers.
        water_density_kgm3: for the obstacles' mass and added mass.

    Returns:
        Environment with a leading axis of ``count``.

    Raises:
        ConfigError: a robot too large for any cell, or more robots than given positions.
    """
    recipe = resolve_world(config)
    radius = np.asarray(radius_m)
    if not 0 <= seed < 2**32:
        raise ConfigError(f"seed = {seed}: must lie between 0 and 2^32 - 1")
    check_fleet(recipe, radius)
    radii = jnp.broadcast_to(jnp.asarray(radius, float), (count, radius.shape[-1]))
    batch: Environment = _generate_batch(
        recipe, recipe.numbers(horizon_s), radii, seed, first_index, water_density_kgm3
    )
    return batch


def check_fleet(
    recipe: WorldRecipe,
    radius_m: np.ndarray | jax.Array,
    *,
    by_end_effector: bool = False,
    held: int = -1,
) -> None:
    """Refuse a fleet that no sample of the recipe can hold, before compilation.

    Args:
        recipe: recipe of the world.
        radius_m: [..., n_robot] radius of each robot's bounding sphere.
        by_end_effector: goals are those of end effectors, which need no room for a hull.
        held: index of the explicit obstacle that the robots hold by their arms; -1 for none.

    Raises:
        ConfigError: no robot, more robots than cells, a robot too wide for the cells, or given
            positions that are not free.
    """
    radius = np.asarray(radius_m)
    n_robot = radius.shape[-1]
    if n_robot < 1:
        raise ConfigError("the fleet has no robot")
    cells = math.prod(recipe.shape)
    if recipe.placement != "given" and n_robot > cells:
        raise ConfigError(
            f"{n_robot} robots (fleet.count) do not fit shape = {recipe.shape}: each "
            f"starts in a cell of its own; take {cells} robots at most, or a larger shape"
        )
    widest = float(radius.max())
    if not float(radius.min()) > 0 or widest >= 1.5 * recipe.cell_m:
        raise ConfigError(
            f"robot radius {widest:.3g} m: must be above 0 and below 1.5 cells, and a cell "
            f"(cell_m) is {recipe.cell_m} m"
        )
    if recipe.placement == "given":
        largest_m = radius.reshape(-1, n_robot).max(axis=0)
        check_positions(recipe, largest_m, by_end_effector=by_end_effector, held=held)


def require_valid(environment: Environment, first_index: int = 0) -> None:
    """Refuse a batch in which no world can hold its fleet.

    Raises:
        ConfigError: all worlds reached the redraw limit.
    """
    valid = np.asarray(environment.valid)
    if not valid.any():
        n_robot = environment.start_m.shape[-2]
        raise ConfigError(
            f"none of the worlds {first_index} to {first_index + valid.size - 1} holds the fleet "
            f"of {n_robot} robots, each after {int(np.max(environment.redraws))} redraws; take "
            "fewer or smaller robots, a larger shape, a lower density or another placement"
        )


@partial(jax.jit, static_argnames="recipe")
def _generate_batch(
    recipe: WorldRecipe,
    numbers: WorldNumbers,
    radius_m: jax.Array,
    seed: jax.Array,
    first_index: jax.Array,
    water_density_kgm3: jax.Array,
) -> Environment:
    index = jnp.uint32(first_index) + jnp.arange(radius_m.shape[0], dtype=jnp.uint32)
    root = seed_key(jnp.uint32(seed))

    def generate_one(i: jax.Array, radius: jax.Array) -> Environment:
        key = jax.random.fold_in(root, i)
        return generate_world(recipe, numbers, radius, key, water_density_kgm3)

    return jax.vmap(generate_one)(index, radius_m)
