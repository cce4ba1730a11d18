"""The camera behind a driven robot."""

import math

import numpy as np
import pytest

from angler_mjx.teleop import live_view
from angler_mjx.world.rock.grid import Grid


def _grid(*rock):
    occupied = np.zeros((6, 6, 6), bool)
    for cell in rock:
        occupied[cell] = True
    return Grid(origin_m=np.array([-3.0, -3.0, -6.0]), cell_m=np.array(1.0), occupied=occupied)


P = np.array([0.5, 0.5, -3.5])


def test_it_is_behind_and_above_and_looks_down_along_the_heading():
    psi = 2.2
    q = np.array([math.cos(psi / 2), 0.0, 0.0, math.sin(psi / 2)])
    at, (w, x, y, z) = live_view.camera_pose(P, q, _grid())
    ahead = np.array([math.cos(psi), math.sin(psi), 0.0])
    np.testing.assert_allclose(at, P - live_view.BACK_M * ahead + [0.0, 0.0, live_view.UP_M])
    looks = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)])
    down = math.cos(live_view.DOWN_RAD) * ahead - [0.0, 0.0, math.sin(live_view.DOWN_RAD)]
    np.testing.assert_allclose(looks, down, atol=1e-12)
    left_z = 2 * (y * z + w * x)
    assert left_z == pytest.approx(0.0)


def test_it_stays_level_while_the_robot_tilts():
    half = 0.2
    rolled, pitched = [math.cos(half), math.sin(half), 0, 0], [math.cos(half), 0, math.sin(half), 0]
    level = live_view.camera_pose(P, np.array([1.0, 0.0, 0.0, 0.0]), _grid())
    for q in (rolled, pitched):
        for seen, same in zip(live_view.camera_pose(P, np.array(q), _grid()), level, strict=True):
            np.testing.assert_allclose(seen, same, atol=1e-12)


def test_it_comes_nearer_where_rock_would_hide_the_robot():
    east = np.array([1.0, 0.0, 0.0, 0.0])
    behind = _grid((2, 3, 2), (2, 3, 3))  # x from -1 to 0, all that lies beside and above
    at, _ = live_view.camera_pose(P, east, behind)
    assert 0.0 <= at[0] < P[0]
    assert at[2] > P[2]


def test_outside_the_cells_there_is_no_rock():
    outside = np.array([-4.0, 0.5, -0.5])
    at, _ = live_view.camera_pose(outside, np.array([1.0, 0.0, 0.0, 0.0]), _grid((0, 3, 5)))
    np.testing.assert_allclose(at - outside, [-live_view.BACK_M, 0.0, live_view.UP_M])
