"""Small positive definite systems against NumPy."""

import jax
import numpy as np
import pytest

from angler_kernels import spd_solve


def systems(n, k, condition):
    rng = np.random.default_rng(n)
    basis, _ = np.linalg.qr(rng.normal(size=(n, n)))
    matrix = basis @ np.diag(np.geomspace(1, condition, n)) @ basis.T
    return 0.5 * (matrix + matrix.T), rng.normal(size=(n, k))


@pytest.mark.parametrize(("n", "k"), [(1, 1), (3, 2), (6, 1), (6, 2), (12, 3)])
def test_solution_in_float64(n, k, deviation):
    matrix, right = systems(n, k, 1e3)
    with jax.enable_x64(True):
        x = np.asarray(spd_solve.solve(jax.numpy.asarray(matrix), jax.numpy.asarray(right)))
    # Condition number 1e3 times float64 rounding.
    theirs = np.linalg.solve(matrix, right)
    deviation.close("solver.double", x, theirs, rtol=1e-11, atol=1e-12)


def test_batch_in_float32(deviation):
    matrix, right = (np.stack(x) for x in zip(*(systems(6, 1, 300) for _ in range(4)), strict=True))
    x = jax.vmap(spd_solve.solve)(matrix.astype(np.float32), right.astype(np.float32))
    assert x.dtype == np.float32
    # A condition number of 300 (13 kg against 0.1 kg m^2 and worse) times 1e-7.
    theirs = np.linalg.solve(matrix, right)
    deviation.close("solver.single", x, theirs, rtol=1e-4, atol=1e-4)


def test_only_the_lower_triangle_is_read():
    matrix, right = systems(4, 1, 10)
    spoilt = np.tril(matrix) + np.triu(np.full((4, 4), np.nan), 1)
    with jax.enable_x64(True):
        x = np.asarray(spd_solve.solve(jax.numpy.asarray(spoilt), jax.numpy.asarray(right)))
    # float64 rounding.
    np.testing.assert_allclose(x, np.linalg.solve(matrix, right), rtol=1e-12)


def test_gradient():
    matrix, right = systems(3, 1, 10)
    with jax.enable_x64(True):
        gradient = jax.grad(lambda b: spd_solve.solve(jax.numpy.asarray(matrix), b).sum())(right)
    # d(1^T A^-1 b) / db = A^-1 1, to rounding.
    np.testing.assert_allclose(gradient[:, 0], np.linalg.solve(matrix, np.ones(3)), rtol=1e-12)


@pytest.mark.parametrize("k", [0, 1, 5])
def test_eliminated_systems_share_all_but_a_diagonal(k):
    matrix, right = systems(6 + k, 1, 1e3)
    with jax.enable_x64(True):
        eliminated = spd_solve.eliminate(jax.numpy.asarray(matrix), 6)
        for diagonal in (np.zeros(k), np.geomspace(1, 1e6, k)):
            x = eliminated.solve(jax.numpy.asarray(right[:, 0]), jax.numpy.asarray(diagonal))
            theirs = np.linalg.solve(matrix + np.diag([0.0] * 6 + [*diagonal]), right[:, 0])
            np.testing.assert_allclose(x, theirs, rtol=1e-11, atol=1e-12)
