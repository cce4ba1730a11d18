"""Water currents: a tuple of components, each a velocity field v(p, t) with its derivatives.

A current is the sum of its components; the material derivative is taken of the sum, because it is
not additive. A new kind of current is one class with a ``flow`` method in `fields`, and one config
with a ``sampler`` method for files, in `tables`, `eddies`, `sea` or `gridded`.
"""

from collections.abc import Sequence
from typing import Annotated

import jax
import jax.numpy as jnp
from pydantic import Field

from angler_mjx.sampling import fold_keys
from angler_mjx.world.currents.eddies import DoubleGyreConfig, RankineConfig
from angler_mjx.world.currents.fields import (
    Component,
    Current,
    CurrentSampler,
    DepthProfile,
    DoubleGyre,
    Flow,
    GaussMarkov,
    Rankine,
    Tide,
    Uniform,
    Vortices,
    evaluate_current,
    scale_current,
    velocities_at,
    velocity,
)
from angler_mjx.world.currents.gridded import GridConfig, Gridded, bind_fields, list_fields
from angler_mjx.world.currents.padding import (
    component_sizes,
    cut_current,
    flight_sizes,
    pad_knots,
    pad_samplers,
)
from angler_mjx.world.currents.sea import DepthProfileConfig, TideConfig
from angler_mjx.world.currents.tables import GaussMarkovConfig, UniformConfig, VorticesConfig

__all__ = [
    "Component",
    "Current",
    "CurrentConfig",
    "CurrentSampler",
    "DepthProfile",
    "DepthProfileConfig",
    "DoubleGyre",
    "DoubleGyreConfig",
    "Flow",
    "GaussMarkov",
    "GaussMarkovConfig",
    "GridConfig",
    "Gridded",
    "Rankine",
    "RankineConfig",
    "Tide",
    "TideConfig",
    "Uniform",
    "UniformConfig",
    "Vortices",
    "VorticesConfig",
    "bind_fields",
    "build_samplers",
    "component_sizes",
    "cut_current",
    "evaluate_current",
    "flight_sizes",
    "list_fields",
    "pad_knots",
    "pad_samplers",
    "sample_current",
    "scale_current",
    "velocities_at",
    "velocity",
]

AnyConfig = (
    UniformConfig
    | GaussMarkovConfig
    | VorticesConfig
    | RankineConfig
    | DoubleGyreConfig
    | DepthProfileConfig
    | TideConfig
    | GridConfig
)
type CurrentConfig = Annotated[AnyConfig, Field(discriminator="type")]


def build_samplers(configs: Sequence[AnyConfig], horizon_s: float) -> tuple[CurrentSampler, ...]:
    """Return the samplers of a current (host side).

    Args:
        configs: one per component.
        horizon_s: time that the current covers; it sets array sizes.
    """
    return tuple(config.sampler(horizon_s) for config in configs)


def sample_current(
    samplers: Sequence[CurrentSampler],
    key: jax.Array,
    region_lo: jax.Array,
    region_hi: jax.Array,
) -> Current:
    """Sample the current of a world.

    Args:
        samplers: one per component, of `build_samplers`.
        key: random key of this world's current.
        region_lo: [3] lower corner of the region of vortices, m, W.
        region_hi: [3] upper corner.
    """
    lo, hi = jnp.asarray(region_lo, float), jnp.asarray(region_hi, float)
    keys = fold_keys(key, len(samplers)) if samplers else ()
    return tuple(
        sampler.sample(component_key, lo, hi)
        for sampler, component_key in zip(samplers, keys, strict=True)
    )
