"""L D L^T solution of one small symmetric positive definite system, written out.

Batched library factorisations of 6x6 matrices cost a call each and move the matrix through memory;
the unrolled form fuses with its surroundings. The number of operations grows with n^3: meant for
n <= 12 (a vehicle with an arm).
"""

from dataclasses import dataclass

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


@dataclass(frozen=True, kw_only=True)
class Eliminated:
    """A symmetric positive definite system with its first m unknowns eliminated.

    For systems that differ on the diagonal of the other k rows alone.
    """

    inverse: jax.Array
    """[m, m] inverse of the first block."""
    gain: jax.Array
    """[m, k] inverse of the first block times the block right of it."""
    remainder: jax.Array
    """[k, k] Schur complement: matrix of the other unknowns."""

    def solve(self, rhs: jax.Array, diagonal: jax.Array) -> jax.Array:
        """Solve (matrix + diag(0, diagonal)) x = rhs.

        Args:
            rhs: [m + k].
            diagonal: [k], >= 0.

        Returns:
            x [m + k].
        """
        m = self.inverse.shape[0]
        first = _times(self.inverse, rhs[:m])
        if not diagonal.size:
            return first
        reduced = rhs[m:] - _times(self.gain.T, rhs[:m])
        rest = solve(self.remainder + jnp.diag(diagonal), reduced[:, None])[:, 0]
        return jnp.concatenate([first - _times(self.gain, rest), rest])


def eliminate(matrix: jax.Array, m: int) -> Eliminated:
    """Eliminate the first ``m`` unknowns of a system.

    Args:
        matrix: [n, n] symmetric positive definite.
        m: number of unknowns.
    """
    border = matrix[:m, m:]
    right = jnp.concatenate([jnp.eye(m, dtype=matrix.dtype), border], axis=1)
    solved = solve(matrix[:m, :m], right)
    gain = solved[:, m:]
    taken = jnp.sum(border[:, :, None] * gain[:, None, :], axis=0)
    return Eliminated(inverse=solved[:, :m], gain=gain, remainder=matrix[m:, m:] - taken)


def _times(matrix: jax.Array, vector: jax.Array) -> jax.Array:
    """Return the product [m] of ``matrix`` [m, n] and ``vector`` [n], as products and sums."""
    return jnp.sum(matrix * vector[None, :], axis=1)
