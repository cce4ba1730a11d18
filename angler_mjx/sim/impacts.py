"""Impacts of robots: how hard they hit what."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike

from angler_mjx.sim.cargo import CargoError
from angler_mjx.sim.physics.contact.grips import GripForces
from angler_mjx.sim.state import Touched


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Impacts:
    """Hardest impact of each robot [R] in a number of steps, and how it touched."""

    energy_j: jax.Array
    """[R] half the effective mass times the closing speed squared; 0 where nothing was hit."""
    closing_speed_mps: jax.Array
    """[R] normal speed of the surfaces towards each other at that impact."""
    touched: jax.Array
    """int32 [R] a `Touched`; NOTHING where nothing was touched."""
    touched_index: jax.Array
    """int32 [R] obstacle or robot; -1 otherwise."""
    depth_m: jax.Array
    """[R] greatest overlap, m."""
    force_n: jax.Array
    """[R] greatest normal force of a point of contact, N."""
    grips: GripForces | None = None
    """Greatest forces of the robots' grips; None where they hold nothing."""
    cargo: CargoError | None = None
    """[R] error of what they carry at the end of the steps; None likewise."""


def no_impacts(robots: int, dtype: DTypeLike, *, holds: bool = False) -> Impacts:
    """Return the impacts of robots that touched nothing; ``holds``: whether they hold a body."""
    zero, none = jnp.zeros(robots, dtype), jnp.zeros(robots, jnp.int32)
    return Impacts(
        energy_j=zero,
        closing_speed_mps=zero,
        touched=none,
        touched_index=none - 1,
        depth_m=zero,
        force_n=zero,
        grips=GripForces(force_n=zero, internal_n=zero, broke=none > 0) if holds else None,
    )


def add_impacts(so_far: Impacts, new: Impacts) -> Impacts:
    """Return the hardest impacts of both."""
    harder = new.energy_j > so_far.energy_j
    first = (so_far.touched == Touched.NOTHING) | harder
    chosen: Impacts = jax.tree.map(lambda a, b: jnp.where(first, a, b), new, so_far)
    return replace(
        chosen,
        energy_j=jnp.maximum(new.energy_j, so_far.energy_j),
        depth_m=jnp.maximum(new.depth_m, so_far.depth_m),
        force_n=jnp.maximum(new.force_n, so_far.force_n),
        grips=jax.tree.map(jnp.maximum, new.grips, so_far.grips),
    )
