"""What is known of obstacles and of the current, over a horizon."""

import jax.numpy as jnp
import numpy as np

from angler_mjx.planning.mppi import forecast
from angler_mjx.sim.information import CurrentInformation, ObstacleInformation
from angler_mjx.world.acoustics.channel import HeardRobots

TIMES = np.array([0.25, 0.5, 1.25, 9.0])


def known(time_s, p_m, velocity_mps):
    n, t = len(p_m), len(time_s)
    return ObstacleInformation(
        kind=jnp.zeros(n, jnp.int32),
        half_size_m=jnp.ones((n, 3)),
        radius_m=jnp.linspace(0.5, 0.7, n),
        exists=jnp.arange(n) < n - 1,
        moves=jnp.ones(n, bool),
        velocity_mps=jnp.asarray(velocity_mps),
        time_s=jnp.asarray(time_s),
        p_m=jnp.asarray(p_m),
        q=jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (n, t, 1)),
    )


def test_what_is_predicted_is_between_the_places_that_are_told_and_held_after_the_last():
    time = np.array([0.0, 0.5, 1.0, 1.5])
    places = np.random.default_rng(3).normal(size=(3, 4, 3))
    place, radius = forecast.extrapolate_obstacles(
        known(time, places, np.zeros((3, 3))), jnp.asarray(TIMES)
    )
    for body in range(3):
        for axis in range(3):
            expected = np.interp(TIMES, time, places[body, :, axis])
            np.testing.assert_allclose(place[body, :, axis], expected, atol=1e-6)
    np.testing.assert_allclose(radius, [0.5, 0.6, forecast.ABSENT_REACH_M], rtol=1e-6)


def test_what_is_observed_goes_straight_on():
    at, speed = np.array([[[1.0, 2.0, -3.0]]] * 2), np.array([[0.1, 0.0, -0.2]] * 2)
    place, _ = forecast.extrapolate_obstacles(known(np.zeros(1), at, speed), jnp.asarray(TIMES))
    np.testing.assert_allclose(place[1, 3], [1.9, 2.0, -4.8], atol=1e-6)


def test_nothing_is_told_where_nothing_is_known():
    place, radius = forecast.extrapolate_obstacles(None, jnp.asarray(TIMES))
    assert place.shape == (0, 4, 3)
    assert radius.shape == (0,)
    way = jnp.ones((4, 3))
    np.testing.assert_array_equal(
        forecast.current_along(None, way, jnp.asarray(TIMES)), np.zeros((4, 3))
    )
    still = CurrentInformation(components=(), stays=True)
    np.testing.assert_array_equal(
        forecast.current_along(still, way, jnp.asarray(TIMES)), np.zeros((4, 3))
    )


class Shear:
    def velocity(self, p, t):
        return jnp.stack([0.1 * p[1], 0.01 * t, jnp.zeros_like(t)])


def test_the_current_is_that_of_place_and_time_along_the_way():
    way = np.random.default_rng(4).normal(size=(4, 3))
    found = forecast.current_along(Shear(), jnp.asarray(way), jnp.asarray(TIMES))
    expected = np.stack([0.1 * way[:, 1], 0.01 * TIMES, np.zeros(4)], axis=1)
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_robots_go_straight_on_from_where_they_were_heard_by_the_one_that_asks():
    rng = np.random.default_rng(4)
    p, v, at = rng.normal(size=(3, 3, 3)), rng.normal(size=(3, 3, 3)), rng.uniform(size=(3, 3))
    heard = HeardRobots(
        p_m=jnp.asarray(p),
        v_mps=jnp.asarray(v),
        time_s=jnp.asarray(at),
        is_heard=jnp.ones((3, 3), bool),
    )
    place = forecast.extrapolate_robots(heard, jnp.array(5.0), jnp.asarray(TIMES), jnp.array(1))
    for robot in range(3):
        for row, later in enumerate(TIMES):
            expected = p[1, robot] + v[1, robot] * (5.0 + later - at[1, robot])
            np.testing.assert_allclose(place[row, robot], expected, rtol=1e-5, atol=1e-5)
