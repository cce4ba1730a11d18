"""What MJX's routines see of overlaps: a bound of a known fault, which gives bodies energy."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from angler_mjx.sim.physics.contact import candidates, mjx_contact
from angler_mjx.world.obstacles import BOX, CAPSULE, SPHERE

from .loose_bodies import NO_HULLS, describe, lay_out

PAIRS = 4000


def sample_pairs(other):
    """Return sizes, positions and attitudes of boxes and others, and their true overlaps [m].

    The overlap is the radius less the distance of the nearest of 801 points of the axis from the
    box, below 0 inside it.
    """
    rng = np.random.default_rng(2)
    size = rng.uniform(0.08, 0.25, (PAIRS, 2, 3))
    q = rng.normal(size=(PAIRS, 2, 4))
    q /= np.linalg.norm(q, axis=2, keepdims=True)
    p = rng.uniform(-0.35, 0.35, (PAIRS, 2, 3))
    length = size[:, 1, 1:2] if other == CAPSULE else np.zeros((PAIRS, 1))
    box, body = (Rotation.from_quat(q[:, i], scalar_first=True) for i in range(2))
    axis = body.apply([0.0, 0.0, 1.0]) * length
    points = p[:, 1, None] + np.linspace(-1.0, 1.0, 801)[:, None] * axis[:, None]
    in_box = np.einsum("nij,nkj->nki", box.inv().as_matrix(), points - p[:, 0, None])
    beyond = np.abs(in_box) - size[:, 0, None]
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=2)
    inside = np.max(beyond, axis=2)
    distance = np.where(inside > 0.0, outside, inside).min(axis=1)
    return size, p, q, size[:, 1, 0] - distance, distance > 0.005


def detect(other, *poses):
    """Return the greatest depth [m] that MJX reports of each pair."""
    layout = lay_out(2)

    def find_depth(size, p, q):
        bodies = describe([BOX, other], np.zeros((2, 3)), [1.0, 1.0], [1.0, 1.0])
        hulls = tuple(jnp.asarray(part, p.dtype) for part in NO_HULLS)
        shapes = candidates.locate_shapes(layout, hulls, replace(bodies, size_m=size), p, q)
        return jnp.max(mjx_contact.find_touches(layout, shapes).depth_m)

    single = [jnp.asarray(part, jnp.float32) for part in poses]
    return np.asarray(jax.jit(jax.vmap(find_depth))(*single))


def test_boxes_miss_few_spheres_and_see_the_others_as_they_are():
    """Spheres are capsules without a length: 6 % of overlaps are not seen."""
    *poses, overlap, is_outside = sample_pairs(SPHERE)
    depth = detect(SPHERE, *poses)
    meets = (overlap > 1e-3) & is_outside
    assert meets.sum() > 400
    seen = meets & (depth > 0.0)
    assert np.sum(meets & ~seen) < 0.1 * meets.sum()
    np.testing.assert_allclose(depth[seen], overlap[seen], atol=1e-4)
    assert not np.any(depth[overlap < -1e-3] > 0.0)


@pytest.fixture(scope="module")
def capsules():
    *poses, overlap, is_outside = sample_pairs(CAPSULE)
    return detect(CAPSULE, *poses), overlap, (overlap > 1e-3) & is_outside


def test_boxes_miss_few_capsules_and_see_none_that_is_not_there(capsules):
    """3 % of overlaps are not seen, up to the whole radius: the later force gives energy."""
    depth, overlap, meets = capsules
    assert meets.sum() > 1000
    assert np.mean(depth[meets] <= 0.0) < 0.05
    assert np.mean(depth[meets] < overlap[meets] - 0.005) < 0.15
    assert not np.any(depth[overlap < -1e-3] > 0.0)


def test_what_boxes_see_of_capsules_is_right_in_the_median(capsules):
    depth, overlap, meets = capsules
    seen = meets & (depth > 0.0)
    assert np.median(np.abs(depth - overlap)[seen]) < 1e-4
