"""Bank of sampled worlds that replace ended episodes without compiling again."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.sim.state import EngineConstants, EngineState, World, WorldState


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class WorldBank:
    """[B] worlds and their initial states."""

    worlds: World
    initial_state: WorldState
    laid: EngineConstants
    """Constants as packed by `Engine.pack_constants`."""
    packed_state: EngineState
    """Initial states as packed by `Engine.pack_state`."""

    @property
    def count(self) -> int:
        """Return the number of worlds."""
        return int(self.initial_state.step.shape[0])


def sample_worlds(
    simulator: Simulator, count: int, *, first: int = 0, seed: int | None = None
) -> WorldBank:
    """Sample a bank of consecutive worlds.

    Args:
        simulator: with one device and no policy.
        count: number of worlds.
        first: global index of the first world.
        seed: seed; the scenario's if left out.

    Raises:
        ConfigError: count is no whole number above 0, or as `Simulator.worlds`.
    """
    if not isinstance(count, int) or isinstance(count, bool) or count < 1:
        raise ConfigError(f"bank = {count!r}: give a whole number of worlds above 0")
    tiles = [
        simulator.worlds(first + offset, seed=seed) for offset in range(0, count, simulator.tile)
    ]
    return build_bank(
        simulator, _concatenate(tiles, count), [simulator.reset(tile) for tile in tiles]
    )


def build_bank(simulator: Simulator, worlds: World, initial_states: list[WorldState]) -> WorldBank:
    """Build a bank of existing worlds and their states at t = 0, tile by tile."""
    count = worlds.variant.shape[0]
    adopted = to_default_device(simulator.adopt(worlds))
    lay_out = jax.jit(simulator.engine.pack_constants)
    laid = lay_out(to_default_device(simulator.fleet), adopted)
    initial_state = _concatenate(initial_states, count)
    packed_state = jax.jit(simulator.engine.pack_state)(initial_state)
    return WorldBank(
        worlds=adopted, initial_state=initial_state, laid=laid, packed_state=packed_state
    )


def to_default_device[T](tree: T) -> T:
    """Move arrays from the mesh of a simulator's devices to the default device."""
    moved: T = jax.tree.map(jnp.asarray, jax.device_get(tree))
    return moved


def _concatenate[T](tiles: list[T], count: int) -> T:
    """Return the first ``count`` worlds of tiles."""

    def join_leaves(*leaves: np.ndarray) -> jax.Array:
        return jnp.asarray(np.concatenate(leaves)[:count])

    joined: T = jax.tree.map(join_leaves, *map(jax.device_get, tiles))
    return joined
