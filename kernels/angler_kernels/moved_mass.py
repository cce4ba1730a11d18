"""Ballast and moving masses of a body: what they change of its inertia, and the wrench of that.

A vehicle that is described with its tanks half full and its masses in the middle has, with ``dm_i``
kg more water in tank i at r_i and with mass m_k moved by s_k along a_k from r_k::

    dm = sum_i dm_i
    h  = sum_i dm_i r_i + sum_k m_k s_k a_k
    dI = sum_i dm_i J(r_i) + sum_k m_k (J(r_k + s_k a_k) - J(r_k)),  J(r) = |r|^2 1 - r r^T
    dM = [[dm 1, -S(h)], [S(h), dI]]

about the origin, which stays the centre of mass of the vehicle as described. The wrench of weight
and of the Coriolis and centripetal forces of dM is added to that of the body (Leonard and Graver,
Model-based feedback control of autonomous underwater gliders, IEEE J. Oceanic Eng. 26(4), 2001;
Graver, PhD thesis, Princeton 2005, chapter 4; Fossen, Handbook of Marine Craft Hydrodynamics and
Motion Control, 2nd ed. 2021, sections 3.3 and 4.5)::

    [dm g; h x g] - [omega x P; omega x L + v x P],   [P; L] = dM nu

The shift is quasi-static: forces by the speed of the masses against the body, m (s'' a + 2 s' omega
x a), and the momentum of water that is taken in, dm' nu, are left out. For a servo of rate r and
lag T they are at most m (r / T + 2 |omega| r) and rho |dV'| |nu|.
"""

import jax
import jax.numpy as jnp

from angler_kernels.quaternion import world_up
from angler_kernels.rigid_body import matrix_times


def point_inertia(r: jax.Array) -> jax.Array:
    """Return |r|^2 1 - r r^T [n, 3, 3] of points r [n, 3]: inertia about the origin per mass."""
    square = jnp.sum(r * r, axis=1)
    return square[:, None, None] * jnp.eye(3, dtype=r.dtype) - r[:, :, None] * r[:, None, :]


def mass_change(
    *,
    position: jax.Array,
    axis: jax.Array,
    mass: jax.Array,
    water: jax.Array,
    value: jax.Array,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Compute what tanks and moving masses [n] change of a body's inertia about its origin.

    Args:
        position: [n, 3] of the tank, or of the mass in the middle, m.
        axis: [n, 3] unit vector along which the mass moves; 0 of tanks.
        mass: [n] kg that move; 0 of tanks.
        water: [n] kg per unit of ``value`` that a tank takes in; 0 of masses.
        value: [n] water of tanks, m^3, and position of masses along the axis, m.

    Returns:
        dm [] kg, h [3] kg m and dI [3, 3] kg m^2.
    """
    taken = water * value
    moved = position + value[:, None] * axis
    change = point_inertia(moved) - point_inertia(position)
    inertia = taken[:, None, None] * point_inertia(position) + mass[:, None, None] * change
    first = taken[:, None] * position + (mass * value)[:, None] * axis
    return jnp.sum(taken), jnp.sum(first, axis=0), jnp.sum(inertia, axis=0)


def inertia_matrix(dm: jax.Array, h: jax.Array, dI: jax.Array) -> jax.Array:
    """Return dM [6, 6] of dm [], h [3] and dI [3, 3]."""
    zero = jnp.zeros_like(dm)
    cross = jnp.stack(
        [
            jnp.stack([zero, -h[2], h[1]]),
            jnp.stack([h[2], zero, -h[0]]),
            jnp.stack([-h[1], h[0], zero]),
        ]
    )
    upper = jnp.concatenate([dm * jnp.eye(3, dtype=h.dtype), -cross], axis=1)
    return jnp.concatenate([upper, jnp.concatenate([cross, dI], axis=1)], axis=0)


def moved_mass_wrench(
    dM: jax.Array, dm: jax.Array, h: jax.Array, q: jax.Array, nu: jax.Array, gravity: float
) -> jax.Array:
    """Return the wrench [6] of weight and Coriolis forces of dM [6, 6] at q [4] and nu [6]."""
    down = -gravity * world_up(q)
    momentum = matrix_times(dM, nu)
    linear, angular = momentum[:3], momentum[3:]
    v, omega = nu[:3], nu[3:]
    coriolis = jnp.concatenate(
        [jnp.cross(omega, linear), jnp.cross(omega, angular) + jnp.cross(v, linear)]
    )
    return jnp.concatenate([dm * down, jnp.cross(h, down)]) - coriolis
