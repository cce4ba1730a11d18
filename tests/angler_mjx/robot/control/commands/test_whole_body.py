"""Motion of joints that is commanded: held, of a trajectory at another pace, within limits."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.robot.control.commands.joint_trajectory import (
    CUBIC,
    VEHICLE_JOINTS,
    JointTrajectory,
)
from angler_mjx.robot.control.commands.whole_body import (
    JointTarget,
    hold_joints,
    limit_joints,
    sample_joints,
)
from angler_mjx.robot.vehicles.link_motion import JointMotion


def test_joints_are_held_at_rest():
    joints = JointMotion(position=jnp.array([1.0, -2.0]), velocity=jnp.array([0.3, 0.4]))
    target = hold_joints(joints)
    assert target.position.tolist() == [1.0, -2.0]
    assert target.velocity.tolist() == target.acceleration.tolist() == [0.0, 0.0]


def test_a_trajectory_at_another_pace_is_slower_and_accelerates_less():
    """Of a joint at t^3: 3 t^2 times the pace, 6 t times its square."""
    base, zero = len(VEHICLE_JOINTS), np.zeros((2, 5))
    position, velocity = zero.copy(), zero.copy()
    position[:, base], velocity[:, base] = [0.0, 8.0], [0.0, 12.0]
    trajectory = JointTrajectory(
        joints=(*VEHICLE_JOINTS, "elbow"),
        time_s=jnp.array([0.0, 2.0]),
        position=jnp.asarray(position),
        velocity=jnp.asarray(velocity),
        acceleration=jnp.asarray(zero),
        degree=jnp.full(2, CUBIC, jnp.int32),
        commanded=jnp.ones(5, bool),
    )
    target = sample_joints(trajectory, jnp.array(1.5), jnp.array(0.5))
    assert target.position.tolist() == pytest.approx([1.5**3])
    assert target.velocity.tolist() == pytest.approx([0.5 * 3.0 * 1.5**2])
    assert target.acceleration.tolist() == pytest.approx([0.25 * 6.0 * 1.5])


def limit(position, velocity, acceleration=(1.0, 1.0, 1.0)):
    """Return a target of three joints within -1 and 1 at speeds up to 2, and whether it was."""
    links = SimpleNamespace(lower=jnp.full(3, -1.0), upper=jnp.full(3, 1.0), max_speed=2.0)
    target = JointTarget(
        **{
            name: jnp.array(row)
            for name, row in zip(
                ("position", "velocity", "acceleration"),
                (position, velocity, acceleration),
                strict=True,
            )
        }
    )
    limited, is_clipped = limit_joints(links, target)
    rows = (limited.position, limited.velocity, limited.acceleration)
    return [row.tolist() for row in rows], bool(is_clipped)


def test_targets_are_clipped_to_the_limits():
    # Beyond a position; beyond a speed; beyond both.
    rows, is_clipped = limit([1.5, 0.2, -3.0], [1.0, -5.0, 5.0])
    assert rows == [[1.0, pytest.approx(0.2), -1.0], [0.0, -2.0, 0.0], [0.0, 0.0, 0.0]]
    assert is_clipped


def test_targets_within_the_limits_are_left():
    rows, is_clipped = limit([1.0, -1.0, 0.0], [2.0, -2.0, 1.0])
    assert rows == [[1.0, -1.0, 0.0], [2.0, -2.0, 1.0], [1.0, 1.0, 1.0]]
    assert not is_clipped
