"""Worlds drawn beforehand, from which ended episodes are replaced: nothing compiles again."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.sim.state import Laid, World, WorldState


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class WorldBank:
    """[B] worlds, and how each begins."""

    worlds: World
    begun: WorldState
    laid: Laid
    """See `Engine.lay_out`."""

    @property
    def count(self) -> int:
        """How many."""
        return int(self.begun.step.shape[0])

    def begin(self, rows: jax.Array) -> WorldState:
        """States at t = 0 of worlds ``rows`` int32 [W]."""
        state: WorldState = jax.tree.map(lambda leaf: leaf[rows], self.begun)
        return state


def draw(simulator: Simulator, count: int, *, first: int = 0, seed: int | None = None) -> WorldBank:
    """A bank of worlds first, first + 1 and on.

    Args:
        simulator: with one device and no policy.
        count: how many worlds.
        first: global index of the first.
        seed: instead of the scenario's.

    Raises:
        ConfigError: count is no whole number above 0, or as `Simulator.worlds`.
    """
    if not isinstance(count, int) or isinstance(count, bool) or count < 1:
        raise ConfigError(f"bank = {count!r}: give a whole number of worlds above 0")
    tiles = [
        simulator.worlds(first + begin, seed=seed) for begin in range(0, count, simulator.tile)
    ]
    return of(simulator, _joined(tiles, count), [simulator.reset(tile) for tile in tiles])


def of(simulator: Simulator, worlds: World, begun: list[WorldState]) -> WorldBank:
    """A bank of worlds that are there, and their states at t = 0 tile by tile."""
    count = worlds.variant.shape[0]
    kept = loose(simulator.admitted(worlds))
    lay_out = jax.jit(simulator.engine.lay_out)
    laid = lay_out(loose(simulator.fleet), kept)
    return WorldBank(worlds=kept, begun=_joined(begun, count), laid=laid)


def loose(tree: Any) -> Any:
    """Arrays that lie nowhere in particular: a simulator's belong to its devices' mesh."""
    return jax.tree.map(jnp.asarray, jax.device_get(tree))


def _joined(tiles: list[Any], count: int) -> Any:
    """The first ``count`` worlds of tiles."""

    def one(*leaves: np.ndarray) -> jax.Array:
        return jnp.asarray(np.concatenate(leaves)[:count])

    return jax.tree.map(one, *map(jax.device_get, tiles))
