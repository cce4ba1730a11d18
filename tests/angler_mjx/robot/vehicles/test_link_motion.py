"""Terms of the water on links, and kinematics of arms that slide, against other ways to them."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from angler_mjx.robot.vehicles import link_motion
from angler_mjx.robot.vehicles.library import load_vehicle
from angler_mjx.robot.vehicles.link_params import STRIPS, build_links

DENSITY = 1000.0


@pytest.fixture
def links():
    """Links of the shipped arm, in float64."""
    with jax.enable_x64(True):
        yield build_links(load_vehicle("bluerov2_heavy_alpha5"), None)


def sample_velocities(links, seed):
    """Return random velocities [L, 6] of links through the water."""
    return jnp.asarray(np.random.default_rng(seed).normal(size=(len(links.tree.parents), 6)))


def test_the_slope_of_drag_is_minus_its_derivative(links):
    nu_r = sample_velocities(links, 1)
    derivative = jax.jacfwd(link_motion.drag_wrench, argnums=1)(links, nu_r, DENSITY)
    by_link = jnp.stack([derivative[i, :, i] for i in range(len(nu_r))])
    slope = link_motion.drag_slope(links, nu_r, DENSITY)
    np.testing.assert_allclose(slope, -by_link, atol=1e-12)
    np.testing.assert_array_equal(link_motion.drag_slope(links, 0.0 * nu_r, DENSITY), 0.0)


def test_drag_is_that_of_strips_one_by_one(links):
    nu_r = sample_velocities(links, 2)
    expected = np.zeros(nu_r.shape)
    for i, (v, omega) in enumerate(zip(nu_r[:, :3], nu_r[:, 3:], strict=True)):
        axis, length = np.asarray(links.cylinder_axis[i, 0]), links.cylinder_length_m[i, 0]
        for k in range(STRIPS):
            along = ((k + 0.5) / STRIPS - 0.5) * length
            arm = links.cylinder_m[i, 0] + along * axis - links.center_of_mass_m[i]
            water = v + np.cross(omega, arm)
            parallel = (water @ axis) * axis
            across = water - parallel
            force = links.normal_area_m2[i, 0] * np.linalg.norm(across) * across
            force += links.axial_area_m2[i, 0] * np.linalg.norm(parallel) * parallel
            expected[i] -= DENSITY * np.r_[force, np.cross(arm, force)]
    np.testing.assert_allclose(
        link_motion.drag_wrench(links, nu_r, DENSITY), expected, rtol=1e-9, atol=1e-12
    )


def test_a_joint_that_slides_moves_its_link_along_its_axis(links):
    """And the end effector with it, as the Jacobian says."""
    slides = (False, True, False, False, False)
    links = replace(links, tree=replace(links.tree, slides=slides))
    theta = 0.5 * (links.lower + links.upper)
    poses, step = link_motion.locate_links(links, theta), 0.2 * jnp.eye(5)[1]
    moved = link_motion.locate_links(links, theta + step)
    np.testing.assert_allclose(moved.rotation, poses.rotation, atol=1e-12)
    expected = [0.0, 0.0, 1.0, 1.0, 1.0, 1.0]  # base of the arm, shoulder, upper arm and beyond
    np.testing.assert_allclose(
        moved.origin - poses.origin, 0.2 * np.outer(expected, poses.axis[1]), atol=1e-12
    )
    tip = link_motion.locate_end_effector(links, theta)
    derivative = jax.jacfwd(lambda x: link_motion.locate_end_effector(links, x).position)(theta)
    np.testing.assert_allclose(tip.jacobian[:3, 6:], derivative, atol=1e-12)
    np.testing.assert_array_equal(tip.jacobian[3:, 7], 0.0)


def test_turns_are_those_of_rotation_vectors(links):
    axes, angles = np.eye(3)[[0, 1, 2, 0]], np.array([0.3, -1.2, 2.9, 0.0])
    axes[0] = [0.36, -0.48, 0.8]
    expected = Rotation.from_rotvec(angles[:, None] * axes).as_matrix()
    turns = link_motion._turns(jnp.asarray(axes), jnp.asarray(angles))
    np.testing.assert_allclose(turns, expected, atol=1e-12)
