"""Buoyancy of a hull of several bodies, each of which leaves the water by itself.

Under water the bodies bear as one volume at their common centre. At the surface body i of a
fraction f_i of the volume, at r_i with height h_i, is wet by s_i = clip(1/2 - z_i / h_i, 0, 1), and
the hull bears::

    [rho g V sum_i f_i s_i k; sum_i f_i s_i r_i x rho g V k],   k: upward, in F

A wall-sided body of waterplane A_i has V_i = A_i h_i: this is the restoring by waterplanes, rho g
sum A_i in heave and rho g sum A_i y_i^2 in roll, of bodies that are narrow beside their distances
(Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd ed. 2021, section 4.2).
The moments of waterplanes about the bodies' centres are left out: rho g A b^2 / 12 of a body of
breadth b. Split long bodies into several.
"""

import jax
import jax.numpy as jnp

from angler_kernels.quaternion import rotate_inverse, world_up
from angler_kernels.rigid_body import submerged_fraction


def split_buoyancy(
    *,
    fraction: jax.Array,
    offset: jax.Array,
    heights: jax.Array,
    p_cb: jax.Array,
    height: jax.Array,
    z: jax.Array,
    q: jax.Array,
    Dv_c: jax.Array,
    displaced: jax.Array,
    gravity: jax.Array | float,
) -> jax.Array:
    """Return what several bodies change of the wrench of one at their centre; 0 under water.

    Args:
        fraction: [n] of the volume.
        offset: [n, 3] from the centre of buoyancy, m, in F.
        heights: [n] over which the buoyancy of each fades, m.
        p_cb: [3] centre of buoyancy from the origin, m, in F.
        height: [] of the one body, m.
        z: [] height of the origin above the surface, m, in W.
        q: [4] attitude.
        Dv_c: [3] material derivative of the flow, m/s^2, in W.
        displaced: [] rho V, fully submerged, kg.
        gravity: [] m/s^2.

    Returns:
        Wrench [6] at the origin, in F.
    """
    up = world_up(q)
    points = p_cb + offset
    wet = fraction * submerged_fraction(z + jnp.sum(up * points, axis=1), heights)
    whole = submerged_fraction(z + jnp.sum(up * p_cb), height)
    lift = displaced * gravity * up
    part = jnp.sum(wet) - whole
    lever = jnp.sum(wet[:, None] * points, axis=0) - whole * p_cb
    force = part * (lift + displaced * rotate_inverse(q, Dv_c))
    return jnp.concatenate([force, jnp.cross(lever, lift)])
