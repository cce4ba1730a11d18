"""Outlines of shapes against closed forms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from angler_mjx.report.plotting.outlines import project_outline, rotation_matrix
from angler_mjx.world.obstacles import BOX, CAPSULE, SPHERE

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
CENTRE = np.array([1.0, -2.0, -7.0])
# A circle is drawn with 48 corners; its polygon's area is sin(d)/d with d = 2 pi / 48 of the true.
POLYGON = np.sin(2 * np.pi / 48) / (2 * np.pi / 48)


def _area(corners):
    x, y = corners.T
    return 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))


def test_rotation_equals_scipy():
    for q in np.random.default_rng(0).normal(size=(20, 4)):
        q = q / np.linalg.norm(q)
        # Two orders of summation in float64.
        np.testing.assert_allclose(
            rotation_matrix(q), Rotation.from_quat(q[[1, 2, 3, 0]]).as_matrix(), atol=1e-14
        )


def test_a_sphere_is_a_circle_from_every_side():
    for plane in ((0, 1), (0, 2)):
        corners = project_outline(SPHERE, np.array([0.5, 0.0, 0.0]), CENTRE, LEVEL, plane)
        assert _area(corners) == pytest.approx(np.pi * 0.25 * POLYGON, rel=1e-12)
        np.testing.assert_allclose(corners.mean(axis=0), CENTRE[list(plane)], atol=1e-12)


def test_a_box_shows_its_faces():
    size = np.array([1.0, 0.5, 0.25])
    yaw = Rotation.from_euler("z", 30, degrees=True).as_quat()[[3, 0, 1, 2]]
    assert _area(project_outline(BOX, size, CENTRE, yaw, (0, 1))) == pytest.approx(2.0 * 1.0)
    # From the south a turned box is as wide as its diagonal's shadow.
    wide = 2 * (np.cos(np.pi / 6) * 1.0 + np.sin(np.pi / 6) * 0.5)
    assert _area(project_outline(BOX, size, CENTRE, yaw, (0, 2))) == pytest.approx(wide * 0.5)


def test_a_capsule_is_a_circle_along_its_axis_and_a_stadium_across():
    size = np.array([0.4, 0.6, 0.0])
    circle = np.pi * 0.16 * POLYGON
    assert _area(project_outline(CAPSULE, size, CENTRE, LEVEL, (0, 1))) == pytest.approx(circle)
    across = _area(project_outline(CAPSULE, size, CENTRE, LEVEL, (0, 2)))
    assert across == pytest.approx(circle + 2 * 0.4 * 1.2)
