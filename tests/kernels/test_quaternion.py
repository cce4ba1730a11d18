"""Quaternions against SciPy's rotations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from angler_kernels import quaternion

N = 50


@pytest.fixture(scope="module", autouse=True)
def x64():
    with jax.enable_x64(True):
        yield


def random_quaternions(seed):
    q = np.random.default_rng(seed).normal(size=(N, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def scipy(q):
    return Rotation.from_quat(q, scalar_first=True)


# float64 rounding on numbers of order one, in every comparison below.
NEAR = {"rtol": 0, "atol": 1e-14}


def test_products_and_inverse(deviation):
    a, b = random_quaternions(0), random_quaternions(1)
    product = np.asarray(jax.vmap(quaternion.multiply)(a, b))
    theirs = (scipy(a) * scipy(b)).as_matrix()
    deviation.close("quaternion.product", scipy(product).as_matrix(), theirs, **NEAR)
    one = np.asarray(jax.vmap(quaternion.multiply)(a, jax.vmap(quaternion.conjugate)(a)))
    np.testing.assert_allclose(one, np.tile([1.0, 0, 0, 0], (N, 1)), **NEAR)


def test_rotation_of_vectors(deviation):
    q, v = random_quaternions(2), np.random.default_rng(3).normal(size=(N, 3))
    there = np.asarray(jax.vmap(quaternion.rotate)(q, v))
    deviation.close("quaternion.rotation", there, scipy(q).apply(v), **NEAR)
    np.testing.assert_allclose(jax.vmap(quaternion.rotate_inverse)(q, there), v, **NEAR)
    np.testing.assert_allclose(jax.vmap(quaternion.to_matrix)(q), scipy(q).as_matrix(), **NEAR)
    np.testing.assert_allclose(jax.vmap(quaternion.world_up)(q), scipy(q).as_matrix()[:, 2], **NEAR)


def test_exponential_from_nothing_to_a_whole_turn(deviation):
    rng = np.random.default_rng(4)
    axis = rng.normal(size=(N, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    # On both sides of the threshold of the series, 1e-3 rad, and to a whole turn.
    angle = np.concatenate([[0, 1e-12, 0.999e-3, 1.001e-3], np.geomspace(1e-8, 6.2, N - 4)])
    q = np.asarray(jax.vmap(quaternion.exp)(angle[:, None] * axis))
    half = 0.5 * angle[:, None]
    exact = np.hstack([np.cos(half), np.sin(half) * axis])
    deviation.close("quaternion.exponential", q, exact, **NEAR)


def test_exponential_has_a_gradient_at_zero():
    J = jax.jacrev(quaternion.exp)(jnp.zeros(3))
    # exp(r) = [1, r/2] to first order, exactly.
    np.testing.assert_array_equal(J, np.vstack([np.zeros(3), 0.5 * np.eye(3)]))


def test_yaw():
    q = random_quaternions(5)
    np.testing.assert_allclose(
        jax.vmap(quaternion.yaw)(q), scipy(q).as_euler("ZYX")[:, 0], rtol=0, atol=1e-12
    )  # atan2 magnifies rounding near straight up, by a hundred here
    heading = np.linspace(-3.1, 3.1, N)
    turned = jax.vmap(quaternion.from_yaw)(heading)
    np.testing.assert_allclose(jax.vmap(quaternion.yaw)(turned), heading, **NEAR)


def test_float32_stays_float32():
    q, v = jnp.array([1, 0, 0, 0], jnp.float32), jnp.array([0.1, 0, 0], jnp.float32)
    for result in (
        quaternion.multiply(q, q),
        quaternion.rotate(q, v),
        quaternion.exp(v),
        quaternion.from_yaw(v[0]),
        quaternion.to_matrix(q),
    ):
        assert result.dtype == jnp.float32
