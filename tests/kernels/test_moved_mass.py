"""Inertia and wrench of moved masses against sums over points and derivatives of momentum."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from angler_kernels import moved_mass

RNG = np.random.default_rng(4)
TANK, AT, AXIS = RNG.normal(size=3), RNG.normal(size=3), np.array([0.6, 0.0, -0.8])
DENSITY, CARRIED = 1025.0, 7.0
VALUES = np.array([3e-3, 0.2])


@pytest.fixture(scope="module", autouse=True)
def x64():
    """Numbers are of 64 bits."""
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="module")
def change(x64):
    return moved_mass.mass_change(
        position=jnp.asarray([TANK, AT]),
        axis=jnp.asarray([np.zeros(3), AXIS]),
        mass=jnp.array([0.0, CARRIED]),
        water=jnp.array([DENSITY, 0.0]),
        value=jnp.asarray(VALUES),
    )


def points():
    """Masses that are added and taken away, with their positions."""
    return (
        (DENSITY * VALUES[0], TANK),
        (CARRIED, AT + VALUES[1] * AXIS),
        (-CARRIED, AT),
    )


def momentum(nu):
    """Linear and angular momentum [6] of the points of a body with velocity nu [6]."""
    total = np.zeros(6)
    for mass, at in points():
        linear = mass * (nu[:3] + np.cross(nu[3:], at))
        total += np.concatenate([linear, np.cross(at, linear)])
    return total


def test_inertia_is_that_of_the_points(change):
    M = np.asarray(moved_mass.inertia_matrix(*change))
    np.testing.assert_allclose(M, M.T, atol=1e-12)
    for nu in RNG.normal(size=(4, 6)):
        np.testing.assert_allclose(M @ nu, momentum(nu), rtol=1e-12)


def test_wrench_is_weight_and_the_change_of_momentum_in_a_turning_frame(change):
    M = moved_mass.inertia_matrix(*change)
    q, nu = Rotation.random(random_state=2), RNG.normal(size=6)
    wrench = moved_mass.moved_mass_wrench(
        M, change[0], change[1], jnp.asarray(q.as_quat(scalar_first=True)), jnp.asarray(nu), 9.81
    )
    weight = np.zeros(6)
    for mass, at in points():
        force = q.inv().apply([0.0, 0.0, -9.81 * mass])
        weight += np.concatenate([force, np.cross(at, force)])

    # Fixed in the world about a fixed point, at constant nu: derivatives of its momentum, in F.
    def world_momentum(t):
        turned = Rotation.from_rotvec(nu[3:] * t)
        origin = np.zeros(3)
        for s in (np.arange(200) + 0.5) * t / 200:
            origin = origin + Rotation.from_rotvec(nu[3:] * s).apply(nu[:3]) * t / 200
        P = momentum(nu)
        linear = turned.apply(P[:3])
        return np.concatenate([linear, turned.apply(P[3:]) + np.cross(origin, linear)])

    step = 1e-4
    rate = (world_momentum(step) - world_momentum(-step)) / (2 * step)
    np.testing.assert_allclose(wrench, weight - rate, rtol=1e-6, atol=1e-6)


def test_nothing_moved_changes_nothing():
    zero = jnp.zeros(2)
    dm, h, dI = moved_mass.mass_change(
        position=jnp.asarray([TANK, AT]),
        axis=jnp.asarray([np.zeros(3), AXIS]),
        mass=jnp.array([0.0, CARRIED]),
        water=jnp.array([DENSITY, 0.0]),
        value=zero,
    )
    M = moved_mass.inertia_matrix(dm, h, dI)
    q, nu = jnp.array([1.0, 0, 0, 0]), jnp.ones(6)
    assert not np.any(M)
    assert not np.any(jax.jit(moved_mass.moved_mass_wrench)(M, dm, h, q, nu, 9.81))
