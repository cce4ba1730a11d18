"""Points of a carried body that robots hold, in frames."""

from types import SimpleNamespace

import numpy as np

from angler_mjx.report.video.grip_marks import locate_grips
from angler_mjx.world.obstacles import BOX, CAPSULE

TIME_S = np.array([0.0, 1.0, 2.0])
# A capsule along z, turned to lie along x; a quarter turn about z later it lies along y.
ALONG_X = [np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0]
ALONG_Y = [0.5, -0.5, 0.5, 0.5]


def scene(kind=CAPSULE, size=(0.05, 1.2, 0.0), cargo=1, outcome="reached", end_s=3.0):
    robots = [
        SimpleNamespace(
            p_m=np.array([[x, 0.0, -4.6]] * 3), arrived=outcome == "reached", end_time_s=end_s
        )
        for x in (-0.9, 2.0)
    ]
    poses = np.full((3, 2, 3), [0.0, 0.0, -5.0])
    attitudes = np.array([[[1.0, 0.0, 0.0, 0.0], ALONG_X]] * 3)
    return SimpleNamespace(
        cargo=cargo,
        robots=robots,
        obstacle_p_m=poses,
        obstacle_q=attitudes,
        environment=SimpleNamespace(
            obstacles=SimpleNamespace(kind=np.array([BOX, kind]), size_m=np.array([size] * 2))
        ),
    )


def locate(made, q=(ALONG_X, ALONG_X, ALONG_Y)):
    moved = np.array([[0.0, 0.0, -5.0], [1.0, 0.0, -5.0], [1.0, 0.0, -6.0]])
    body_m = np.stack([np.zeros((3, 3)), moved], axis=1)
    body_q = np.array([[[1.0, 0.0, 0.0, 0.0], row] for row in q])
    return locate_grips(made, TIME_S, body_m, body_q)


def test_robots_hold_the_nearest_point_of_the_axis_and_go_with_it():
    found = locate(scene())
    np.testing.assert_allclose(found[0], [[-0.9, 0, -5], [1.2, 0, -5]], atol=1e-9)
    np.testing.assert_allclose(found[1], [[0.1, 0, -5], [2.2, 0, -5]], atol=1e-9)
    np.testing.assert_allclose(found[2], [[1.0, -0.9, -6], [1.0, 1.2, -6]], atol=1e-9)


def test_who_dropped_it_holds_nothing_from_then_on():
    found = locate(scene(outcome="dropped", end_s=1.5))
    assert np.isfinite(found[:2]).all()
    assert np.isnan(found[2]).all()
    assert np.isfinite(locate(scene(end_s=1.5))).all()


def test_without_cargo_there_are_no_grips():
    assert np.isnan(locate(scene(cargo=None))).all()
