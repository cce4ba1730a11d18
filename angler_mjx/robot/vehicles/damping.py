"""Damping of a vehicle: the diagonal, and what couples axes where a vehicle has that.

Vehicles whose file holds diagonals alone have no `CrossDamping`, and programs without its terms.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import cross_damping, rigid_body
from angler_kernels.cross_damping import PRODUCT_PAIRS
from angler_mjx.robot.vehicles.config import Damping
from angler_mjx.robot.vehicles.derivatives import read_product


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class CrossDamping:
    """Damping between axes, in F; see `angler_kernels.cross_damping`."""

    linear: jax.Array
    """[6, 6] linear damping off the diagonal."""
    quadratic: jax.Array
    """[6, 6] quadratic damping off the diagonal, of |nu_j| nu_j."""
    products: jax.Array
    """[6, 21] wrench per product of two velocities, by `PRODUCT_PAIRS`."""


class DampedBody(Protocol):
    """Vehicle, as far as its damping goes."""

    @property
    def D_l(self) -> jax.Array:
        """[6] linear damping."""

    @property
    def D_q(self) -> jax.Array:
        """[6] quadratic damping."""

    @property
    def cross_damping(self) -> CrossDamping | None:
        """Damping between axes."""


def build_cross_damping(damping: Damping) -> CrossDamping | None:
    """Return what couples the axes of a vehicle; None where its damping is diagonal (host side)."""
    if not damping.couples_axes:
        return None
    dtype = jnp.result_type(float)
    products = np.zeros((6, len(PRODUCT_PAIRS)))
    for name, value in damping.products.items():
        products[read_product(name)] += value
    linear, quadratic = np.array(damping.linear_matrix), np.array(damping.quadratic_matrix)
    np.fill_diagonal(linear, 0.0)
    np.fill_diagonal(quadratic, 0.0)
    return CrossDamping(
        linear=jax.device_put(np.asarray(linear, dtype)),
        quadratic=jax.device_put(np.asarray(quadratic, dtype)),
        products=jax.device_put(np.asarray(products, dtype)),
    )


def pad_cross_damping(parts: Sequence[CrossDamping | None]) -> list[CrossDamping | None]:
    """Return the parts of the vehicles of a fleet, zero where one has none and another has."""
    first = next((part for part in parts if part is not None), None)
    if first is None:
        return list(parts)
    zero: CrossDamping = jax.tree.map(np.zeros_like, first)
    return [zero if part is None else part for part in parts]


def damping_wrench(vehicle: DampedBody, nu_r: jax.Array) -> jax.Array:
    """Return the wrench [6] of damping at a velocity nu_r [6] through the water, in F."""
    wrench = rigid_body.damping_wrench(vehicle.D_l, vehicle.D_q, nu_r)
    return wrench if vehicle.cross_damping is None else wrench + cross_wrench(vehicle, nu_r)


def cross_wrench(vehicle: DampedBody, nu_r: jax.Array) -> jax.Array:
    """Return the part [6] of `damping_wrench` that couples axes; zero without."""
    cross = vehicle.cross_damping
    if cross is None:
        return jnp.zeros_like(nu_r)
    return cross_damping.cross_wrench(cross.linear, cross.quadratic, cross.products, nu_r)


def damping_jacobian(vehicle: DampedBody, nu_r: jax.Array) -> jax.Array:
    """Return minus the derivative [6, 6] of `damping_wrench` by nu_r [6]."""
    diagonal = rigid_body.damping_slope(vehicle.D_l, vehicle.D_q, nu_r)
    slope = diagonal[:, None] * jnp.eye(6, dtype=nu_r.dtype)
    cross = vehicle.cross_damping
    if cross is None:
        return slope
    return slope + cross_damping.cross_slope(cross.linear, cross.quadratic, cross.products, nu_r)


def advance_coupled_velocity(
    vehicle: DampedBody,
    nu: jax.Array,
    nu_r: jax.Array,
    M: jax.Array,
    force: jax.Array,
    force_before: jax.Array,
    mean_thrust: jax.Array,
    dt: jax.Array | float,
) -> tuple[jax.Array, jax.Array]:
    """Advance the velocity as `rigid_body.advance_damped_velocity` does, with coupled axes.

    The slope of damping is not symmetric here, so each iteration of Newton's method is an
    elimination. Arguments and result are those of that function; ``force`` holds all of damping.
    """
    implicit = M + 0.5 * dt * damping_jacobian(vehicle, nu_r)
    impulse = (1.5 * dt) * force - (0.5 * dt) * force_before + dt * mean_thrust
    damping = damping_wrench(vehicle, nu_r)
    change = cross_damping.solve_general(implicit, impulse)
    missed = damping_wrench(vehicle, nu_r + change) - damping
    missed = missed + rigid_body.matrix_times(damping_jacobian(vehicle, nu_r), change)
    change = change + cross_damping.solve_general(implicit, 0.5 * dt * missed)
    return nu + change, force + damping_wrench(vehicle, nu_r + change) - damping


def largest_gain_w(damping: Damping, count: int = 20_000) -> float:
    """Return the largest power [W] that damping gives a vehicle in still water (host side).

    Of velocities [6] ahead (u >= 0) with m/s and rad/s on one sphere of radius 1, by samples: above
    zero, the damping of the file drives the vehicle somewhere, which no still water does.
    """
    rng = np.random.default_rng(0)
    nu = rng.normal(size=(count, 6))
    # Where few axes move is where a coupling shows best.
    nu = np.concatenate([nu, nu * (rng.random((count, 6)) < 0.4)])
    nu[:, 0] = np.abs(nu[:, 0])
    nu = nu[np.any(nu != 0.0, axis=1)]
    nu /= np.linalg.norm(nu, axis=1)[:, None]
    wrench = -nu @ np.array(damping.linear_matrix).T
    wrench -= (np.abs(nu) * nu) @ np.array(damping.quadratic_matrix).T
    pairs = np.stack([nu[:, j] * nu[:, k] for j, k in PRODUCT_PAIRS], axis=1)
    for name, value in damping.products.items():
        row, column = read_product(name)
        wrench[:, row] += value * pairs[:, column]
    return float(np.max(np.sum(wrench * nu, axis=1)))
