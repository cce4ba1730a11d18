"""Guidance along way-points, one step of it against the numbers worked out by hand."""

import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.robot.control.commands import Estimate
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.laws import follow

DT = 0.05


@pytest.mark.parametrize(
    ("move", "course"),
    [([0.6, 0.6, -0.8], np.pi / 4), ([0.6, 0.0, 0.8], 0.0), ([0.0, -0.6, 0.8], -np.pi / 2)],
    ids=["diving", "climbing ahead", "climbing to starboard"],
)
def test_a_path_that_climbs_is_looked_along_in_the_horizontal_plane(move, course):
    start = np.array([1.0, 2.0, -5.0])
    path = Trajectory(
        time_s=jnp.array([0.0, 2.0]),
        position_m=jnp.asarray([start, start + move]),
        found=jnp.array(True),
    )
    at = Estimate(p=jnp.asarray(start), q=jnp.array([1.0, 0, 0, 0]), nu=jnp.zeros(6))
    # Fast enough to turn there in one step.
    gains = follow.FollowGains(yaw_rate_radps=100.0)
    _, target = follow.track_target(gains, follow.reset(jnp.array(0.0)), at, path, DT)
    assert float(target.yaw_rad) == pytest.approx(course, abs=1e-6)
    assert float(target.yaw_rate_radps) == pytest.approx(course / DT, abs=1e-4)
    np.testing.assert_allclose(target.velocity_mps, np.array(move) / 2, rtol=1e-6)
