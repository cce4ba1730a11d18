"""Water currents: a tuple of components, each a velocity field v(p, t) with its derivatives.

A current is the sum of its components; the material derivative is taken of the sum, because it is
not additive. A new kind of current is one class with a ``flow`` method in `fields`, and one config
with a ``sample`` method for files, in `tables`, `eddies`, `sea` or `gridded`.
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
    velocity,
)
from angler_mjx.world.currents.gridded import GridConfig, Gridded, bind_fields, list_fields
from angler_mjx.world.currents.sea import DepthProfileConfig, TideConfig
from angler_mjx.world.currents.tables import GaussMarkovConfig, UniformConfig, VorticesConfig

__all__ = [
    "Component",
    "Current",
    "CurrentConfig",
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
    "evaluate_current",
    "list_fields",
    "sample_current",
    "scale_current",
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


def sample_current(
    configs: Sequence[AnyConfig],
    key: jax.Array,
    region_lo: jax.Array,
    region_hi: jax.Array,
    horizon_s: float,
) -> Current:
    """Sample the current of a world.

    Args:
        configs: one per component.
        key: random key of this world's current.
        region_lo: [3] lower corner of the region of vortices, m, W.
        region_hi: [3] upper corner.
        horizon_s: time that the current covers; a Python number, which sets array sizes.
    """
    lo, hi = jnp.asarray(region_lo, float), jnp.asarray(region_hi, float)
    keys = fold_keys(key, len(configs)) if configs else ()
    return tuple(
        config.sample(component_key, lo, hi, horizon_s)
        for config, component_key in zip(configs, keys, strict=True)
    )
