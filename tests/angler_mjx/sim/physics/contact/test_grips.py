"""Robots that hold a body, in vacuum: against one rigid body, and against momentum."""

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
    let_go,
    measure_forces,
    take_hold,
)
from angler_mjx.sim.physics.contact.layout import BodyLayout
from angler_mjx.sim.physics.contact.mjx_contact import Touches
from angler_mjx.sim.physics.contact.resolve import ContactSpec, WorldBodies, resolve_contact

DT = 0.005
GRIP = GripSpec(body=0)
SPEC = ContactSpec(
    friction=((0.5,) * 4,) * 4, damping_ratio=((1.0,) * 4,) * 4, rate_radps=0.25 / DT, grip=GRIP
)
LAYOUT = BodyLayout(robots=2, joints=0, capsules=0, obstacles=1, has_capsules=True, has_boxes=False)
MASS = np.array([11.0, 13.0, 6.0])
INERTIA = np.array([[0.3, 0.4, 0.5], [0.2, 0.3, 0.3], [3.0, 3.0, 0.05]])
P = np.array([[-1.2, 0.1, 0.4], [1.1, -0.2, 0.3], [0.0, 0.0, 0.0]])
Q = Rotation.from_euler("ZYX", [[0.3, 0.0, 0.1], [2.0, -0.2, 0.0], [0.0, np.pi / 2, 0.0]])


@pytest.fixture(autouse=True)
def x64():
    with jax.enable_x64(True):
        yield


def no_touches():
    """Return a candidate that is far away."""
    return Touches(
        depth_m=jnp.full(1, -1.0),
        position=jnp.zeros((1, 3)),
        normal=jnp.array([[0.0, 0.0, 1.0]]),
        first=jnp.full(1, LAYOUT.shapes + 1, jnp.int32),
        second=jnp.zeros(1, jnp.int32),
    )


def wxyz(rotation):
    """Return attitudes as the simulator has them."""
    return rotation.as_quat(scalar_first=True)


@jax.jit
def solve(p, q, velocity, force, grips):
    """Return the solution of a step of bodies; ``force`` [3, 6] in W, moments in F."""
    mass, inertia = jnp.asarray(MASS), jnp.asarray(INERTIA)
    blocks = jax.vmap(jnp.diag)(jnp.concatenate([jnp.repeat(mass[:, None], 3, 1), inertia], axis=1))
    omega = velocity[:, 3:]
    gyroscopic = jnp.cross(omega, inertia * omega)
    change = [force[:, :3] / mass[:, None], (force[:, 3:] - gyroscopic) / inertia]
    bodies = WorldBodies(
        p=p,
        rotation=jax.vmap(quaternion.to_matrix)(q),
        free=jnp.ones(3, bool),
        velocity=velocity.ravel(),
        unconstrained=(velocity + DT * jnp.concatenate(change, axis=1)).ravel(),
        M_robots=blocks[:2],
        M_obstacles=blocks[2:],
    )
    points = find_grip_points(GRIP, bodies.p[:2], bodies.rotation[:2], None)
    rows = find_grip_rows(GRIP, LAYOUT, grips, points, bodies.p, bodies.rotation)
    return resolve_contact(SPEC, LAYOUT, bodies, no_touches(), DT, rows), bodies.unconstrained


def hold(p=P, q=Q):
    """Return grips of both robots on the body."""
    q = jnp.asarray(wxyz(q))
    return take_hold(GRIP, jnp.asarray(p[:2]), q[:2], jnp.asarray(p[2:]), q[2:])


def as_one_body(force):
    """Return accelerations [3, 6] (angular in F) of the bodies at rest, joined to one; forces in W.

    Args:
        force: [3, 6] on each at its centre, moments in its frame.
    """
    total = MASS.sum()
    center = MASS @ P / total
    turn = Q.as_matrix()
    inertia = np.zeros((3, 3))
    moment = np.zeros(3)
    for i in range(3):
        arm = P[i] - center
        inertia += turn[i] @ np.diag(INERTIA[i]) @ turn[i].T
        inertia += MASS[i] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        moment += np.cross(arm, force[i, :3]) + turn[i] @ force[i, 3:]
    linear, angular = force[:, :3].sum(axis=0) / total, np.linalg.solve(inertia, moment)
    return np.array(
        [[*(linear + np.cross(angular, P[i] - center)), *(turn[i].T @ angular)] for i in range(3)]
    )


def test_bodies_that_are_held_accelerate_as_one(deviation):
    rng = np.random.default_rng(0)
    for _ in range(20):
        force = rng.normal(size=(3, 6)) * [20.0] * 3 + rng.normal(size=(3, 6)) * 2.0
        solved, _ = solve(P, wxyz(Q), np.zeros((3, 6)), force, hold())
        found = np.reshape(solved.velocity, (3, 6)) / DT
        want = as_one_body(force)
        # Each of the twelve rows stays behind what it asks for by SOFTNESS, 5e-4.
        scale = np.abs(force / np.concatenate([np.repeat(MASS[:, None], 3, 1), INERTIA], 1)).max()
        deviation("contact.grip_acceleration", np.abs(found - want) / scale, 12 * 5e-4)
        pull = np.asarray(solved.grip_force_n)
        by_body = MASS[2] * want[2, :3] - force[2, :3]
        np.testing.assert_allclose(pull.sum(axis=0), by_body, atol=2e-3 * scale * MASS[2])


def test_a_spinning_pair_keeps_its_shape_and_its_momentum(deviation):
    """Float with the simulator's step of poses, semi-implicit."""
    grips = hold()
    turn = Q.as_matrix()
    omega = np.array([0.1, -0.2, 0.5])
    center = MASS @ P / MASS.sum()
    velocity = np.array(
        [
            [*(0.3 + np.cross(omega, p - center)), *(t.T @ omega)]
            for p, t in zip(P, turn, strict=True)
        ]
    )
    p, q = P.copy(), wxyz(Q)

    def momentum():
        turn = Rotation.from_quat(q, scalar_first=True).as_matrix()
        linear = MASS[:, None] * velocity[:, :3]
        spin = [t @ (i * v) for t, i, v in zip(turn, INERTIA, velocity[:, 3:], strict=True)]
        return linear.sum(axis=0), np.sum(spin, axis=0) + np.cross(p, linear).sum(axis=0)

    before = momentum()
    for _ in range(800):
        solved, _ = solve(p, q, velocity, np.zeros((3, 6)), grips)
        velocity = np.reshape(np.asarray(solved.velocity), (3, 6))
        p = p + DT * velocity[:, :3]
        q = wxyz(
            Rotation.from_quat(q, scalar_first=True) * Rotation.from_rotvec(DT * velocity[:, 3:])
        )
    after = momentum()
    deviation("contact.grip_momentum", np.abs(after[0] - before[0]) / 9.0, 1e-9)
    # Angular momentum is kept to first order in the step, as of any free body here.
    np.testing.assert_allclose(after[1], before[1], atol=0.02 * np.linalg.norm(before[1]))
    final = Rotation.from_quat(q, scalar_first=True)
    at = final[2].inv().apply(p[:2] - p[2])
    begin = Q[2].inv().apply(P[:2] - P[2])
    assert np.abs(at - begin).max() < 2e-4
    apart = (final[2].inv() * final[:2]) * (Q[2].inv() * Q[:2]).inv()
    assert apart.magnitude().max() < 2e-4


def test_an_error_of_position_is_drawn_back_critically_damped():
    """Against x'' = -w^2 x - 2 w x', in steps."""
    grips = hold()
    p, q, velocity = P.copy(), wxyz(Q), np.zeros((3, 6))
    p[0] += [0.01, 0.0, 0.0]
    errors = []
    for _ in range(60):
        solved, _ = solve(p, q, velocity, np.zeros((3, 6)), grips)
        velocity = np.reshape(np.asarray(solved.velocity), (3, 6))
        p = p + DT * velocity[:, :3]
        q = wxyz(
            Rotation.from_quat(q, scalar_first=True) * Rotation.from_rotvec(DT * velocity[:, 3:])
        )
        turn = Rotation.from_quat(q, scalar_first=True)[2]
        errors.append(np.linalg.norm(turn.apply(np.asarray(grips.position_m[0])) + p[2] - p[0]))
    rate, x, v, want = 0.25 / DT, 0.01, 0.0, []
    for _ in range(60):
        v += DT * (-(rate**2) * x - 2.0 * rate * v)
        x += DT * v
        want.append(abs(x))
    np.testing.assert_allclose(errors, want, atol=2e-4)
    assert errors[-1] < 1e-5


def test_a_grip_breaks_above_its_force_and_stays_broken():
    spec = GripSpec(body=0, break_force_n=30.0)
    alive = jnp.array([True, True])

    def pull(grips, *n):
        force = jnp.array([[n[0], 0.0, 0.0], [0.0, n[1], 0.0]])
        return let_go(grips, measure_forces(spec, grips.held, force), alive)

    grips = pull(hold(), 29.0, 30.5)
    assert grips.held.tolist() == [True, False]
    assert measure_forces(spec, grips.held, jnp.full((2, 3), 99.0)).broke.tolist() == [True, False]
    assert pull(grips, 0.0, 0.0).held.tolist() == [True, False]
    weak = measure_forces(spec, hold().held, jnp.zeros((2, 3)))
    assert let_go(hold(), weak, ~alive).held.tolist() == [False, False]
    strong = measure_forces(GRIP, hold().held, jnp.full((2, 3), 1e9))
    assert let_go(hold(), strong, alive).held.all()


def test_what_is_not_held_moves_on_freely():
    force = np.random.default_rng(1).normal(size=(3, 6)) * 5.0
    alone = replace(hold(), held=jnp.array([False, False]))
    solved, free = solve(P, wxyz(Q), np.zeros((3, 6)), force, alone)
    np.testing.assert_allclose(solved.velocity, free, rtol=1e-12, atol=1e-12)
    assert not np.any(solved.touched)
    np.testing.assert_array_equal(solved.grip_force_n, 0.0)


def test_internal_forces_are_those_that_move_nothing():
    pull = jnp.array([[10.0, 0.0, 3.0], [-6.0, 0.0, 3.0]])
    found = measure_forces(GRIP, jnp.array([True, True]), pull)
    np.testing.assert_allclose(found.force_n, [np.hypot(10, 3), np.hypot(6, 3)])
    np.testing.assert_allclose(found.internal_n, [8.0, 8.0])
    alone = measure_forces(GRIP, jnp.array([True, False]), pull)
    np.testing.assert_allclose(alone.internal_n, [0.0, 0.0])
    np.testing.assert_allclose(alone.force_n, [np.hypot(10, 3), 0.0])


@pytest.mark.parametrize("body", [0, 1])
def test_rows_are_velocities_and_errors_of_the_held_body_against_the_robots(body):
    """Of two bodies the one that is held, wherever it stands among them."""
    rng = np.random.default_rng(2)
    layout, spec = replace(LAYOUT, obstacles=2), GripSpec(body=body)
    p = np.concatenate([P, [[0.4, -0.3, 0.6]]])
    turned = Rotation.concatenate([Q, Rotation.from_rotvec([0.3, -0.5, 0.2])])
    turn = turned.as_matrix()

    @jax.jit
    def find_rows(p, turn):
        """Return rows at a pose of grips that were taken at the first one."""
        grips = take_hold(spec, *start)
        points = find_grip_points(spec, p[:2], turn[:2], None)
        rows = find_grip_rows(spec, layout, grips, points, p, turn)
        return rows.J, rows.error

    q = jnp.asarray(wxyz(turned))
    start = jnp.asarray(p[:2]), q[:2], jnp.asarray(p[2:]), q[2:]
    J, error = find_rows(p, turn)
    velocity = rng.normal(size=(4, 6))  # linear in W, angular in the frame of each
    angular = np.einsum("bij,bj->bi", turn, velocity[:, 3:])
    held = 2 + body
    at_grip = velocity[held, :3] + np.cross(angular[held], p[:2] - p[held])
    want = np.concatenate([at_grip - velocity[:2, :3], angular[held] - angular[:2]], axis=1)
    np.testing.assert_allclose(J @ velocity.ravel(), want, atol=1e-12)
    np.testing.assert_allclose(error, 0.0, atol=1e-12)
    # After a short time the error is the way at those velocities.
    time_s = 1e-6
    later = Rotation.from_rotvec(time_s * angular) * turned
    _, error = find_rows(p + time_s * velocity[:, :3], later.as_matrix())
    np.testing.assert_allclose(error / time_s, want, atol=1e-4)
