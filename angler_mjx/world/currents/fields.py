"""Components of a current: velocity fields at a point and a time, with their derivatives.

Vortices and gyres do not move: the field is prescribed, not solved for. All components are
divergence-free.
"""

from dataclasses import dataclass, replace
from typing import Protocol, Self

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import current_field
from angler_kernels.current_field import (
    double_gyre,
    lamb_oseen_vortices,
    material_derivative,
    rankine_vortices,
    smooth_knots,
    tidal_current,
)

type Flow = tuple[jax.Array, jax.Array, jax.Array]
"""Velocity [3], its rate at the fixed point [3], its Jacobian [3, 3] (dv_i / dx_j); in W."""


class Component(Protocol):
    """Base of current components: a pytree with the flow at a point and time."""

    def flow(self, p: jax.Array, t: jax.Array) -> Flow:
        """Return velocity, its rate and its Jacobian at p [3] m and t [] s, in W."""
        ...

    def scaled(self, factor: jax.Array) -> Self:
        """Return the field scaled by ``factor`` [] in speed, at the same times."""
        ...


type Current = tuple[Component, ...]


class CurrentSampler(Protocol):
    """Base of samplers of components: a pytree of the numbers of a file's table.

    Programs take its leaves as arguments: another strength of a current needs no compilation.
    """

    def sample(self, key: jax.Array, lo: jax.Array, hi: jax.Array) -> Component:
        """Sample the component of one world.

        Args:
            key: random key of this component.
            lo: [3] lower corner of the region, m, W.
            hi: [3] upper corner.
        """
        ...


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Uniform:
    """A uniform steady velocity."""

    velocity_mps: jax.Array
    """[3] in W."""

    def flow(self, p: jax.Array, t: jax.Array) -> Flow:
        """See `Component.flow`."""
        zero = jnp.zeros_like(self.velocity_mps)
        return self.velocity_mps, zero, jnp.zeros((3, 3), zero.dtype)

    def scaled(self, factor: jax.Array) -> Self:
        """See `Component.scaled`."""
        return replace(self, velocity_mps=factor * self.velocity_mps)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class GaussMarkov:
    """A uniform velocity that varies randomly in time; smooth between knots."""

    knots_mps: jax.Array
    """[n_knot, 3] velocity at t = 0, knot_dt_s, 2 knot_dt_s ...; in W; held after the last."""
    knot_dt_s: jax.Array
    """[] time between knots."""

    def flow(self, p: jax.Array, t: jax.Array) -> Flow:
        """See `Component.flow`."""
        return smooth_knots(t, self.knots_mps, self.knot_dt_s)

    def scaled(self, factor: jax.Array) -> Self:
        """See `Component.scaled`."""
        return replace(self, knots_mps=factor * self.knots_mps)


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
        return lamb_oseen_vortices(p, self.centre_m, self.circulation_m2ps, self.core_m)

    def scaled(self, factor: jax.Array) -> Self:
        """See `Component.scaled`."""
        return replace(self, circulation_m2ps=factor * self.circulation_m2ps)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Rankine:
    """Rankine vortices with vertical axes, steady: solid cores in free vortices.

    The velocity is continuous; its Jacobian jumps at r = a, and so does the acceleration of water.
    """

    centre_m: jax.Array
    """[n, 2] x and y of each axis, in W."""
    circulation_m2ps: jax.Array
    """[n] circulation outside the core, positive anticlockwise seen from above."""
    core_m: jax.Array
    """[n] radius a of the core, where the water is fastest."""

    def flow(self, p: jax.Array, t: jax.Array) -> Flow:
        """See `Component.flow`."""
        return rankine_vortices(p, self.centre_m, self.circulation_m2ps, self.core_m)

    def scaled(self, factor: jax.Array) -> Self:
        """See `Component.scaled`."""
        return replace(self, circulation_m2ps=factor * self.circulation_m2ps)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class DoubleGyre:
    """Two gyres side by side in a rectangle, with a swaying wall; no vertical velocity."""

    lo_m: jax.Array
    """[2] lower corner of the rectangle, in W."""
    extent_m: jax.Array
    """[2] lengths of its sides along x and y."""
    stream_m2ps: jax.Array
    """[] max value of the stream function."""
    epsilon: jax.Array
    """[] amplitude of the sway of the wall between the gyres; 0 is steady."""
    period_s: jax.Array
    """[] period of the sway."""

    def flow(self, p: jax.Array, t: jax.Array) -> Flow:
        """See `Component.flow`."""
        return double_gyre(
            p, t, self.lo_m, self.extent_m, self.stream_m2ps, self.epsilon, self.period_s
        )

    def scaled(self, factor: jax.Array) -> Self:
        """See `Component.scaled`."""
        return replace(self, stream_m2ps=factor * self.stream_m2ps)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class DepthProfile:
    """A steady horizontal velocity that depends on depth only; smooth between knots."""

    depth_m: jax.Array
    """[n] depths of the knots below the surface, increasing."""
    knots_mps: jax.Array
    """[n, 2] velocity of the knots, east and north; held above the first and below the last."""
    slopes_1ps: jax.Array
    """[n, 2] derivatives of the knots with respect to depth."""

    def flow(self, p: jax.Array, t: jax.Array) -> Flow:
        """See `Component.flow`."""
        return current_field.depth_profile(p, self.depth_m, self.knots_mps, self.slopes_1ps)

    def scaled(self, factor: jax.Array) -> Self:
        """See `Component.scaled`."""
        return replace(self, knots_mps=factor * self.knots_mps, slopes_1ps=factor * self.slopes_1ps)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Tide:
    """Tidal constituents: a uniform horizontal velocity, the sum of rotating ellipses."""

    speed_radps: jax.Array
    """[n] rates of the phases."""
    phase_rad: jax.Array
    """[n] phases at t = 0; at phase 0 a constituent's velocity is ``cosine_mps``."""
    cosine_mps: jax.Array
    """[n, 2] half axis of the ellipse, east and north."""
    sine_mps: jax.Array
    """[n, 2] half axis a quarter turn later."""

    def flow(self, p: jax.Array, t: jax.Array) -> Flow:
        """See `Component.flow`."""
        return tidal_current(t, self.speed_radps, self.phase_rad, self.cosine_mps, self.sine_mps)

    def scaled(self, factor: jax.Array) -> Self:
        """See `Component.scaled`."""
        return replace(self, cosine_mps=factor * self.cosine_mps, sine_mps=factor * self.sine_mps)


def evaluate_current(current: Current, p: jax.Array, t: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the velocity of the water and its material derivative at a point.

    Args:
        current: current of one world; empty for still water.
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
    """Return the velocity [3] of the water at a point, m/s, W (see `evaluate_current`)."""
    return evaluate_current(current, p, t)[0]


def velocities_at(current: Current, points_m: np.ndarray, time_s: np.ndarray | float) -> np.ndarray:
    """Return velocities of the water [n, 3], m/s in W, on the host.

    Args:
        current: current of one world.
        points_m: [n, 3] points, W.
        time_s: [n] times, or one for all.
    """
    p = jnp.asarray(points_m, float)
    t = jnp.asarray(np.broadcast_to(time_s, len(points_m)), p.dtype)
    return np.asarray(_evaluate_velocities(current, p, t))


@jax.jit  # one program instead of fifty
def _evaluate_velocities(current: Current, p: jax.Array, t: jax.Array) -> jax.Array:
    return jax.vmap(velocity, (None, 0, 0))(current, p, t)


def scale_current(current: Current, factor: jax.Array) -> Current:
    """Return the current scaled by ``factor`` [] in speed, at the same times."""
    return tuple(component.scaled(factor) for component in current)
