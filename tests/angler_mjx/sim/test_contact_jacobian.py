"""Velocities at points of contact against differences of where the points go, arms included."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from angler_kernels import quaternion
from angler_mjx.robot.vehicles import library, params
from angler_mjx.robot.vehicles.link_motion import JointMotion, move_links
from angler_mjx.sim.physics.contact import resolve
from angler_mjx.sim.physics.contact.layout import BodyLayout
from angler_mjx.sim.physics.contact.mjx_contact import Touches
from angler_mjx.sim.physics.contact.resolve import WorldBodies
from angler_mjx.sim.posture import hull_capsules

STEP = 1e-6


@pytest.fixture
def x64():
    with jax.enable_x64(True):
        yield


@pytest.fixture
def robot(x64):
    config = library.load_vehicle("bluerov2_heavy_alpha5")
    vehicle = params.build_vehicle(config, "wu2018", 16.0)
    return jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], vehicle)


def random_motion(seed, joints):
    rng = np.random.default_rng(seed)
    turn = Rotation.random(random_state=seed).as_quat(scalar_first=True)
    return rng.normal(size=3), turn, rng.normal(size=6), *rng.uniform(-0.5, 0.5, (2, joints))


def ends_in_world(robot, p, q, theta):
    """First ends of the axes of all capsules of a robot's hull, m, in W."""
    a = hull_capsules(robot, jnp.asarray(theta)[None])[0][0]
    return np.asarray(p + jax.vmap(quaternion.rotate, (None, 0))(jnp.asarray(q), a))


def test_points_of_hull_and_arm_move_as_the_jacobian_has_it(robot):
    links = jax.tree.map(lambda leaf: leaf[0], robot.links)
    joints, shapes = links.home.size, int(hull_capsules(robot, robot.links.home)[2].shape[1])
    p, q, nu, theta, speed = random_motion(3, joints)
    theta = np.asarray(links.home) + theta
    layout = BodyLayout(
        robots=1,
        joints=joints,
        capsules=shapes,
        obstacles=0,
        has_capsules=False,
        has_boxes=False,
    )
    motion = JointMotion(position=jnp.asarray(theta), velocity=jnp.asarray(speed))
    screws = move_links(links, motion, jnp.asarray(nu)).screws
    by_link = np.concatenate([np.asarray(links.tree.moves, float), np.zeros((1, joints))])
    of_links = by_link[np.asarray(robot.link_capsules.link[0])]
    moved = np.concatenate([np.zeros((shapes - len(of_links), joints)), of_links])
    matrix = Rotation.from_quat(q, scalar_first=True).as_matrix()
    at = ends_in_world(robot, p, q, theta)
    bodies = WorldBodies(
        p=jnp.asarray(p)[None],
        rotation=jnp.asarray(matrix)[None],
        free=jnp.ones(1, bool),
        velocity=jnp.zeros(layout.velocities),
        unconstrained=jnp.zeros(layout.velocities),
        M_robots=jnp.eye(6 + joints)[None],
        M_obstacles=jnp.zeros((0, 6, 6)),
        screws=screws[None],
        moved=jnp.asarray(moved),
    )
    touches = Touches(
        depth_m=jnp.ones(shapes),
        position=jnp.asarray(at),
        normal=jnp.tile(jnp.array([0.0, 0.0, 1.0]), (shapes, 1)),
        first=jnp.full(shapes, layout.shapes),  # rock
        second=jnp.arange(shapes),
    )
    J = np.asarray(resolve._jacobian(layout, bodies, touches))
    found = J @ np.concatenate([matrix @ nu[:3], nu[3:], speed])

    def moved_by(step):
        turned = (
            Rotation.from_quat(q, scalar_first=True) * Rotation.from_rotvec(step * nu[3:])
        ).as_quat(scalar_first=True)
        return ends_in_world(robot, p + step * (matrix @ nu[:3]), turned, theta + step * speed)

    want = (moved_by(STEP) - moved_by(-STEP)) / (2 * STEP)
    np.testing.assert_allclose(found, want, atol=1e-8)
    assert np.abs(J[-1, :, 6:]).max() > 0.01  # joints move the last link
    assert np.abs(J[0, :, 6:]).max() == 0.0  # and none the hull of the base
    # The other way round where the robot is the first: rock pushed by it moves the other way.
    swapped = Touches(**{**vars(touches), "first": touches.second, "second": touches.first})
    np.testing.assert_array_equal(np.asarray(resolve._jacobian(layout, bodies, swapped)), -J)


def test_effective_mass_is_that_of_the_inverse_of_the_whole_inertia(x64):
    layout = BodyLayout(
        robots=1, joints=2, capsules=1, obstacles=2, has_capsules=True, has_boxes=False
    )
    rng = np.random.default_rng(0)

    def positive(count, n):
        root = rng.normal(size=(count, n, n))
        return root @ np.swapaxes(root, 1, 2) + n * np.eye(n)

    robots, obstacles = positive(1, 8), positive(2, 6)
    whole = np.zeros((20, 20))
    whole[:8, :8], whole[8:14, 8:14], whole[14:, 14:] = robots[0], *obstacles
    bodies = WorldBodies(
        p=jnp.zeros((3, 3)),
        rotation=jnp.zeros((3, 3, 3)),
        free=jnp.ones(3, bool),
        velocity=jnp.zeros(20),
        unconstrained=jnp.zeros(20),
        M_robots=jnp.asarray(robots),
        M_obstacles=jnp.asarray(obstacles),
    )
    rows = rng.normal(size=(5, 20))
    found = np.asarray(resolve._inverse_mass(layout, bodies, jnp.asarray(rows)))
    np.testing.assert_allclose(found, np.diag(rows @ np.linalg.inv(whole) @ rows.T), rtol=1e-12)
    np.testing.assert_array_equal(np.asarray(resolve._join_blocks(bodies)), whole)
