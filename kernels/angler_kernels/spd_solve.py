"""L D L^T solution of one small symmetric positive definite system, written out.

Batched library factorisations of 6x6 matrices cost a call each and move the matrix through memory;
the unrolled form fuses with its surroundings. The number of operations grows with n^3: meant for
n <= 12 (a vehicle with an arm).
"""

import jax
import jax.numpy as jnp


def solve(matrix: jax.Array, rhs: jax.Array) -> jax.Array:
    """Solve ``matrix @ x = rhs``.

    Args:
        matrix: [n, n] symmetric positive definite; the lower triangle is read.
        rhs: [n, k] right-hand sides.

    Returns:
        x [n, k].
    """
    n = matrix.shape[0]
    lower: list[list[jax.Array]] = []
    pivot: list[jax.Array] = []
    inverse: list[jax.Array] = []
    for i in range(n):
        row: list[jax.Array] = []
        for j in range(i):
            value = matrix[i, j]
            for k in range(j):
                value = value - row[k] * lower[j][k] * pivot[k]
            row.append(value * inverse[j])
        value = matrix[i, i]
        for k in range(i):
            value = value - row[k] * row[k] * pivot[k]
        lower.append(row)
        pivot.append(value)
        inverse.append(1.0 / value)
    forward: list[jax.Array] = []
    for i in range(n):
        value = rhs[i]
        for k in range(i):
            value = value - lower[i][k] * forward[k]
        forward.append(value)
    x: list[jax.Array] = [jnp.zeros_like(rhs[0])] * n
    for i in reversed(range(n)):
        value = forward[i] * inverse[i]
        for k in range(i + 1, n):
            value = value - lower[k][i] * x[k]
        x[i] = value
    return jnp.stack(x)
