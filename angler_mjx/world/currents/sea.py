"""Tables of files for open-sea currents: depth profiles, and tidal constituents."""

import math
from dataclasses import dataclass
from typing import Annotated, Literal, Self

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import Field, model_validator

from angler_kernels.current_field import monotone_slopes
from angler_mjx.errors import format_value
from angler_mjx.files import FileModel
from angler_mjx.host_arrays import as_numbers
from angler_mjx.quantities import Length, Speed
from angler_mjx.sampling import UniformRange, fold_keys, uniform_rows
from angler_mjx.world.currents.fields import DepthProfile, Tide

type Level = tuple[Speed, Speed]

CONSTITUENTS = {
    "M2": 28.9841042,
    "S2": 30.0,
    "N2": 28.4397295,
    "K2": 30.0821373,
    "L2": 29.5284789,
    "T2": 29.9589333,
    "MU2": 27.9682084,
    "NU2": 28.5125831,
    "2N2": 27.8953548,
    "K1": 15.0410686,
    "O1": 13.9430356,
    "P1": 14.9589314,
    "Q1": 13.3986609,
    "S1": 15.0,
    "J1": 15.5854433,
    "OO1": 16.1391017,
    "M3": 43.4761563,
    "MK3": 44.0251729,
    "M4": 57.9682084,
    "MN4": 57.4238337,
    "MS4": 58.9841042,
    "S4": 60.0,
    "M6": 86.9523127,
    "S6": 90.0,
    "M8": 115.9364166,
    "MF": 1.0980331,
    "MM": 0.5443747,
}
"""Speeds of tidal constituents in degrees an hour, as in NOAA's tables of harmonic constituents;
from Schureman, Manual of Harmonic Analysis and Prediction of Tides, US Coast and Geodetic Survey
Special Publication 98, 1940 (1958), table 2."""

FORTNIGHT_S = 1_275_721.0
"""Period of spring tides: 360 degrees over the difference of the speeds of S2 and M2."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class SampledKnots:
    """Numbers of sampled knots of a depth profile."""

    speed_mps: UniformRange
    max_turn_rad: jax.Array
    """[] max change of direction between neighbours."""

    def sample(self, key: jax.Array, like: jax.Array) -> jax.Array:
        """Sample east and north velocity [n, 2] of knots, from the surface down.

        Args:
            key: random key of the current.
            like: [n], of the knots' number and type.
        """
        speed_u, heading_u = uniform_rows(fold_keys(key, 2), like.shape[0], like.dtype)
        speed = self.speed_mps.scale(speed_u)
        turn = self.max_turn_rad * (2.0 * heading_u - 1.0)
        heading = jnp.cumsum(turn.at[0].set(2.0 * math.pi * heading_u[0]))
        return speed[:, None] * jnp.stack([jnp.cos(heading), jnp.sin(heading)], axis=1)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class DepthProfileSampler:
    """Numbers of a `DepthProfileConfig`; see `CurrentSampler`."""

    depth_m: jax.Array
    """[n]."""
    knots: jax.Array | SampledKnots
    """[n, 2] given velocities, or the numbers of sampled ones."""

    def sample(self, key: jax.Array, lo: jax.Array, hi: jax.Array) -> DepthProfile:
        """Return given knots, or sample them from the surface down."""
        depth, knots = jnp.asarray(self.depth_m, lo.dtype), self.knots
        if isinstance(knots, SampledKnots):
            knots = knots.sample(key, depth)
        knots = jnp.asarray(knots, lo.dtype)
        return DepthProfile(
            depth_m=depth, knots_mps=knots, slopes_1ps=monotone_slopes(depth, knots)
        )


class DepthProfileConfig(FileModel):
    """A horizontal velocity that depends on depth only: knots, and a smooth curve through them."""

    type: Literal["depth_profile"] = "depth_profile"
    depth_m: Annotated[tuple[Length, ...], Field(min_length=2, max_length=64)]
    """Depths of the knots below the surface, increasing. The velocity is held above and below
    them."""
    velocity_mps: Annotated[tuple[Level, ...], Field(min_length=2, max_length=64)] | None = None
    """East and north velocity at each knot; sampled if left out."""
    speed_mps: tuple[Speed, Speed] | None = None
    """Min and max speed of a knot, sampled uniformly for each; instead of velocity_mps."""
    turn_deg: float | None = Field(default=None, ge=0, le=180)
    """For sampled knots: max change of direction between neighbours, 30 if left out; the first
    direction is random."""

    @model_validator(mode="after")
    def _check_knots(self) -> Self:
        if any(a >= b for a, b in zip(self.depth_m, self.depth_m[1:], strict=False)):
            raise ValueError(
                f"depth_m = {format_value(list(self.depth_m))}: each must be below the last"
            )
        if (self.velocity_mps is None) == (self.speed_mps is None):
            raise ValueError("give either velocity_mps or speed_mps")
        if self.velocity_mps is not None:
            if len(self.velocity_mps) != len(self.depth_m):
                raise ValueError(
                    f"velocity_mps has {len(self.velocity_mps)} knots and depth_m "
                    f"{len(self.depth_m)}: needs one each"
                )
            if self.turn_deg is not None:
                raise ValueError("turn_deg has no meaning where velocity_mps is given")
        if self.speed_mps is not None and not 0 <= self.speed_mps[0] <= self.speed_mps[1]:
            raise ValueError(f"speed_mps = {list(self.speed_mps)}: needs 0 <= low <= high")
        return self

    def sampler(self, horizon_s: float) -> DepthProfileSampler:
        """Return the sampler of a run."""
        knots: jax.Array | SampledKnots
        if self.speed_mps is None:
            knots = as_numbers(self.velocity_mps or ())
        else:
            max_turn_deg = 30.0 if self.turn_deg is None else self.turn_deg
            knots = SampledKnots(
                speed_mps=UniformRange.between(*self.speed_mps),
                max_turn_rad=as_numbers(math.radians(max_turn_deg)),
            )
        return DepthProfileSampler(depth_m=as_numbers(self.depth_m), knots=knots)


class ConstituentConfig(FileModel):
    """A tidal constituent of a current: an ellipse traced by the velocity."""

    name: str
    """Name of the constituent, such as M2, S2 or K1; all names: `docs/how_to/ocean.md`."""
    major_mps: Annotated[Speed, Field(ge=0)]
    """Half of the ellipse's long axis: the max speed."""
    minor_mps: Speed = 0.0
    """Half of its short axis; positive for anticlockwise rotation seen from above, negative for
    clockwise, 0 for motion along a line."""
    inclination_deg: float = Field(default=0.0, ge=-360, le=360)
    """Direction of the long axis, anticlockwise from east."""
    phase_deg: float = Field(default=0.0, ge=-360, le=360)
    """Phase lag: the phase after time 0 at which the velocity points along the long axis."""

    @model_validator(mode="after")
    def _check_constituent(self) -> Self:
        if self.name not in CONSTITUENTS:
            raise ValueError(
                f"name = {format_value(self.name)}: no constituent whose speed is known; there is "
                f"{', '.join(CONSTITUENTS)}"
            )
        if abs(self.minor_mps) > self.major_mps:
            raise ValueError(
                f"minor_mps = {self.minor_mps:g}: at most major_mps = {self.major_mps:g} in size"
            )
        return self


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class TideSampler:
    """Numbers of a `TideConfig`; see `CurrentSampler`. [n] constituents."""

    speed_radps: jax.Array
    """[n]."""
    early_phase_rad: jax.Array
    """[n] phase at the earliest start, without whole turns."""
    phase_span_rad: jax.Array
    """[n] phase from the earliest to the latest start."""
    cosine_mps: jax.Array
    """[n, 2] half axis."""
    sine_mps: jax.Array
    """[n, 2] half axis."""

    def sample(self, key: jax.Array, lo: jax.Array, hi: jax.Array) -> Tide:
        """Sample the start time of the flight, as phases at its start."""
        elapsed_phase = jax.random.uniform(key, (), lo.dtype) * self.phase_span_rad
        return Tide(
            speed_radps=jnp.asarray(self.speed_radps, lo.dtype),
            phase_rad=jnp.mod(self.early_phase_rad + elapsed_phase, 2.0 * math.pi),
            cosine_mps=jnp.asarray(self.cosine_mps, lo.dtype),
            sine_mps=jnp.asarray(self.sine_mps, lo.dtype),
        )


class TideConfig(FileModel):
    """Tidal constituents, uniform in a world; each world has its own start time."""

    type: Literal["tide"] = "tide"
    constituents: Annotated[tuple[ConstituentConfig, ...], Field(min_length=1, max_length=64)]
    """The constituents; the velocity is their sum."""
    start_s: tuple[float, float] = (0.0, FORTNIGHT_S)
    """Earliest and latest time of a flight's start, sampled uniformly; from one spring tide to the
    next if left out."""

    @model_validator(mode="after")
    def _check_unique(self) -> Self:
        names = [constituent.name for constituent in self.constituents]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise ValueError(f"constituents: {twice} is there twice; give it once")
        low, high = self.start_s
        if not 0.0 <= low <= high <= 1e9:
            raise ValueError(f"start_s = {list(self.start_s)}: needs 0 <= low <= high <= 1e9")
        return self

    def sampler(self, horizon_s: float) -> TideSampler:
        """Return the sampler of a run."""
        speed, lag, cosine, sine = self.ellipses()
        low, high = self.start_s
        # Float32 has seven digits for the sampled fraction, none for a phase after years; so whole
        # turns up to the earliest start are removed first.
        return TideSampler(
            speed_radps=as_numbers(speed),
            early_phase_rad=as_numbers(np.mod(speed * low - lag, 2.0 * math.pi)),
            phase_span_rad=as_numbers(speed * (high - low)),
            cosine_mps=as_numbers(cosine),
            sine_mps=as_numbers(sine),
        )

    def ellipses(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return speeds [n] rad/s, lags [n] rad, and both half axes [n, 2] m/s, in float64.

        With the long axis at an angle a from east, u + i v = exp(i a) (major cos(w t - g) +
        i minor sin(w t - g)) (Pawlowicz, Beardsley & Lentz, Computers & Geosciences 28, 2002).
        """
        table = np.array(
            [
                (
                    math.radians(CONSTITUENTS[constituent.name]) / 3600.0,
                    math.radians(constituent.phase_deg),
                    math.radians(constituent.inclination_deg),
                    constituent.major_mps,
                    constituent.minor_mps,
                )
                for constituent in self.constituents
            ]
        )
        speed, lag, angle, major, minor = table.T
        along = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        across = np.stack([-np.sin(angle), np.cos(angle)], axis=1)
        return speed, lag, major[:, None] * along, minor[:, None] * across
