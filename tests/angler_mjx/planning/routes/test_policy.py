"""Bodies that the policy of routes steers clear of, from what is known of obstacles."""

import jax.numpy as jnp
import numpy as np

from angler_mjx.planning.routes.policy import _moving_bodies
from angler_mjx.sim.information import ObstacleInformation


def test_a_robot_that_knows_of_no_obstacle_has_no_body_to_avoid():
    bodies = _moving_bodies(None)
    assert bodies.p_m.shape == bodies.v_mps.shape == (0, 3)
    assert bodies.reach_m.shape == bodies.yields.shape == (0,)


def test_only_obstacles_that_exist_and_move_are_bodies_and_none_yields():
    position = np.arange(12.0).reshape(4, 1, 3)
    known = ObstacleInformation(
        kind=jnp.zeros(4, jnp.int32),
        half_size_m=jnp.ones((4, 3)),
        radius_m=jnp.array([0.4, 0.5, 0.6, 0.7]),
        exists=jnp.array([True, True, False, False]),
        moves=jnp.array([True, False, True, False]),
        velocity_mps=jnp.asarray(-position[:, 0]),
        time_s=jnp.zeros(1),
        p_m=jnp.asarray(position),
        q=jnp.tile(jnp.array([1.0, 0.0, 0.0, 0.0]), (4, 1, 1)),
    )
    bodies = _moving_bodies(known)
    np.testing.assert_array_equal(bodies.p_m, position[:, 0])
    np.testing.assert_array_equal(bodies.v_mps, -position[:, 0])
    assert float(bodies.reach_m[0]) == np.float32(0.4)
    assert np.all(np.asarray(bodies.reach_m)[1:] < 0.0)
    assert not np.any(bodies.yields)
