"""Currents of worlds in the sizes of programs, and in their true ones.

Programs sample and fly padded currents (`angler_mjx.world.currents.padding`), so that worlds with
another number of vortices or knots have the same ones. Worlds outside of programs have no padding.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax
from jax.sharding import Mesh, NamedSharding

from angler_mjx.runs.simulator.devices import SHARDED
from angler_mjx.runs.simulator.sampling_numbers import SamplingNumbers
from angler_mjx.sim.state import World
from angler_mjx.world.currents import Current, component_sizes, cut_current, pad_knots


class CurrentPadding:
    """Conversion of the currents of a simulator's worlds."""

    def __init__(self, true: SamplingNumbers, padded: SamplingNumbers, mesh: Mesh) -> None:
        """Build the conversions; they are compiled when first used.

        Args:
            true: numbers of the scenario.
            padded: numbers that its programs take.
            mesh: devices of the worlds.
        """
        self._sizes = component_sizes(true.world.currents)
        self._is_needed = self._sizes != component_sizes(padded.world.currents)
        sharding = NamedSharding(mesh, SHARDED)
        self._pad = jax.jit(pad_knots, out_shardings=sharding)
        self._cut = jax.jit(cut_current, static_argnames="sizes", out_shardings=sharding)
        self._last: tuple[list[jax.Array], Current] | None = None

    def cut(self, worlds: World) -> World:
        """Return sampled worlds with currents of true sizes; any axes lead."""
        if not self._is_needed:
            return worlds
        return _replace_current(worlds, self._cut(worlds.environment.current, sizes=self._sizes))

    def pad(self, worlds: World) -> World:
        """Return worlds for programs of flights; the currents of the call before are kept."""
        if not self._is_needed:
            return worlds
        current = worlds.environment.current
        leaves = jax.tree.leaves(current)
        if self._last is not None and _are_same(self._last[0], leaves):
            return _replace_current(worlds, self._last[1])
        padded = self._pad(current)
        if not any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
            self._last = leaves, padded
        return _replace_current(worlds, padded)


def cut_worlds(worlds: World, sizes: Sequence[int | None]) -> World:
    """Return sampled worlds with currents of other sizes; see `currents.cut_current`."""
    return _replace_current(worlds, cut_current(worlds.environment.current, sizes))


def pad_worlds(worlds: World) -> World:
    """Return worlds with currents as programs of flights take them."""
    return _replace_current(worlds, pad_knots(worlds.environment.current))


def _replace_current(worlds: World, current: Current) -> World:
    return replace(worlds, environment=replace(worlds.environment, current=current))


def _are_same(first: list[jax.Array], second: list[jax.Array]) -> bool:
    """Return whether two lists hold the same objects."""
    return len(first) == len(second) and all(a is b for a, b in zip(first, second, strict=True))
