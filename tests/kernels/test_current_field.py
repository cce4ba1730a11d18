"""Water velocity fields: their derivatives, divergence and bounds."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

from angler_kernels import current_field

CENTRE = np.array([[0.0, 0.0], [3.0, -1.0], [-2.0, 2.5]])
CIRCULATION = np.array([2.0, -3.0, 1.5])
CORE = np.array([1.0, 1.7, 2.5])
KNOTS = np.array([[0.1, 0.2, 0.0], [0.3, -0.1, 0.02], [-0.2, 0.1, -0.01], [0.0, 0.0, 0.0]])


@pytest.fixture(scope="module", autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


def vortices(p):
    return current_field.lamb_oseen_vortices(
        p, jnp.asarray(CENTRE), jnp.asarray(CIRCULATION), jnp.asarray(CORE)
    )


def total(p, t):
    """Vortices in a wandering uniform flow."""
    v, v_t, J = vortices(p)
    u, u_t, K = current_field.smooth_knots(t, jnp.asarray(KNOTS), jnp.asarray(4.0))
    return v + u, v_t + u_t, J + K


many = jax.jit(jax.vmap(vortices))


def points(n=500):
    """Random points, the three axes, and points very near to the first axis."""
    rng = np.random.default_rng(0)
    p = rng.uniform(-6, 6, (n, 3))
    p[:3, :2] = CENTRE
    p[3:53, :2] = 10.0 ** rng.uniform(-9, 0, (50, 1)) * rng.normal(size=(50, 2))
    return p


def textbook(p):
    """v_theta = Gamma / (2 pi r) (1 - exp(-r^2/a^2)), turned into x and y."""
    v = np.zeros_like(p)
    for centre, circulation, core in zip(CENTRE, CIRCULATION, CORE, strict=True):
        x, y = (p[:, :2] - centre).T
        r = np.hypot(x, y)
        speed = np.zeros_like(r)
        far = r > 0
        speed[far] = circulation / (2 * np.pi * r[far]) * -np.expm1(-((r[far] / core) ** 2))
        turn = np.divide(speed, r, out=np.zeros_like(r), where=far)
        v[:, 0] -= turn * y
        v[:, 1] += turn * x
    return v


def test_velocity_is_the_textbook_formula():
    p = points()
    v, v_t, _ = many(p)
    np.testing.assert_allclose(v, textbook(p), atol=1e-14)  # rounding of speeds below 1 m/s
    assert np.all(np.asarray(v_t) == 0)


def test_divergence_is_zero_even_at_the_axes():
    for dtype in (np.float64, np.float32):
        J = np.asarray(many(points().astype(dtype))[2])
        # The two diagonal terms are one number with two signs.
        assert np.all(np.trace(J, axis1=1, axis2=2) == 0)


def test_jacobian_equals_automatic_differentiation():
    p = points()
    J = many(p)[2]
    automatic = jax.jit(jax.vmap(jax.jacfwd(lambda x: vortices(x)[0])))(p)
    # Series and closed form meet at s = 0.1, where the closed form cancels ten units of rounding.
    np.testing.assert_allclose(J, automatic, atol=1e-14)
    assert np.all(np.isfinite(np.asarray(automatic)))


def test_jacobian_equals_finite_differences():
    p, step = points(), 1e-5
    J = np.asarray(many(p)[2])
    for j in range(3):
        shift = step * np.eye(3)[j]
        slope = (textbook(p + shift) - textbook(p - shift)) / (2 * step)
        # step^2 times the third derivative (below 10 /m^2/s) plus 1e-16 / step.
        np.testing.assert_allclose(J[:, :, j], slope, atol=1e-9)


def test_single_precision_keeps_its_digits():
    p = points()
    for got, want in zip(many(p.astype(np.float32)), many(p), strict=True):
        # Float32 positions up to 6 m (4e-7) times gradients below 1 /s and some operations.
        np.testing.assert_allclose(got, want, atol=3e-6)


def test_circulation_gives_the_peak_speed():
    core, peak = 1.7, 0.35
    circulation = float(current_field.lamb_oseen_circulation(jnp.asarray(peak), jnp.asarray(core)))

    def speed(r):
        return circulation / (2 * np.pi * r) * -np.expm1(-((r / core) ** 2))

    best = minimize_scalar(lambda r: -speed(r), bounds=(0.1, 6), method="bounded")
    assert speed(best.x) == pytest.approx(peak, rel=1e-9)  # flat at the peak
    # The search resolves the place of a flat maximum to half the digits.
    assert best.x / core == pytest.approx(current_field.PEAK_RADIUS, abs=1e-5)
    x2 = current_field.PEAK_RADIUS**2
    assert np.exp(x2) == pytest.approx(1 + 2 * x2, rel=1e-12)


def test_knots_are_met_and_never_left():
    t = np.linspace(-2, 15, 400)
    field = jax.jit(
        jax.vmap(lambda t: current_field.smooth_knots(t, jnp.asarray(KNOTS), jnp.asarray(4.0)))
    )
    v, v_t, J = (np.asarray(x) for x in field(t))
    at_knots = np.asarray(field(4.0 * np.arange(4))[0])
    np.testing.assert_allclose(at_knots, KNOTS, atol=1e-16)
    assert np.all(v <= KNOTS.max(axis=0) + 1e-15)
    assert np.all(v >= KNOTS.min(axis=0) - 1e-15)
    np.testing.assert_array_equal(v[t > 12], np.broadcast_to(KNOTS[-1], (np.sum(t > 12), 3)))
    assert np.all(J == 0)
    step = 1e-5
    slope = (np.asarray(field(t + step)[0]) - np.asarray(field(t - step)[0])) / (2 * step)
    # v_t is continuous; at a knot its slope jumps (6 * jump / 16 < 0.2 m/s^3): times the step.
    np.testing.assert_allclose(v_t, slope, atol=2e-6)


def test_material_derivative_is_the_acceleration_of_a_particle():
    flow = jax.jit(total)

    def velocity(t, p):
        return np.asarray(flow(jnp.asarray(p), jnp.asarray(t))[0])

    path = solve_ivp(velocity, (0, 11), [1.0, 0.5, -3.0], rtol=1e-10, atol=1e-12, dense_output=True)
    step = 1e-3
    for t in np.linspace(0.5, 10.5, 15):
        v, v_t, J = flow(jnp.asarray(path.sol(t)), jnp.asarray(t))
        along = np.asarray(current_field.material_derivative(v, v_t, J))
        later = velocity(t + step, path.sol(t + step))
        before = velocity(t - step, path.sol(t - step))
        # Interpolation of the path: 1e-9 / step; the difference itself: step^2 times about 1.
        np.testing.assert_allclose(along, (later - before) / (2 * step), atol=5e-6)
        assert np.linalg.norm(np.asarray(J) @ np.asarray(v)) > 1e-3, "both parts matter"
        assert np.linalg.norm(along) > 1e-3
