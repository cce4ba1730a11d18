"""Quaternion algebra for one quaternion [4] (w, x, y, z); the batch is the caller's ``vmap``."""

import math

import jax
import jax.numpy as jnp


def multiply(a: jax.Array, b: jax.Array) -> jax.Array:
    """Return the Hamilton product [4] of two quaternions a [4] and b [4]."""
    aw, ax, ay, az = a[0], a[1], a[2], a[3]
    bw, bx, by, bz = b[0], b[1], b[2], b[3]
    return jnp.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ]
    )


def conjugate(q: jax.Array) -> jax.Array:
    """Return the inverse [4] of a unit quaternion q [4]."""
    return jnp.stack([q[0], -q[1], -q[2], -q[3]])


def rotate(q: jax.Array, v: jax.Array) -> jax.Array:
    """Rotate v [3] from the body frame to the world frame, [3]; q [4] rotates body to world."""
    w, u = q[0], q[1:]
    t = 2.0 * jnp.cross(u, v)
    return v + w * t + jnp.cross(u, t)


def rotate_inverse(q: jax.Array, v: jax.Array) -> jax.Array:
    """Rotate v [3] from the world frame to the body frame, [3]; q [4] rotates body to world."""
    return rotate(conjugate(q), v)


def world_up(q: jax.Array) -> jax.Array:
    """Return the world's unit vector z, [3], in the body frame; q [4] rotates body to world."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return jnp.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])


def to_matrix(q: jax.Array) -> jax.Array:
    """Return the rotation matrix [3, 3] of q [4], which maps body vectors to world vectors."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return jnp.stack(
        [
            jnp.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]),
            jnp.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]),
            jnp.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]),
        ]
    )


def exp(rotation: jax.Array) -> jax.Array:
    """Return unit quaternion [4] of a rotation vector ``rotation`` [3] rad.

    Exponential map of SO(3).

    Below 1e-3 rad the series sin(h)/h = 1 - h^2/6 + h^4/120 is used, exact there to float64; both
    branches of the ``where`` get a safe argument, so gradients are finite at zero too.
    """
    square = jnp.sum(rotation * rotation)
    small = square < 1e-6
    angle = jnp.sqrt(jnp.where(small, 1.0, square))
    half = 0.5 * angle
    h2 = 0.25 * square
    sinc = jnp.where(small, 1.0 - h2 / 6.0 + h2 * h2 / 120.0, jnp.sin(half) / half)
    cosine = jnp.where(small, 1.0 - h2 / 2.0 + h2 * h2 / 24.0, jnp.cos(half))
    return jnp.concatenate([cosine[None], 0.5 * sinc * rotation])


def exp_small(rotation: jax.Array) -> jax.Array:
    """Return the quaternion [4] of a vector ``rotation`` [3] of at most 1.5 rad, by series.

    The rotation of a body in a time step. Exact there to the rounding of the type; not of unit
    length beyond.
    """
    h2 = 0.25 * jnp.sum(rotation * rotation)
    terms = 7 if rotation.dtype.itemsize > 4 else 5
    sinc, cosine = jnp.zeros_like(h2), jnp.zeros_like(h2)
    for k in range(terms, -1, -1):
        sinc = sinc * h2 + (-1.0) ** k / math.factorial(2 * k + 1)
        cosine = cosine * h2 + (-1.0) ** k / math.factorial(2 * k)
    return jnp.concatenate([cosine[None], 0.5 * sinc * rotation])


def yaw(q: jax.Array) -> jax.Array:
    """Return heading [] about world z of the body x axis, rad, 0 = world x (east), for q [4]."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return jnp.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def from_yaw(heading: jax.Array) -> jax.Array:
    """Return the quaternion [4] of a rotation about world z by ``heading`` [], rad."""
    zero = jnp.zeros_like(heading)
    return jnp.stack([jnp.cos(0.5 * heading), zero, zero, jnp.sin(0.5 * heading)])
