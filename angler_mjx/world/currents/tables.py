"""Tables of files for currents, and the sampling of their components for one world.

A table returns a sampler: a pytree of its numbers, so that programs take them as arguments.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Literal, Self

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import Field, model_validator

from angler_kernels.current_field import lamb_oseen_circulation
from angler_mjx.files import FileModel
from angler_mjx.host_arrays import as_leaf, as_numbers
from angler_mjx.quantities import Speed
from angler_mjx.sampling import UniformRange, fold_keys, uniform_rows
from angler_mjx.world.currents.fields import GaussMarkov, Uniform, Vortices

type Span = tuple[float, float]
type SpeedSpan = tuple[Speed, Speed]
type Vector = tuple[Speed, Speed, Speed]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class UniformSampler:
    """Numbers of a `UniformConfig`; see `CurrentSampler`."""

    velocity_mps: jax.Array
    """[3] in W."""

    def sample(self, key: jax.Array, lo: jax.Array, hi: jax.Array) -> Uniform:
        """Return the current as configured, without sampling."""
        return Uniform(velocity_mps=jnp.asarray(self.velocity_mps, lo.dtype))


class UniformConfig(FileModel):
    """The same uniform steady velocity in every world."""

    type: Literal["uniform"] = "uniform"
    velocity_mps: Vector
    """East, north, up."""

    def sampler(self, horizon_s: float) -> UniformSampler:
        """Return the sampler of a run."""
        return UniformSampler(velocity_mps=as_numbers(self.velocity_mps))


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class GaussMarkovSampler:
    """Numbers of a `GaussMarkovConfig`; see `CurrentSampler`."""

    capacity: int = field(metadata={"static": True})
    """Knots in the array."""
    count: jax.Array
    """int32 [] knots that exist, from t = 0 to past the horizon; the others repeat the last one."""
    knot_dt_s: jax.Array
    """[]."""
    std_mps: jax.Array
    """[3] standard deviation before clipping."""
    mean_mps: jax.Array
    """[3]."""
    max_speed_mps: jax.Array
    """[]."""
    memory: jax.Array
    """[] factor of a knot on the next one."""
    innovation: jax.Array
    """[] factor of the noise between them."""

    def sample(self, key: jax.Array, lo: jax.Array, hi: jax.Array) -> GaussMarkov:
        """Sample the knots."""
        noise = self.std_mps * jax.random.normal(key, (self.capacity, 3), lo.dtype)

        def advance(v: jax.Array, xi: jax.Array) -> tuple[jax.Array, jax.Array]:
            v = self.memory * v + self.innovation * xi
            return v, v

        _, later = jax.lax.scan(advance, noise[0], noise[1:])
        knots = self.mean_mps + jnp.concatenate([noise[:1], later])
        speed = jnp.sqrt(jnp.sum(knots * knots, axis=1, keepdims=True))
        knots = knots * (self.max_speed_mps / jnp.maximum(speed, self.max_speed_mps))
        exists = jnp.arange(self.capacity)[:, None] < self.count
        knots = jnp.where(exists, knots, knots[self.count - 1])
        return GaussMarkov(knots_mps=knots, knot_dt_s=jnp.asarray(self.knot_dt_s, lo.dtype))


class GaussMarkovConfig(FileModel):
    """A random velocity about a mean: an Ornstein-Uhlenbeck process, clipped in speed.

    At the knots it is discretised exactly (v_k+1 - m = rho (v_k - m) + std sqrt(1 - rho^2) xi,
    rho = exp(-knot_dt / time_constant)) and starts in its stationary distribution.
    """

    renamed_keys: ClassVar[Mapping[str, str]] = {
        "vertical_share": "vertical_fraction",
    }

    type: Literal["gauss_markov"] = "gauss_markov"
    max_speed_mps: Annotated[Speed, Field(gt=0)]
    """Max speed; the speed of faster knots is reduced to it."""
    std_mps: Annotated[Speed, Field(gt=0)] | None = None
    """Standard deviation per horizontal axis before clipping; max_speed_mps / 2.5 if left out, so
    that about one knot in twenty is clipped."""
    mean_mps: Vector = (0.0, 0.0, 0.0)
    """East, north, up."""
    time_constant_s: float = Field(default=60.0, gt=0, le=1e6)
    """Time constant of the process."""
    vertical_fraction: float = Field(default=0.1, ge=0, le=1)
    """Standard deviation of the vertical velocity over that of the horizontal one."""
    knot_dt_s: float = Field(default=5.0, ge=0.01, le=86400)
    """Time between knots; a run has 100,000 of them at most."""

    @model_validator(mode="after")
    def _check_mean(self) -> Self:
        if math.hypot(*self.mean_mps) > self.max_speed_mps:
            raise ValueError(f"mean_mps is faster than max_speed_mps = {self.max_speed_mps}")
        return self

    def sampler(self, horizon_s: float) -> GaussMarkovSampler:
        """Return the sampler of knots from t = 0 to past ``horizon_s``."""
        std = self.max_speed_mps / 2.5 if self.std_mps is None else self.std_mps
        rho = math.exp(-self.knot_dt_s / self.time_constant_s)
        n_knot = max(2, math.ceil(horizon_s / self.knot_dt_s) + 1)
        return GaussMarkovSampler(
            capacity=n_knot,
            count=as_leaf(np.int32(n_knot)),
            knot_dt_s=as_numbers(self.knot_dt_s),
            std_mps=as_numbers([std, std, std * self.vertical_fraction]),
            mean_mps=as_numbers(self.mean_mps),
            max_speed_mps=as_numbers(self.max_speed_mps),
            memory=as_numbers(rho),
            innovation=as_numbers(math.sqrt(1.0 - rho * rho)),
        )


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class VorticesSampler:
    """Numbers of a `VorticesConfig`; see `CurrentSampler`."""

    capacity: int = field(metadata={"static": True})
    """Vortices in the arrays."""
    count: jax.Array
    """int32 [] vortices that exist; the others have no circulation."""
    peak_speed_mps: UniformRange
    core_radius_m: UniformRange

    def sample(self, key: jax.Array, lo: jax.Array, hi: jax.Array) -> Vortices:
        """Sample positions uniformly in the region seen from above."""
        n = self.capacity
        where, speed_u, radius_u, direction_u = uniform_rows(fold_keys(key, 4), 2 * n, lo.dtype)
        peak = self.peak_speed_mps.scale(speed_u[:n])
        core = self.core_radius_m.scale(radius_u[:n])
        sign = jnp.where(direction_u[:n] < 0.5, 1.0, -1.0)
        centre = lo[:2] + where.reshape(n, 2) * (hi[:2] - lo[:2])
        exists = jnp.arange(n) < self.count
        return Vortices(
            centre_m=jnp.where(exists[:, None], centre, 0.0),
            circulation_m2ps=jnp.where(exists, sign * lamb_oseen_circulation(peak, core), 0.0),
            core_m=jnp.where(exists, core, 1.0),
        )


class VorticesConfig(FileModel):
    """Lamb-Oseen vortices at random positions of the region, with random sense of rotation."""

    type: Literal["vortices"] = "vortices"
    count: int = Field(ge=1, le=1000)
    """Number of vortices."""
    peak_speed_mps: SpeedSpan
    """Min and max of a vortex's peak speed; sampled uniformly."""
    core_radius_m: Span = (1.0, 3.0)
    """Min and max core radius a; at least 1 m: the flow then varies little over a hull."""

    @model_validator(mode="after")
    def _check_spans(self) -> Self:
        if not 0 <= self.peak_speed_mps[0] <= self.peak_speed_mps[1]:
            raise ValueError(f"peak_speed_mps = {self.peak_speed_mps}: needs 0 <= low <= high")
        if not 1.0 <= self.core_radius_m[0] <= self.core_radius_m[1]:
            raise ValueError(f"core_radius_m = {self.core_radius_m}: needs 1 <= low <= high")
        return self

    def sampler(self, horizon_s: float) -> VorticesSampler:
        """Return the sampler of a run."""
        return VorticesSampler(
            capacity=self.count,
            count=as_leaf(np.int32(self.count)),
            peak_speed_mps=UniformRange.between(*self.peak_speed_mps),
            core_radius_m=UniformRange.between(*self.core_radius_m),
        )
