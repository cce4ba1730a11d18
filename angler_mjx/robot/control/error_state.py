"""The mathematics of the navigation filter: covariance in time, and through measurements.

The error state [19] is dp, dv (in W), dtheta (a rotation in W: R_true = exp(dtheta) R), dbg, dba,
and what does not change: offset of the depth, bias of the heading, hard iron (two); true minus
believed. Covariances stay exactly symmetric: every product that makes them is.
Written with elementwise products, so that it runs on lanes, and in full float32 on GPUs.
"""

import jax
import jax.numpy as jnp

from angler_kernels.rigid_body import matrix_times

N_STATE = 19
P, V, THETA, GYRO_BIAS, ACCEL_BIAS = (slice(i, i + 3) for i in range(0, 15, 3))
DEPTH, HEADING, IRON = slice(15, 16), slice(16, 17), slice(17, 19)
PARTS = (P, V, THETA, GYRO_BIAS, ACCEL_BIAS, DEPTH, HEADING, IRON)
"""Places of the error state's parts."""


def skew(v: jax.Array) -> jax.Array:
    """Matrix [3, 3] that does to a vector what the cross product with v [3] does."""
    zero = jnp.zeros_like(v[0])
    return jnp.stack(
        [
            jnp.stack([zero, -v[2], v[1]]),
            jnp.stack([v[2], zero, -v[0]]),
            jnp.stack([-v[1], v[0], zero]),
        ]
    )


def build_rows(*blocks: tuple[slice, jax.Array]) -> jax.Array:
    """A matrix [m, 19] of what there is of it, by the parts of the error state; else zero."""
    count, dtype = blocks[0][1].shape[0], blocks[0][1].dtype
    columns_by_start = {part.start: columns for part, columns in blocks}
    zero = [jnp.zeros((count, part.stop - part.start), dtype) for part in PARTS]
    columns = [columns_by_start.get(part.start, z) for part, z in zip(PARTS, zero, strict=True)]
    return jnp.concatenate(columns, axis=1)


def propagate_covariance(
    covariance: jax.Array, rotation: jax.Array, force: jax.Array, dt: jax.Array
) -> jax.Array:
    """Covariance F P F^T [19, 19] after one period, without process noise.

    dv' = dv - dt [f]x dtheta - dt R dba, dp' = dp + dt (dv + dv') / 2, dtheta' = dtheta - dt R dbg.

    Args:
        covariance: [19, 19], symmetric.
        rotation: [3, 3] R, F to W, at mid-step.
        force: [3] specific force in W, m/s^2.
        dt: [] s.
    """
    of_attitude, of_bias = -dt * skew(force), -dt * rotation

    def move(x: jax.Array) -> jax.Array:
        v, theta, gyro_bias = x[V], x[THETA], x[GYRO_BIAS]
        faster = v + multiply_3x3(of_attitude, theta) + multiply_3x3(of_bias, x[ACCEL_BIAS])
        return jnp.concatenate(
            [
                x[P] + 0.5 * dt * (v + faster),
                faster,
                theta + multiply_3x3(of_bias, gyro_bias),
                x[9:],
            ]
        )

    return make_symmetric(move(move(covariance).T))


def add_noise(
    covariance: jax.Array,
    gyro_std: jax.Array,
    accel_std: jax.Array,
    gyro_walk_std: jax.Array,
    accel_walk_std: jax.Array,
    dt: jax.Array,
) -> jax.Array:
    """Add what the IMU's noise does in one period; [] standard deviations of one step.

    White acceleration gives velocity variance s^2 dt^2, position a third of that times dt^2 and
    half of it times dt between them (continuous noise, integrated).
    """
    speed = (accel_std * dt) ** 2
    diagonal = jnp.stack(
        [speed * dt**2 / 3.0] * 3
        + [speed] * 3
        + [(gyro_std * dt) ** 2] * 3
        + [gyro_walk_std**2] * 3
        + [accel_walk_std**2] * 3
        + [jnp.zeros_like(speed)] * 4
    )
    between = 0.5 * dt * speed
    both = jnp.eye(N_STATE, k=3, dtype=covariance.dtype) + jnp.eye(
        N_STATE, k=-3, dtype=covariance.dtype
    )
    kinematic = (jnp.arange(N_STATE) < 6).astype(covariance.dtype)
    return (
        covariance
        + jnp.eye(N_STATE, dtype=covariance.dtype) * diagonal
        + between * (both * kinematic[:, None] * kinematic)
    )


def fuse_measurement(
    covariance: jax.Array,
    error: jax.Array,
    rows: jax.Array,
    residual: jax.Array,
    variance: jax.Array,
    gate: jax.Array | float,
    fresh: jax.Array,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Take in a measurement of m uncorrelated components, one after the other, if it is plausible.

    With s_i = h_i P h_i^T + r_i: error += P h_i^T (y_i - h_i error) / s_i and
    P -= (P h_i^T) (P h_i^T)^T / s_i. The sum of (y_i - h_i error)^2 / s_i on the way is y^T S^-1 y
    of the whole measurement, the innovation squared in units of its covariance; beyond ``gate``
    everything stays as it was.

    Args:
        covariance: [19, 19].
        error: [19] correction so far, from measurements of the same moment.
        rows: [m, 19] H.
        residual: [m] measured minus believed, before any correction.
        variance: [m] r.
        gate: bound for the squared innovation, a quantile of chi-square with m degrees.
        fresh: bool [] whether there is a measurement.

    Returns:
        Covariance and correction, and bool [] whether it was taken in.
    """
    after, moved, square = covariance, error, jnp.zeros_like(covariance[0, 0])
    for i in range(rows.shape[0]):
        gain = matrix_times(after, rows[i])
        s = jnp.sum(rows[i] * gain) + variance[i]
        innovation = residual[i] - jnp.sum(rows[i] * moved)
        square = square + innovation * innovation / s
        moved = moved + gain * (innovation / s)
        after = after - gain[:, None] * gain * (1.0 / s)
    taken = fresh & (square <= gate)
    return jnp.where(taken, after, covariance), jnp.where(taken, moved, error), taken


def make_symmetric(matrix: jax.Array) -> jax.Array:
    """The symmetric part of a matrix [n, n]."""
    return 0.5 * (matrix + matrix.T)


def multiply_3x3(a: jax.Array, b: jax.Array) -> jax.Array:
    """Product of [3, 3] and [3, n], elementwise."""
    return a[:, 0, None] * b[0] + a[:, 1, None] * b[1] + a[:, 2, None] * b[2]
