"""Depth profiles and tidal constituents: closed forms, derivatives, divergence."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from angler_kernels import current_field, lanes

DEPTH = np.array([0.0, 3.0, 4.0, 10.0, 22.0, 40.0])
KNOTS = np.array([[0.5, 0.0], [0.4, 0.1], [0.1, 0.3], [0.2, 0.25], [-0.1, 0.2], [-0.1, 0.0]])
SPEED, PHASE = np.array([1.4e-4, 7.3e-5, 2.9e-4]), np.array([0.3, -1.0, 2.2])
COSINE = np.array([[0.5, 0.1], [0.2, -0.2], [0.05, 0.0]])
SINE = np.array([[-0.02, 0.1], [0.1, 0.1], [0.0, -0.01]])


@pytest.fixture(scope="module", autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


def profile(p, t):
    depth, knots = jnp.asarray(DEPTH), jnp.asarray(KNOTS)
    return current_field.depth_profile(p, depth, knots, current_field.monotone_slopes(depth, knots))


def tide(p, t):
    return current_field.tidal_current(t, *map(jnp.asarray, (SPEED, PHASE, COSINE, SINE)))


def points(n=400):
    rng = np.random.default_rng(3)
    p = np.concatenate([rng.normal(size=(n, 2)), rng.uniform(-50, 5, (n, 1))], axis=1)
    return p, rng.uniform(0, 1e5, n)


@pytest.mark.parametrize("field", [profile, tide])
def test_derivatives_equal_automatic_differentiation(field):
    p, t = points()
    _, v_t, J = jax.jit(jax.vmap(field))(p, t)
    slopes = jax.jit(jax.vmap(jax.jacfwd(lambda *at: field(*at)[0], argnums=(0, 1))))(p, t)
    np.testing.assert_allclose(J, slopes[0], atol=1e-14)
    np.testing.assert_allclose(v_t, slopes[1], atol=1e-16)
    assert np.all(np.trace(J, axis1=1, axis2=2) == 0), "free of divergence"
    assert np.all(np.trace(slopes[0], axis1=1, axis2=2) == 0)
    assert max(np.abs(J).max(), np.abs(v_t).max() * 1e3) > 0.01


def test_profile_is_the_cubic_of_fritsch_and_butland_between_inner_knots():
    z = np.linspace(3.0, 22.0, 200)
    at = np.stack([0 * z, 0 * z, -z], axis=1)
    v = np.asarray(jax.jit(jax.vmap(lambda p: profile(p, 0.0)[0]))(at))
    # SciPy has other slopes at the ends alone: ours are zero, and the water is held smoothly.
    np.testing.assert_allclose(v[:, :2], PchipInterpolator(DEPTH, KNOTS)(z), atol=1e-14)


def test_profile_stays_between_neighbouring_knots_and_is_held_beyond():
    z = np.linspace(0.0, 40.0, 2001)
    field = jax.jit(jax.vmap(lambda p: profile(p, 0.0)))
    v, _, J = field(np.stack([0 * z, 0 * z, -z], axis=1))
    k = np.clip(np.searchsorted(DEPTH, z, side="right") - 1, 0, len(DEPTH) - 2)
    low, high = np.minimum(KNOTS[k], KNOTS[k + 1]), np.maximum(KNOTS[k], KNOTS[k + 1])
    assert np.all(v[:, :2] >= low - 1e-15)
    assert np.all(v[:, :2] <= high + 1e-15)
    # Once continuously differentiable: no jump of the slope, at the ends either. A chord's jumps by
    # 0.3 1/s; what is left is the curvature, 6 x 0.3 m/s over a square metre, times 0.02 m.
    assert np.abs(np.diff(J[:, :2, 2], axis=0)).max() < 0.04
    beyond, _, bent = field(np.array([[0.0, 0.0, 3.0], [0.0, 0.0, -90.0]]))
    np.testing.assert_allclose(beyond[:, :2], KNOTS[[0, -1]], atol=1e-15)
    np.testing.assert_allclose(bent, 0.0, atol=1e-16)


def test_profile_on_lanes_is_that_of_one_body():
    """More knots than a program keeps in registers, so they are looked up."""
    depth, rng = np.linspace(0.0, 60.0, 20), np.random.default_rng(1)
    knots = rng.normal(size=(20, 2))
    slopes = np.asarray(current_field.monotone_slopes(jnp.asarray(depth), jnp.asarray(knots)))
    p, _ = points(50)

    def table(values):
        flat = jnp.asarray(values.reshape(-1))
        return lanes.LookupTable(lambda at: flat[at], values.shape, values.dtype)

    operands = (lanes.split(jnp.asarray(p)), table(depth), table(knots), table(slopes))
    v, _, J = lanes.join(lanes.apply(current_field.depth_profile, *operands))
    want = jax.vmap(current_field.depth_profile, (0, None, None, None))(p, depth, knots, slopes)
    np.testing.assert_allclose(v, want[0], atol=1e-14)
    np.testing.assert_allclose(J, want[2], atol=1e-14)


def test_tide_is_the_sum_of_its_ellipses():
    _, t = points(100)
    v, v_t, J = jax.jit(jax.vmap(lambda t: tide(None, t)))(t)
    u = 0
    for w, g, cosine, sine in zip(SPEED, PHASE, COSINE, SINE, strict=True):
        # Two phasors that turn either way, as tidal analysis writes an ellipse.
        c, s = cosine[0] + 1j * cosine[1], sine[0] + 1j * sine[1]
        turn = np.exp(1j * (w * t + g))
        u = u + 0.5 * (c - 1j * s) * turn + 0.5 * (c + 1j * s) * np.conj(turn)
    np.testing.assert_allclose(v[:, 0] + 1j * np.asarray(v[:, 1]), u, atol=1e-14)
    assert np.all(v[:, 2] == 0)
    assert np.all(J == 0)
    assert np.all(v_t[:, 2] == 0)
