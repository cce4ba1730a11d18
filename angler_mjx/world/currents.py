"""Water currents: a tuple of components, each a velocity field v(p, t) with its derivatives.

A current is the sum of its components; the material derivative is taken of the sum, because it is
not additive. A new kind of current is one class with a ``flow`` method, and one config with a
``draw`` method for files. The vortices stand still and keep their strength: the field is given, not
solved for. All fields here are free of divergence.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, Protocol, Self

import jax
import jax.numpy as jnp
from pydantic import Field, model_validator

from angler_kernels.current_field import (
    lamb_oseen,
    lamb_oseen_circulation,
    material_derivative,
    smooth_knots,
)
from angler_mjx.draws import between, children, uniforms
from angler_mjx.files import FileModel
from angler_mjx.quantities import Speed

type Flow = tuple[jax.Array, jax.Array, jax.Array]
"""Velocity [3], its rate at the fixed point [3], its Jacobian [3, 3] (dv_i / dx_j); in W."""


class Component(Protocol):
    """One kind of current: a pytree that knows its flow at a point and time."""

    def flow(self, p: jax.Array, t: jax.Array) -> Flow:
        """Velocity, its rate and its Jacobian at p [3] m and t [] s, in W."""
        ...


type Current = tuple[Component, ...]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Uniform:
    """The same steady velocity everywhere."""

    velocity_mps: jax.Array
    """[3] in W."""

    def flow(self, p: jax.Array, t: jax.Array) -> Flow:
        """See `Component.flow`."""
        zero = jnp.zeros_like(self.velocity_mps)
        return self.velocity_mps, zero, jnp.zeros((3, 3), zero.dtype)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class GaussMarkov:
    """The same velocity everywhere, wandering in time; smooth between knots."""

    knots_mps: jax.Array
    """[n_knot, 3] velocity at t = 0, knot_dt_s, 2 knot_dt_s ...; in W; held after the last."""
    knot_dt_s: jax.Array
    """[] time between knots."""

    def flow(self, p: jax.Array, t: jax.Array) -> Flow:
        """See `Component.flow`."""
        return smooth_knots(t, self.knots_mps, self.knot_dt_s)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Vortices:
    """Lamb-Oseen vortices with vertical axes, steady."""

    centre_m: jax.Array
    """[n, 2] x and y of each axis, in W."""
    circulation_m2ps: jax.Array
    """[n] circulation far away, positive anticlockwise seen from above."""
    core_m: jax.Array
    """[n] core radius a of exp(-r^2/a^2)."""

    def flow(self, p: jax.Array, t: jax.Array) -> Flow:
        """See `Component.flow`."""
        return lamb_oseen(p, self.centre_m, self.circulation_m2ps, self.core_m)


def evaluate(current: Current, p: jax.Array, t: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Velocity of the water and its material derivative at a point.

    Args:
        current: of one world; empty for still water.
        p: [3] m, W.
        t: [] s.

    Returns:
        v [3] m/s and Dv/Dt = dv/dt + (v . grad) v [3] m/s^2, both in W.
    """
    if not current:
        return jnp.zeros_like(p), jnp.zeros_like(p)
    flows = [component.flow(p, t) for component in current]
    v, v_t, J = (sum(parts[1:], start=parts[0]) for parts in zip(*flows, strict=True))
    return v, material_derivative(v, v_t, J)


def velocity(current: Current, p: jax.Array, t: jax.Array) -> jax.Array:
    """Velocity [3] of the water at a point, m/s, W (see `evaluate`)."""
    return evaluate(current, p, t)[0]


type Span = tuple[float, float]
type SpeedSpan = tuple[Speed, Speed]
type Vector = tuple[Speed, Speed, Speed]


class UniformConfig(FileModel):
    """The same steady velocity in every world."""

    type: Literal["uniform"] = "uniform"
    velocity_mps: Vector
    """East, north, up."""

    def draw(self, key: jax.Array, lo: jax.Array, hi: jax.Array, horizon_s: float) -> Uniform:
        """Nothing is drawn."""
        return Uniform(velocity_mps=jnp.array(self.velocity_mps, lo.dtype))


class GaussMarkovConfig(FileModel):
    """A velocity that wanders about a mean: an Ornstein-Uhlenbeck process, clipped in speed.

    At the knots it is discretised exactly (v_k+1 - m = rho (v_k - m) + std sqrt(1 - rho^2) xi,
    rho = exp(-knot_dt / time_constant)) and starts in its stationary distribution.
    """

    type: Literal["gauss_markov"] = "gauss_markov"
    max_speed_mps: Annotated[Speed, Field(gt=0)]
    """Faster knots are shortened to this speed, so it is never exceeded."""
    std_mps: Annotated[Speed, Field(gt=0)] | None = None
    """Standard deviation per horizontal axis before clipping; max_speed_mps / 2.5 if left out, so
    that about one knot in twenty is clipped."""
    mean_mps: Vector = (0.0, 0.0, 0.0)
    """East, north, up."""
    time_constant_s: float = Field(default=60.0, gt=0, le=1e6)
    """Of the process's memory."""
    vertical_share: float = Field(default=0.1, ge=0, le=1)
    """Standard deviation of the vertical velocity over the horizontal one's."""
    knot_dt_s: float = Field(default=5.0, ge=0.01, le=86400)
    """Time between knots; a run has 100,000 of them at most."""

    @model_validator(mode="after")
    def _mean_below_maximum(self) -> Self:
        if math.hypot(*self.mean_mps) > self.max_speed_mps:
            raise ValueError(f"mean_mps is faster than max_speed_mps = {self.max_speed_mps}")
        return self

    def draw(self, key: jax.Array, lo: jax.Array, hi: jax.Array, horizon_s: float) -> GaussMarkov:
        """Knots from t = 0 to past ``horizon_s``."""
        n_knot = max(2, math.ceil(horizon_s / self.knot_dt_s) + 1)
        std = self.max_speed_mps / 2.5 if self.std_mps is None else self.std_mps
        rho = math.exp(-self.knot_dt_s / self.time_constant_s)
        scale = jnp.array([std, std, std * self.vertical_share], lo.dtype)
        noise = scale * jax.random.normal(key, (n_knot, 3), lo.dtype)

        def advance(v: jax.Array, xi: jax.Array) -> tuple[jax.Array, jax.Array]:
            v = rho * v + math.sqrt(1.0 - rho * rho) * xi
            return v, v

        _, later = jax.lax.scan(advance, noise[0], noise[1:])
        knots = jnp.array(self.mean_mps, lo.dtype) + jnp.concatenate([noise[:1], later])
        speed = jnp.sqrt(jnp.sum(knots * knots, axis=1, keepdims=True))
        knots = knots * (self.max_speed_mps / jnp.maximum(speed, self.max_speed_mps))
        return GaussMarkov(knots_mps=knots, knot_dt_s=jnp.array(self.knot_dt_s, lo.dtype))


class VorticesConfig(FileModel):
    """Lamb-Oseen vortices at random places of the region, turning either way."""

    type: Literal["vortices"] = "vortices"
    count: int = Field(ge=1, le=1000)
    """Number of vortices."""
    peak_speed_mps: SpeedSpan
    """Lowest and highest greatest speed of a vortex; drawn uniformly."""
    core_radius_m: Span = (1.0, 3.0)
    """Lowest and highest core radius a; at least 1 m: the flow then varies little over a hull."""

    @model_validator(mode="after")
    def _spans(self) -> Self:
        if not 0 <= self.peak_speed_mps[0] <= self.peak_speed_mps[1]:
            raise ValueError(f"peak_speed_mps = {self.peak_speed_mps}: needs 0 <= low <= high")
        if not 1.0 <= self.core_radius_m[0] <= self.core_radius_m[1]:
            raise ValueError(f"core_radius_m = {self.core_radius_m}: needs 1 <= low <= high")
        return self

    def draw(self, key: jax.Array, lo: jax.Array, hi: jax.Array, horizon_s: float) -> Vortices:
        """Places uniform in the region seen from above."""
        n = self.count
        where, how_fast, how_wide, which_way = uniforms(children(key, 4), 2 * n, lo.dtype)
        peak = between(how_fast[:n], *self.peak_speed_mps)
        core = between(how_wide[:n], *self.core_radius_m)
        sign = jnp.where(which_way[:n] < 0.5, 1.0, -1.0)
        return Vortices(
            centre_m=lo[:2] + where.reshape(n, 2) * (hi[:2] - lo[:2]),
            circulation_m2ps=sign * lamb_oseen_circulation(peak, core),
            core_m=core,
        )


type CurrentConfig = Annotated[
    UniformConfig | GaussMarkovConfig | VorticesConfig, Field(discriminator="type")
]


def draw(
    configs: Sequence[UniformConfig | GaussMarkovConfig | VorticesConfig],
    key: jax.Array,
    region_lo: jax.Array,
    region_hi: jax.Array,
    horizon_s: float,
) -> Current:
    """The current of one world.

    Args:
        configs: one per component.
        key: random key of this world's current.
        region_lo: [3] lower corner of the region where vortices stand, m, W.
        region_hi: [3] upper corner.
        horizon_s: the time that the current has to cover; a Python number, it sets array sizes.
    """
    lo, hi = jnp.asarray(region_lo, float), jnp.asarray(region_hi, float)
    keys = children(key, len(configs)) if configs else ()
    return tuple(
        config.draw(one, lo, hi, horizon_s) for config, one in zip(configs, keys, strict=True)
    )
