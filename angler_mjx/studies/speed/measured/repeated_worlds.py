"""Worlds for the timing of simulations: drawn and planned once, then repeated to any number.

What a simulation costs does not depend on whether world 5,000 differs from world 904, and planning
a hundred thousand worlds takes longer than all that is to be timed. So at most ``MAX_DIFFERENT``
worlds are drawn, rows of the same scenario share them, and a row says how many there were.
"""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import NamedSharding

from angler_mjx.errors import RunError
from angler_mjx.runs.simulator import devices as on_devices
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.state import World

MAX_DIFFERENT = 1024
"""Different worlds at most: each kind of world and of way occurs, and a GPU's caches cannot hold
them (about 50 MB in the reef)."""


def sample_worlds(scenario: Scenario, count: int) -> World:
    """The first worlds of a scenario, drawn and planned on the first device.

    Args:
        scenario: whose worlds, furnished as its engine wants them.
        count: how many; ``MAX_DIFFERENT`` are drawn if it is larger.

    Returns:
        World, [min(count, MAX_DIFFERENT)] leading; the last one drawn is kept for the next call.

    Raises:
        RunError: some cannot hold the fleet.
    """
    return _sample_cached(scenario.model_dump_json(), min(count, MAX_DIFFERENT))


@lru_cache(maxsize=1)
def _sample_cached(scenario: str, count: int) -> World:
    simulator = Simulator(Scenario.model_validate_json(scenario), tile=count)
    worlds: World = jax.block_until_ready(simulator.worlds(0))
    if not np.asarray(worlds.environment.valid).all():
        raise RunError("some worlds cannot hold the fleet: no number is given; take fewer robots")
    return worlds


def repeat_worlds(sampled: World, tile: int, devices: int) -> World:
    """Worlds for one tile on each device: those that were drawn, over and over.

    Args:
        sampled: from `sample_worlds`.
        tile: worlds of each device.
        devices: number of them.
    """
    mesh = on_devices.build_mesh(devices)
    replicated = jax.device_put(sampled, NamedSharding(mesh, on_devices.REPLICATED))
    total = devices * tile

    def repeated(worlds: World) -> World:
        def repeat_leaf(leaf: jax.Array) -> jax.Array:
            return leaf[jnp.arange(total) % leaf.shape[0]]

        filled: World = jax.tree.map(repeat_leaf, worlds)
        return filled

    each = NamedSharding(mesh, on_devices.SHARDED)
    worlds: World = jax.jit(repeated, out_shardings=each)(replicated)
    return worlds


def repeated_shape(sampled: World, tile: int, devices: int) -> World:
    """Shapes, types and places of what `repeat_worlds` gives."""

    def repeat_leaf(leaf: jax.Array) -> jax.ShapeDtypeStruct:
        return jax.ShapeDtypeStruct((devices * tile, *leaf.shape[1:]), leaf.dtype)

    mesh = on_devices.build_mesh(devices)
    worlds: World = on_devices.with_sharding(
        jax.tree.map(repeat_leaf, sampled), mesh, on_devices.SHARDED
    )
    return worlds


def describe_worlds(sampled: World, total: int) -> str:
    """How many of ``total`` worlds are different, in words."""
    count = sampled.environment.valid.shape[0]
    if count >= total:
        return "all worlds different"
    return f"{count:,} different worlds, repeated"
