"""Properties and states of obstacles: two pytrees of one world, [n] rows each.

Rows with ``exists = False`` are padding; their numbers are harmless but mean nothing.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp

from angler_kernels.clearance import BOX, CAPSULE, SPHERE

__all__ = [
    "BOX",
    "CAPSULE",
    "CIRCLE",
    "DRIFT",
    "SINE",
    "SPHERE",
    "STATIC",
    "STRAIGHT",
    "ObstacleState",
    "Obstacles",
    "bounding_radius",
]

STATIC, DRIFT, STRAIGHT, SINE, CIRCLE = 0, 1, 2, 3, 4


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Obstacles:
    """Properties of the obstacles of one world; [n] rows, constant during an episode."""

    kind: jax.Array
    """int32 [n]: 0 sphere, 1 box, 2 capsule."""
    size_m: jax.Array
    """[n, 3]: sphere (radius, 0, 0); box half extents; capsule (radius, half length of the axis,
    0), the axis along the body's z."""
    motion: jax.Array
    """int32 [n]: 0 static, 1 drifting, 2 straight, 3 sine, 4 circle."""
    path: jax.Array
    """[n, 8] parameters of scripted movers. Straight: [0:3] velocity, m/s, W. Sine: [0:3]
    amplitude, m, W. Circle: [0:3] arm from the centre at angle 0, m, W, and [5:8] unit axis, W.
    Sine and circle: [3] angular rate, rad/s, [4] angle at t = 0, rad. Unused columns are 0."""
    p0: jax.Array
    """[n, 3] centre at t = 0, m, W; for sine and circle the middle of the swing or circle."""
    q0: jax.Array
    """[n, 4] attitude at t = 0, wxyz, body to W; scripted and static obstacles keep it."""
    nu0: jax.Array
    """[n, 6] velocity at t = 0 of drifting obstacles relative to the water, [u v w p q r], body
    frame; zero: the obstacle starts with the water's velocity."""
    mass_kg: jax.Array
    """[n]."""
    inertia_kgm2: jax.Array
    """[n, 3] principal moments about the centre, body axes."""
    volume_m3: jax.Array
    """[n] displaced volume."""
    M_A: jax.Array
    """[n, 6] diagonal added mass, kg and kg m^2, positive."""
    D_l: jax.Array
    """[n, 6] linear drag, N s/m and N m s, positive."""
    D_q: jax.Array
    """[n, 6] quadratic drag, N s^2/m^2 and N m s^2, positive; it acts with the whole speed:
    force_i = -D_q_i |v_r| v_r_i, so that a sphere's drag does not depend on its attitude."""
    exists: jax.Array
    """bool [n]: False rows are padding: never touched, never seen."""
    kinds: tuple[int, ...] = field(metadata={"static": True})
    """The kinds that can occur, sorted, to avoid tracing code of others."""
    motions: tuple[int, ...] = field(metadata={"static": True})
    """The motions that can occur, sorted."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class ObstacleState:
    """State of the obstacles of one world."""

    p: jax.Array
    """[n, 3] centre, m, W."""
    q: jax.Array
    """[n, 4] attitude, wxyz, body to W."""
    nu: jax.Array
    """[n, 6] velocity [u v w p q r], m/s and rad/s, body frame (scripted movers too)."""
    nu_dot: jax.Array
    """[n, 6] smooth acceleration of the previous step, body frame (for the two-step scheme)."""


def bounding_radius(kind: jax.Array, size: jax.Array) -> jax.Array:
    """Return the bounding radius [] about the centre of an obstacle of ``size`` [3], m."""
    box = jnp.sqrt(jnp.sum(size * size))
    return jnp.where(kind == BOX, box, size[0] + jnp.where(kind == CAPSULE, size[1], 0.0))
