"""Worlds from their indices: drawn, furnished and planned."""

import operator
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels.clearance import cell_neighbours
from angler_mjx.draws import children
from angler_mjx.errors import ConfigError, shown
from angler_mjx.planning import grid as grid_planner
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim import fleet
from angler_mjx.sim.state import World
from angler_mjx.world import generate
from angler_mjx.world.config import WorldRecipe, resolve

AT_ONCE = 4096
"""Worlds drawn and planned in one go. 16,384 at once were a tenth faster on an H200, but took 209 s
to compile instead of 39 s, and memory grows with the planner's history."""

type Prepare = Callable[[fleet.Fleet, jax.Array, jax.Array], World]
"""Worlds [tile] of a fleet, from the seed [] and the first world's index [1], both uint32."""


def key_number(name: str, value: Any) -> np.uint32:
    """A seed or an index of a world, as keys take it.

    Args:
        name: for messages.
        value: any whole number, of Python or NumPy.

    Raises:
        ConfigError: it is none, or keys cannot hold it.
    """
    try:
        number = operator.index(value)
    except TypeError:
        number = -1
    if not 0 <= number < 2**32:
        raise ConfigError(f"{name} = {shown(value)}: give a whole number from 0 to {2**32 - 1}")
    return np.uint32(number)


def preparer(scenario: Scenario, tile: int, *, policy: bool = False) -> Prepare:
    """The function that makes a tile of worlds.

    Args:
        scenario: whose worlds.
        tile: how many at once.
        policy: whether a policy is to command them, which needs a key in each.
    """
    planner = grid_planner.GridPlannerConfig(
        horizon_s=scenario.time.horizon_s, margin_m=scenario.planner.margin_m
    )
    recipe = resolve(scenario.world)

    def prepare(kinds: fleet.Fleet, seed: jax.Array, first: jax.Array) -> World:
        one = partial(_one_world, scenario, recipe, planner, policy, kinds, seed)
        if tile == 1:  # batching a single world makes tracing and compiling take twice as long
            alone: World = jax.tree.map(lambda leaf: leaf[None], one(first[0]))
            return alone
        index = first[0] + jnp.arange(tile, dtype=jnp.uint32)
        if tile <= AT_ONCE:
            return jax.vmap(one)(index)
        worlds: World = jax.lax.map(one, index, batch_size=AT_ONCE)
        return worlds

    return prepare


def _one_world(
    scenario: Scenario,
    recipe: WorldRecipe,
    planner: grid_planner.GridPlannerConfig,
    policy: bool,
    kinds: fleet.Fleet,
    seed: jax.Array,
    index: jax.Array,
) -> World:
    """World ``index`` of a run: its key is the run's, folded with the global index."""
    key = jax.random.fold_in(jax.random.key(seed), index)
    of_fleet, of_world, of_senses, of_policy = children(key, 4)
    variant, control, body = fleet.draw(kinds, of_fleet)
    environment = generate.generate(
        recipe,
        fleet.radius_bound(kinds),
        of_world,
        scenario.time.horizon_s,
        scenario.water.density_kgpm3,
    )
    path = grid_planner.plan(
        environment, control.vehicle.radius_m, control.cruise_speed_mps, planner
    )
    # Folded with the robot's number, so that a robot more changes nothing for those before it.
    of_robot = children(of_senses, variant.shape[0])
    looked_up = scenario.engine == "fused"
    return World(
        environment=environment,
        variant=variant,
        body=body,
        control=control,
        path=path,
        cell_neighbours=cell_neighbours(environment.grid.occupied) if looked_up else None,
        sensing_key=jax.random.key_data(of_robot) if scenario.senses else None,
        policy_key=jax.random.key_data(of_policy) if policy else None,
    )
