"""Fields on a grid: values against SciPy, derivatives against automatic ones, edges, lanes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from angler_kernels import gridded_field, lanes
from angler_kernels.gridded_field import GridAxis

SHAPE = (5, 4, 6, 7, 3)
KNOTS = (
    0.5 * np.arange(5),
    np.array([0.0, 0.3, 0.9, 1.0]),
    np.array([0.0, 1.0, 2.5, 5.0, 9.0, 20.0]),
    60.0 * np.arange(7),
)
AXES = tuple(
    GridAxis(count=len(knots), step=float(knots[1]) if i in (0, 3) else None)
    for i, knots in enumerate(KNOTS)
)
VALUES = np.random.default_rng(2).normal(size=SHAPE)
KNOT = np.array([2, 1, 3, 4])
REST = np.array([0.2, -0.1, -4.0, 31.0])
FACTOR = np.array([0.7, 0.7, 0.2])
RATE = np.array([0.01, 0.02, -1.0, 1.5])


@pytest.fixture(scope="module", autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


def flow(p, t, values=VALUES, shape=SHAPE):
    axes = [
        (axis, jnp.asarray(knots) if axis.step is None else None)
        for axis, knots in zip(AXES, KNOTS, strict=True)
    ]
    numbers = (jnp.asarray(one) for one in (KNOT, REST, RATE))
    flat = jnp.asarray(values).reshape(-1)
    return gridded_field.gridded_velocity(p, t, flat, shape, axes, *numbers, jnp.asarray(FACTOR))


def points(n=500):
    """Places and times, a quarter of them beyond an edge, and where they lie on the axes."""
    rng = np.random.default_rng(0)
    at = np.stack([knots[0] + rng.uniform(-0.1, 1.1, n) * np.ptp(knots) for knots in KNOTS])
    begin = np.array([knots[k] for knots, k in zip(KNOTS, KNOT, strict=True)]) + REST
    y, x, z, t = (at - begin[:, None]) / RATE[:, None]
    return np.stack([x, y, z], axis=1), t, at.T


@pytest.fixture(scope="module")
def found():
    p, t, _ = points()
    return [np.asarray(one) for one in jax.jit(jax.vmap(flow))(p, t)]


def test_values_are_those_of_an_independent_interpolation(found):
    _, _, at = points()
    held = np.clip(at, [knots[0] for knots in KNOTS], [knots[-1] for knots in KNOTS])
    want = FACTOR * RegularGridInterpolator(KNOTS, VALUES)(held)
    np.testing.assert_allclose(found[0], want, atol=1e-12)


def test_derivatives_equal_finite_differences(found):
    p, t, at = points()
    step = 1e-6

    def slope(dp, dt):
        ahead, behind = (jax.jit(jax.vmap(flow))(p + s * dp, t + s * dt)[0] for s in (1, -1))
        return (np.asarray(ahead) - np.asarray(behind)) / (2 * step)

    near = np.min([np.abs(at[:, i, None] - k[None]).min(1) for i, k in enumerate(KNOTS)], axis=0)
    away = near > 1e-4  # of knots, where the derivative jumps
    assert away.sum() > 450
    for j in range(3):
        np.testing.assert_allclose(
            found[2][away, :, j], slope(step * np.eye(3)[j], 0.0)[away], atol=2e-8
        )
    np.testing.assert_allclose(found[1][away], slope(np.zeros(3), step)[away], atol=2e-8)


def test_derivatives_equal_automatic_differentiation(found):
    p, t, _ = points()
    J, v_t = jax.jit(jax.vmap(jax.jacfwd(lambda *at: flow(*at)[0], argnums=(0, 1))))(p, t)
    np.testing.assert_allclose(found[2], J, atol=1e-12)
    np.testing.assert_allclose(found[1], v_t, atol=1e-12)


def test_beyond_the_edges_the_field_is_held(found):
    at = points()[2]
    for i, column in enumerate((1, 0, 2)):
        beyond = (at[:, i] < KNOTS[i][0]) | (at[:, i] > KNOTS[i][-1])
        assert beyond.sum() > 40
        assert np.all(found[2][beyond, :, column] == 0)
    late = at[:, 3] > KNOTS[3][-1]
    assert np.all(found[1][late] == 0)
    whole = np.all([(at[:, i] > k[0]) & (at[:, i] < k[-1]) for i, k in enumerate(KNOTS)], axis=0)
    assert np.all(found[1][whole] != 0)


def test_lanes_that_look_up_give_the_same(found):
    p, t, _ = points()

    def table(values):
        flat = jnp.asarray(values).reshape(-1)
        return lanes.LookupTable(lambda at: flat[at], flat.shape, flat.dtype)

    def one(p, t, values, x, depth):
        axes = list(zip(AXES, (None, x, depth, None), strict=True))
        numbers = (jnp.asarray(one) for one in (KNOT, REST, RATE))
        return gridded_field.gridded_velocity(
            p, t, values, SHAPE, axes, *numbers, jnp.asarray(FACTOR)
        )

    operands = (lanes.split(jnp.asarray(p)), lanes.split(jnp.asarray(t)))
    tables = (table(VALUES), table(KNOTS[1]), table(KNOTS[2]))
    for part, want in zip(lanes.join(lanes.apply(one, *operands, *tables)), found, strict=True):
        np.testing.assert_allclose(np.broadcast_to(part, want.shape), want, atol=1e-12)


def test_axes_of_one_knot_are_the_same_everywhere():
    """A steady field of one depth without a vertical part."""
    knots = (KNOTS[0], KNOTS[1])
    axes = (AXES[0], AXES[1], GridAxis(count=1, step=1.0), GridAxis(count=1, step=1.0))
    values = VALUES[:, :, 0, 0, :2]
    operands = [(axes[0], None), (axes[1], jnp.asarray(KNOTS[1])), (axes[2], None), (axes[3], None)]
    knot = np.array([2, 1, 0, 0])

    def one(p, t):
        return gridded_field.gridded_velocity(
            p,
            t,
            jnp.asarray(values).reshape(-1),
            (5, 4, 1, 1, 2),
            operands,
            knot,
            REST,
            RATE,
            FACTOR,
        )

    p, t, at = points()
    v, v_t, J = jax.jit(jax.vmap(one))(p, t)
    held = np.clip(at[:, :2], [k[0] for k in knots], [k[-1] for k in knots])
    np.testing.assert_allclose(
        v[:, :2], FACTOR[:2] * RegularGridInterpolator(knots, values)(held), atol=1e-12
    )
    assert np.all(np.asarray(v)[:, 2] == 0)
    assert np.all(v_t == 0)
    assert np.all(np.asarray(J)[:, :, 2] == 0)
