"""Sampling a trajectory, against NumPy's interpolation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.robot.control.commands.trajectory import Trajectory, sample_reference, segment_at

TIME = np.array([0.0, 1.0, 1.5, 4.0, 6.0])
POINT = np.random.default_rng(0).normal(size=(5, 3))


@pytest.fixture(params=[0, 3], ids=["exact", "padded"])
def path(request):
    padding = request.param
    return Trajectory(
        time_s=jnp.asarray(np.append(TIME, np.full(padding, TIME[-1]))),
        position_m=jnp.asarray(np.concatenate([POINT, np.repeat(POINT[-1:], padding, axis=0)])),
        found=jnp.array(True),
    )


def test_position_is_interpolated_and_held_at_the_end(path):
    t = np.concatenate([TIME, np.linspace(0, 9, 77)])
    position, _ = jax.vmap(sample_reference, (None, 0))(path, t)
    expected = np.stack([np.interp(t, TIME, POINT[:, k]) for k in range(3)], axis=1)
    # float32 on metres.
    np.testing.assert_allclose(position, expected, atol=1e-6)


def test_velocity_is_the_slope_and_zero_at_the_end(path):
    t = np.array([0.0, 0.5, 1.2, 3.9, 5.0, 6.0, 7.5])
    _, velocity = jax.vmap(sample_reference, (None, 0))(path, t)
    slope = np.diff(POINT, axis=0) / np.diff(TIME)[:, None]
    expected = np.concatenate([slope[[0, 0, 1, 2, 3]], np.zeros((2, 3))])
    # float32 on differences over half a second.
    np.testing.assert_allclose(velocity, expected, atol=1e-5)


def test_a_clock_that_goes_on_finds_what_bisection_finds(path):
    """Slow, fast over several points at once, standing, past the end, and put back."""
    clock = np.concatenate([np.linspace(0, 5, 41), [1.4, 5.9, 5.9, 6.0, 8.0, 8.1, 0.2, 6.5, 3.0]])

    def on(near, t):
        k = segment_at(path.time_s, t, near)
        return k, k

    _, found = jax.lax.scan(on, jnp.int32(0), jnp.asarray(clock))
    expected = jax.vmap(segment_at, (None, 0))(path.time_s, clock)
    under_way = clock < TIME[-1]
    np.testing.assert_array_equal(found[under_way], expected[under_way])
    # Nothing is looked for in the padding.
    assert np.all(np.asarray(found)[~under_way] <= TIME.size - 2)


def test_a_path_of_one_place_is_that_place():
    place = jnp.array([1.0, 2.0, -3.0])
    path = Trajectory(
        time_s=jnp.zeros(4), position_m=jnp.tile(place, (4, 1)), found=jnp.array(False)
    )
    for t in (0.0, 5.0):
        position, velocity = sample_reference(path, jnp.array(t))
        np.testing.assert_array_equal(position, place)
        np.testing.assert_array_equal(velocity, 0)


def test_gradient_is_finite_where_padded(path):
    gradient = jax.grad(lambda p: sample_reference(p, jnp.array(7.0))[0].sum(), allow_int=True)(
        path
    )
    # At the end only the last way-point counts.
    assert np.all(np.isfinite(gradient.position_m))
    np.testing.assert_allclose(gradient.position_m.sum(axis=0), 1.0)
