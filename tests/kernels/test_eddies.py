"""Rankine vortices and the double gyre: closed forms, walls, circulation and derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import current_field

CENTRE = np.array([[0.5, -1.0], [4.0, 2.0]])
CIRCULATION, CORE = np.array([2.0, -3.0]), np.array([1.0, 1.7])
LO, EXTENT = np.array([-3.0, 1.0]), np.array([10.0, 7.0])


@pytest.fixture(scope="module", autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


def vortices(p, t):
    return current_field.rankine_vortices(p, *map(jnp.asarray, (CENTRE, CIRCULATION, CORE)))


def gyre(p, t, epsilon=0.3):
    return current_field.double_gyre(
        p, t, jnp.asarray(LO), jnp.asarray(EXTENT), jnp.asarray(0.8), epsilon, 9.0
    )


def points(n=300):
    rng = np.random.default_rng(0)
    p = np.concatenate([LO + rng.uniform(0, 1, (n, 2)) * EXTENT, rng.normal(size=(n, 1))], axis=1)
    p[:2, :2] = CENTRE
    return p, rng.uniform(0, 20, n)


@pytest.mark.parametrize("field", [vortices, gyre])
def test_derivatives_equal_automatic_differentiation(field):
    p, t = points()
    _, v_t, J = jax.jit(jax.vmap(field))(p, t)
    slopes = jax.jit(jax.vmap(jax.jacfwd(lambda *at: field(*at)[0], argnums=(0, 1))))(p, t)
    np.testing.assert_allclose(J, slopes[0], atol=1e-13)
    np.testing.assert_allclose(v_t, slopes[1], atol=1e-13)
    assert np.all(np.trace(J, axis1=1, axis2=2) == 0)
    np.testing.assert_allclose(np.trace(slopes[0], axis1=1, axis2=2), 0, atol=1e-13)
    assert np.linalg.norm(J, axis=(1, 2)).max() > 0.1


@pytest.mark.parametrize(("radius", "share"), [(0.5, 0.25), (0.99, 0.9801), (1.3, 1.0), (2.0, 1.0)])
def test_circulation_around_a_circle_is_that_of_the_core_within(radius, share):
    angle = 2 * np.pi * np.arange(400) / 400
    along = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    p = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1) * radius
    p[:, :2] += CENTRE[0]
    v = jax.vmap(lambda p: vortices(p, 0.0)[0])(jnp.asarray(p))
    # The second vortex lies outside of all circles and adds nothing.
    around = np.mean(np.sum(np.asarray(v) * along, axis=1)) * 2 * np.pi * radius
    assert around == pytest.approx(share * CIRCULATION[0], rel=1e-9)


def test_jacobian_jumps_at_the_rim_and_the_velocity_does_not():
    one = [jnp.asarray(x[:1]) for x in (CENTRE, CIRCULATION, CORE)]
    near = [jnp.array([0.5 + r, -1.0, 0.0]) for r in (1 - 1e-9, 1 + 1e-9)]
    (v, _, J), (w, _, K) = (current_field.rankine_vortices(p, *one) for p in near)
    np.testing.assert_allclose(v, w, atol=1e-8)
    assert float(v[1]) == pytest.approx(CIRCULATION[0] / (2 * np.pi), rel=1e-8)
    # dv_theta/dr: Gamma / (2 pi a^2) within, its negative outside.
    assert float(J[1, 0]) == pytest.approx(1 / np.pi, rel=1e-6)
    assert float(K[1, 0]) == pytest.approx(-1 / np.pi, rel=1e-6)


def test_gyre_is_the_curl_of_its_stream_function():
    p, t = points()
    step = 1e-5

    def psi(x, y):
        X, Y = 2 * (x - LO[0]) / EXTENT[0], (y - LO[1]) / EXTENT[1]
        sway = 0.3 * np.sin(2 * np.pi * t / 9.0)
        return 0.8 * np.sin(np.pi * (sway * X**2 + (1 - 2 * sway) * X)) * np.sin(np.pi * Y)

    x, y = p[:, 0], p[:, 1]
    v = np.asarray(jax.jit(jax.vmap(gyre))(p, t)[0])
    u = -(psi(x, y + step) - psi(x, y - step)) / (2 * step)
    np.testing.assert_allclose(v[:, 0], u, atol=1e-9)
    w = (psi(x + step, y) - psi(x - step, y)) / (2 * step)
    np.testing.assert_allclose(v[:, 1], w, atol=1e-9)
    assert np.all(v[:, 2] == 0)


def test_no_water_crosses_the_walls():
    share, t = np.linspace(0, 1, 50), np.linspace(0, 9, 50)
    flow = jax.jit(jax.vmap(gyre))
    for axis in (0, 1):
        for side in (0.0, 1.0):
            at = np.stack([share, share, 0 * share], axis=1)
            at[:, axis] = side
            at[:, :2] = LO + at[:, :2] * EXTENT
            v = np.asarray(flow(at, t)[0])
            np.testing.assert_allclose(v[:, axis], 0, atol=1e-14)
            assert np.abs(v[:, 1 - axis]).max() > 0.1


@pytest.mark.parametrize("extent", [(10.0, 7.0), (10.0, 2.0)])
def test_peak_speed_of_the_gyre_is_met_and_its_bound_holds(extent):
    sides = jnp.array(extent)
    stream = current_field.double_gyre_stream(jnp.array(0.4), sides)
    x, y, t = np.meshgrid(
        np.linspace(0, extent[0], 41), np.linspace(0, extent[1], 41), np.arange(8.0), indexing="ij"
    )
    at = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3)

    @jax.jit
    @jax.vmap
    def speed(p, t):
        both = [
            current_field.double_gyre(p, t, jnp.zeros(2), sides, stream, e, 8.0)[0]
            for e in (0.0, 0.3)
        ]
        return jnp.linalg.norm(jnp.stack(both), axis=1)

    steady, swaying = np.asarray(speed(at, t.ravel())).max(axis=0)
    assert steady == pytest.approx(0.4, rel=1e-12)  # at the middle of a wall, a point of the grid
    assert swaying <= 0.4 * (1 + 2 * 0.3) * (1 + 1e-12)
    if 2 / extent[0] >= 1 / extent[1]:
        assert swaying == pytest.approx(0.4 * 1.6, rel=1e-12), "the bound is met"
