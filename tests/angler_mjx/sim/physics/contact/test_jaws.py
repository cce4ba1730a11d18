"""Jaws that hold a body by dry friction: one robot, one body, no water, by Coulomb's law."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from angler_kernels import quaternion
from angler_mjx.sim.physics.contact.grips import (
    GripSpec,
    find_grip_points,
    find_grip_rows,
    friction_limits,
    measure_forces,
    take_hold,
)
from angler_mjx.sim.physics.contact.layout import BodyLayout
from angler_mjx.sim.physics.contact.mjx_contact import Touches
from angler_mjx.sim.physics.contact.resolve import ContactSpec, WorldBodies, resolve_contact

DT = 0.005
LIMITS = (12.0, 20.0, 7.0, 0.9, 0.5, 1.4)
GRIP = GripSpec(body=0, friction_limits=LIMITS, max_slip_m=0.05)
SPEC = ContactSpec(
    friction=((0.5,) * 4,) * 4, damping_ratio=((1.0,) * 4,) * 4, rate_radps=0.25 / DT, grip=GRIP
)
LAYOUT = BodyLayout(
    robots=1, joints=0, capsules=0, obstacles=1, has_capsules=True, has_boxes=False, slips=True
)
MASS = np.array([11.0, 5.0])
INERTIA = np.array([[0.3, 0.4, 0.5], [0.2, 0.3, 0.4]])
TURN = Rotation.from_euler("ZYX", [0.4, -0.3, 1.1])
"""Attitude of the robot, and so of its jaws."""


@pytest.fixture(autouse=True)
def x64():
    with jax.enable_x64(True):
        yield


@jax.jit
def solve(p, velocity, force):
    """Return the solution of a step, the robot at ``TURN`` and the body not turned.

    Args:
        p: [2, 3].
        velocity: [2, 6] linear in W, angular in the frame of each.
        force: [2, 6] the same.
    """
    q = jnp.asarray(np.stack([TURN.as_quat(scalar_first=True), [1.0, 0.0, 0.0, 0.0]]))
    mass, inertia = jnp.asarray(MASS), jnp.asarray(INERTIA)
    blocks = jax.vmap(jnp.diag)(jnp.concatenate([jnp.repeat(mass[:, None], 3, 1), inertia], axis=1))
    change = jnp.concatenate([force[:, :3] / mass[:, None], force[:, 3:] / inertia], axis=1)
    bodies = WorldBodies(
        p=p,
        rotation=jax.vmap(quaternion.to_matrix)(q),
        free=jnp.ones(2, bool),
        velocity=velocity.ravel(),
        unconstrained=(velocity + DT * change).ravel(),
        M_robots=blocks[:1],
        M_obstacles=blocks[1:],
    )
    grips = take_hold(GRIP, p[:1], q[:1], p[1:], q[1:])
    points = find_grip_points(GRIP, p[:1], bodies.rotation[:1], None)
    rows = find_grip_rows(GRIP, LAYOUT, grips, points, bodies.p, bodies.rotation)
    far = Touches(
        depth_m=jnp.full(1, -1.0),
        position=jnp.zeros((1, 3)),
        normal=jnp.array([[0.0, 0.0, 1.0]]),
        first=jnp.full(1, LAYOUT.shapes + 1, jnp.int32),
        second=jnp.zeros(1, jnp.int32),
    )
    return resolve_contact(SPEC, LAYOUT, bodies, far, DT, rows)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_body_that_is_pulled_harder_than_friction_slips_and_is_pulled_at_by_that(axis, sign):
    """Robot and body along the line of the force, which is an axis of the jaws."""
    along = sign * TURN.as_matrix()[:, axis]
    p = jnp.asarray(np.stack([-0.6 * along, np.zeros(3)]))
    total, limit = MASS.sum(), LIMITS[axis]
    for pull in (0.5, 1.5):
        # What the grip has to bear for both to move as one is ``pull`` times its limit.
        force = np.zeros((2, 6))
        force[1, :3] = pull * limit * total / MASS[0] * along
        solved = solve(p, jnp.zeros((2, 6)), jnp.asarray(force))
        by_robot = -min(pull, 1.0) * limit * along
        np.testing.assert_allclose(solved.grip_force_n[0], by_robot, atol=2e-3 * limit)
        change = np.reshape(solved.velocity, (2, 6))[:, :3] / DT
        np.testing.assert_allclose(change[0], -by_robot / MASS[0], atol=1e-3 * limit)
        np.testing.assert_allclose(
            change[1], (force[1, :3] + by_robot) / MASS[1], atol=1e-3 * limit
        )


@pytest.mark.parametrize("axis", range(3))
def test_a_body_that_is_turned_harder_than_friction_turns_in_the_jaws(axis):
    """Robot and body with their centres in one point."""
    along, limit = TURN.as_matrix()[:, axis], LIMITS[3 + axis]
    force = np.zeros((2, 6))
    force[1, 3:] = 20.0 * limit * along
    solved = solve(jnp.zeros((2, 3)), jnp.zeros((2, 6)), jnp.asarray(force))
    in_jaws = TURN.inv().apply(np.asarray(solved.grip_moment_nm[0]))
    assert in_jaws[axis] == pytest.approx(-limit, rel=1e-6)
    assert np.all(np.abs(in_jaws) <= np.array(LIMITS[3:]) * (1.0 + 1e-9))
    np.testing.assert_allclose(
        np.reshape(solved.velocity, (2, 6))[0, 3:] / DT, -in_jaws / INERTIA[0], rtol=1e-6
    )


def test_slip_ends_and_nothing_is_drawn_back():
    """A body that slides along the jaws stops after m v^2 / (2 f), and stays there."""
    along = TURN.as_matrix()[:, 2]
    speed, p = 0.3, np.zeros((2, 3))
    velocity = np.zeros((2, 6))
    velocity[1, :3] = speed * along
    start = p.copy()
    for _ in range(120):
        velocity = np.reshape(
            np.asarray(solve(jnp.asarray(p), jnp.asarray(velocity), jnp.zeros((2, 6))).velocity),
            (2, 6),
        )
        p = p + DT * velocity[:, :3]
    together = MASS[1] * speed / MASS.sum() * along
    np.testing.assert_allclose(velocity[:, :3], [together] * 2, atol=1e-3)
    reduced = MASS.prod() / MASS.sum()
    slid = (p[1] - p[0] - start[1] + start[0]) @ along
    assert slid == pytest.approx(reduced * speed**2 / (2.0 * LIMITS[2]), rel=0.06)


def test_limits_are_those_of_two_soft_fingers():
    limits = friction_limits(50.0, 0.3, 0.02)
    np.testing.assert_allclose(limits, [30.0, 50.0, 30.0, 1.0, 0.4, 1.0])


def test_what_slips_too_far_is_lost():
    held, force = jnp.array([True, True, False]), jnp.full((3, 3), 1e3)
    lost = measure_forces(GRIP, held, force, jnp.array([0.049, 0.051, 0.1]))
    assert lost.broke.tolist() == [False, True, False]
    weld = replace(GRIP, friction_limits=None, break_force_n=10.0)
    assert measure_forces(weld, held, force).broke.tolist() == [True, True, False]
