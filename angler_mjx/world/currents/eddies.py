"""Tables of files for Rankine vortices and the double gyre, with closed-form flows."""

import math
from dataclasses import dataclass, field
from typing import Annotated, Literal, Self

import jax
import jax.numpy as jnp
from pydantic import Field, model_validator

from angler_kernels.current_field import double_gyre_stream
from angler_mjx.files import FileModel
from angler_mjx.host_arrays import as_numbers
from angler_mjx.quantities import Speed
from angler_mjx.sampling import UniformRange, fold_keys, uniform_rows
from angler_mjx.world.currents.fields import DoubleGyre, Rankine

type PositionXY = tuple[
    Annotated[float, Field(ge=-1e6, le=1e6)], Annotated[float, Field(ge=-1e6, le=1e6)]
]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class RankineSampler:
    """Numbers of a `RankineConfig`; see `CurrentSampler`."""

    count: int = field(metadata={"static": True})
    centre_m: jax.Array | None
    """[count, 2] given positions; None for sampled ones."""
    left_probability: jax.Array
    """[] probability of an anticlockwise vortex."""
    peak_speed_mps: UniformRange
    core_radius_m: UniformRange

    def sample(self, key: jax.Array, lo: jax.Array, hi: jax.Array) -> Rankine:
        """Sample positions uniformly in the region seen from above, unless given."""
        n = self.count
        where, speed_u, radius_u, direction_u = uniform_rows(fold_keys(key, 4), 2 * n, lo.dtype)
        peak = self.peak_speed_mps.scale(speed_u[:n])
        core = self.core_radius_m.scale(radius_u[:n])
        sign = jnp.where(direction_u[:n] < self.left_probability, 1.0, -1.0)
        if self.centre_m is None:
            centre = lo[:2] + where.reshape(n, 2) * (hi[:2] - lo[:2])
        else:
            centre = jnp.asarray(self.centre_m, lo.dtype)
        return Rankine(
            centre_m=centre, circulation_m2ps=sign * 2.0 * math.pi * core * peak, core_m=core
        )


class RankineConfig(FileModel):
    """Rankine vortices: cores in solid-body rotation, free vortices around them."""

    type: Literal["rankine"] = "rankine"
    count: Annotated[int, Field(ge=1, le=1000)] | None = None
    """Number of vortices at random positions of the region; left out where centre_m is given."""
    centre_m: Annotated[tuple[PositionXY, ...], Field(min_length=1, max_length=1000)] | None = None
    """East and north of each axis; random positions of the region if left out."""
    turning: Literal["either", "anticlockwise", "clockwise"] = "either"
    """Sense of rotation, seen from above; either is sampled for each vortex."""
    peak_speed_mps: tuple[Speed, Speed]
    """Min and max of a vortex's peak speed, at the rim of its core; sampled uniformly."""
    core_radius_m: tuple[float, float] = (1.0, 3.0)
    """Min and max core radius a; at least 1 m: the flow then varies little over a hull."""

    @model_validator(mode="after")
    def _check_spans(self) -> Self:
        if not 0 <= self.peak_speed_mps[0] <= self.peak_speed_mps[1]:
            raise ValueError(f"peak_speed_mps = {self.peak_speed_mps}: needs 0 <= low <= high")
        low, high = self.core_radius_m
        if not (1.0 <= low <= high and high <= 1e6):
            raise ValueError(f"core_radius_m = {self.core_radius_m}: needs 1 <= low <= high <= 1e6")
        return self

    @model_validator(mode="after")
    def _check_count(self) -> Self:
        if self.centre_m is None and self.count is None:
            raise ValueError("count is missing: give it, or the places of the axes in centre_m")
        if self.centre_m is not None and self.count not in (None, len(self.centre_m)):
            raise ValueError(
                f"count = {self.count}, but centre_m has {len(self.centre_m)} places; "
                "leave count out"
            )
        return self

    def sampler(self, horizon_s: float) -> RankineSampler:
        """Return the sampler of a run."""
        left = {"anticlockwise": 1.0, "clockwise": 0.0, "either": 0.5}[self.turning]
        return RankineSampler(
            count=len(self.centre_m) if self.centre_m is not None else self.count or 0,
            centre_m=None if self.centre_m is None else as_numbers(self.centre_m),
            left_probability=as_numbers(left),
            peak_speed_mps=UniformRange.between(*self.peak_speed_mps),
            core_radius_m=UniformRange.between(*self.core_radius_m),
        )


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class DoubleGyreSampler:
    """Numbers of a `DoubleGyreConfig`; see `CurrentSampler`."""

    peak_speed_mps: jax.Array
    """[]."""
    epsilon: jax.Array
    """[]."""
    period_s: jax.Array
    """[]."""

    def sample(self, key: jax.Array, lo: jax.Array, hi: jax.Array) -> DoubleGyre:
        """Return the flow as configured, without sampling."""
        extent = hi[:2] - lo[:2]
        return DoubleGyre(
            lo_m=lo[:2],
            extent_m=extent,
            stream_m2ps=double_gyre_stream(jnp.asarray(self.peak_speed_mps, lo.dtype), extent),
            epsilon=jnp.asarray(self.epsilon, lo.dtype),
            period_s=jnp.asarray(self.period_s, lo.dtype),
        )


class DoubleGyreConfig(FileModel):
    """Two gyres that fill the region seen from above; the wall between them sways east and west.

    No water crosses the region's sides. Beyond them the formula continues, with growing speed.
    """

    type: Literal["double_gyre"] = "double_gyre"
    peak_speed_mps: Annotated[Speed, Field(gt=0)]
    """Max speed in the region if epsilon is 0; (1 + 2 epsilon) times it is never exceeded."""
    epsilon: float = Field(default=0.0, ge=0, lt=0.5)
    """Amplitude of the sway of the wall between the gyres; 0 is a steady flow."""
    period_s: float = Field(default=60.0, ge=0.1, le=1e6)
    """Period of the sway."""

    def sampler(self, horizon_s: float) -> DoubleGyreSampler:
        """Return the sampler of a run."""
        return DoubleGyreSampler(
            peak_speed_mps=as_numbers(self.peak_speed_mps),
            epsilon=as_numbers(self.epsilon),
            period_s=as_numbers(self.period_s),
        )
