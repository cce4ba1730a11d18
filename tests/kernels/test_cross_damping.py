"""Damping between axes: its derivative, and the elimination without exchange of rows."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import cross_damping


@pytest.fixture
def double():
    with jax.enable_x64(True):
        yield


def test_slope_is_minus_the_derivative(double):
    rng = np.random.default_rng(1)
    L, Q, P = rng.normal(size=(6, 6)), rng.normal(size=(6, 6)), rng.normal(size=(6, 21))
    for nu in rng.normal(size=(5, 6)):
        exact = jax.jacfwd(cross_damping.cross_wrench, argnums=3)(L, Q, P, jnp.asarray(nu))
        slope = cross_damping.cross_slope(L, Q, P, jnp.asarray(nu))
        np.testing.assert_allclose(slope, -exact, rtol=1e-12, atol=1e-12)


def test_wrench_by_hand(double):
    none, nu = np.zeros((6, 6)), jnp.array([2.0, -3.0, 0.0, 0.0, 0.0, 0.5])
    L, Q, P = none.copy(), none.copy(), np.zeros((6, 21))
    L[1, 5], Q[5, 1] = 4.0, 10.0
    P[1, cross_damping.PRODUCT_PAIRS.index((0, 1))] = -7.0
    wrench = cross_damping.cross_wrench(L, Q, P, nu)
    # Y = -4 r - 7 u v, N = -10 |v| v.
    np.testing.assert_allclose(wrench, [0, -4 * 0.5 + 7 * 6, 0, 0, 0, 90.0], rtol=1e-14)


def test_elimination_solves_matrices_that_are_not_symmetric(double):
    rng = np.random.default_rng(2)
    for _ in range(20):
        half, turn = rng.normal(size=(2, 6, 6))
        matrix = half @ half.T + 0.1 * np.eye(6) + turn - turn.T
        right = rng.normal(size=6)
        x = cross_damping.solve_general(jnp.asarray(matrix), jnp.asarray(right))
        np.testing.assert_allclose(x, np.linalg.solve(matrix, right), rtol=1e-9)
