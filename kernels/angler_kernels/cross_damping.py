"""Damping between the axes of a body: what a diagonal of linear and quadratic damping leaves out.

The wrench of the water [6] at a velocity nu_r [6] through it, in the body frame::

    tau_i = - sum_j (L_ij + Q_ij |nu_j|) nu_j + sum_(j <= k) P_i,jk nu_j nu_k

L and Q are the linear and the quadratic damping off their diagonals (Fossen, Handbook of Marine
Craft Hydrodynamics and Motion Control, 2nd ed. 2021, section 6.4); P are the derivatives of the
lift of a hull, Y_uv and its like (Prestero, MSc thesis, MIT and WHOI 2001, section 4.3).
"""

import jax
import jax.numpy as jnp

from angler_kernels.rigid_body import matrix_times

PRODUCT_PAIRS = tuple((j, k) for j in range(6) for k in range(j, 6))
"""The 21 pairs (j, k) of velocities, in the order of the columns of P."""


def cross_wrench(L: jax.Array, Q: jax.Array, P: jax.Array, nu_r: jax.Array) -> jax.Array:
    """Compute the wrench of damping between axes.

    Args:
        L: [6, 6] linear damping, N s/m and so on.
        Q: [6, 6] quadratic damping, by column times |nu_j| nu_j.
        P: [6, 21] wrench per product of two velocities, by `PRODUCT_PAIRS`.
        nu_r: [6] velocity through the water.

    Returns:
        Wrench [6].
    """
    products = jnp.stack([nu_r[j] * nu_r[k] for j, k in PRODUCT_PAIRS])
    drag = matrix_times(L, nu_r) + matrix_times(Q, jnp.abs(nu_r) * nu_r)
    return matrix_times(P, products) - drag


def cross_slope(L: jax.Array, Q: jax.Array, P: jax.Array, nu_r: jax.Array) -> jax.Array:
    """Compute minus the derivative of `cross_wrench` by nu_r, which is not symmetric.

    Args:
        L: [6, 6] linear damping.
        Q: [6, 6] quadratic damping.
        P: [6, 21] wrench per product of two velocities.
        nu_r: [6] velocity through the water.

    Returns:
        Slope [6, 6].
    """
    by_product = [jnp.zeros_like(nu_r)] * 6
    for column, (j, k) in enumerate(PRODUCT_PAIRS):
        by_product[j] = by_product[j] + P[:, column] * nu_r[k]
        by_product[k] = by_product[k] + P[:, column] * nu_r[j]
    return L + 2.0 * Q * jnp.abs(nu_r)[None, :] - jnp.stack(by_product, axis=1)


def solve_general(matrix: jax.Array, rhs: jax.Array) -> jax.Array:
    """Solve ``matrix @ x = rhs`` by Gauss's elimination, written out.

    Without exchange of rows: for matrices whose symmetric part is positive definite, such as an
    inertia with the slope of a damping that takes energy.

    Args:
        matrix: [n, n].
        rhs: [n].

    Returns:
        x [n].
    """
    n = matrix.shape[0]
    rows = [[matrix[i, j] for j in range(n)] for i in range(n)]
    right = [rhs[i] for i in range(n)]
    for k in range(n):
        inverse = 1.0 / rows[k][k]
        for i in range(k + 1, n):
            factor = rows[i][k] * inverse
            right[i] = right[i] - factor * right[k]
            for j in range(k + 1, n):
                rows[i][j] = rows[i][j] - factor * rows[k][j]
    x: list[jax.Array] = [jnp.zeros_like(rhs[0])] * n
    for i in reversed(range(n)):
        value = right[i]
        for j in range(i + 1, n):
            value = value - rows[i][j] * x[j]
        x[i] = value / rows[i][i]
    return jnp.stack(x)
