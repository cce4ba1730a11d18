"""The referee's own distances: closed forms, a dense search, and coal."""

import numpy as np
import pytest

from angler_mjx.testing.referee import geometry
from angler_mjx.testing.referee.geometry import (
    rotate,
    rotate_back,
    segment_box,
    segment_point,
    segment_segment,
)


def units(rng, n):
    q = rng.normal(size=(n, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def test_a_quarter_turn_about_up_takes_forward_to_left():
    q = np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
    np.testing.assert_allclose(rotate(q, np.array([1.0, 0.0, 0.0])), [0.0, 1.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(
        rotate_back(q, np.array([0.0, 1.0, 0.0])), [1.0, 0.0, 0.0], atol=1e-15
    )


def test_turns_keep_lengths_and_undo_each_other():
    rng = np.random.default_rng(0)
    q, v = 3.0 * units(rng, 100), rng.normal(size=(100, 3))
    np.testing.assert_allclose(np.linalg.norm(rotate(q, v), axis=1), np.linalg.norm(v, axis=1))
    np.testing.assert_allclose(rotate_back(q, rotate(q, v)), v, atol=1e-12)


@pytest.mark.parametrize(
    ("p", "distance"),
    [
        ((0.5, 2.0, 0.0), 2.0),
        ((-3.0, 4.0, 0.0), 5.0),
        ((1.0, 0.0, 0.0), 0.0),
        ((2.0, 0, 1), 2**0.5),
    ],
)
def test_segment_to_point(p, distance):
    a, b = np.zeros(3), np.array([1.0, 0.0, 0.0])
    assert segment_point(a, b, np.array(p)) == pytest.approx(distance, abs=1e-15)


def test_a_segment_without_length_is_a_point():
    a, c, d = np.zeros(3), np.array([3.0, 4.0, 0.0]), np.array([3.0, 4.0, 9.0])
    assert segment_point(a, a, c) == pytest.approx(5.0)
    assert segment_segment(a, a, c, d) == pytest.approx(5.0)
    assert segment_segment(c, d, a, a) == pytest.approx(5.0)
    assert segment_box(c, c, np.ones(3)) == pytest.approx(np.hypot(2.0, 3.0))


@pytest.mark.parametrize(
    ("c", "d", "distance"),
    [
        ((0.5, -1.0, 0.7), (0.5, 1.0, 0.7), 0.7),  # above the middle, across
        ((0.0, 1.0, 0.0), (1.0, 1.0, 0.0), 1.0),  # parallel
        ((2.0, 1.0, 0.0), (4.0, 1.0, 0.0), 2**0.5),  # parallel, beside
        ((3.0, 0.0, 0.0), (5.0, 0.0, 0.0), 2.0),  # in a row
        ((0.5, 0.0, -1.0), (0.5, 0.0, 1.0), 0.0),  # crossing
    ],
)
def test_segment_to_segment(c, d, distance):
    a, b = np.zeros(3), np.array([1.0, 0.0, 0.0])
    c, d = np.array(c, float), np.array(d, float)
    assert segment_segment(a, b, c, d) == pytest.approx(distance, abs=1e-15)
    assert segment_segment(d, c, b, a) == pytest.approx(distance, abs=1e-15)


@pytest.mark.parametrize(
    ("a", "b", "distance"),
    [
        ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), 0.0),  # inside
        ((-3.0, 0.0, 0.0), (3.0, 0.0, 0.0), 0.0),  # through
        ((-3.0, 0.0, 3.5), (3.0, 0.0, 3.5), 0.5),  # over the face
        ((2.0, 3.0, -9.0), (2.0, 3.0, 9.0), 2**0.5),  # along an edge
        ((2.0, 3.0, 4.0), (5.0, 7.0, 9.0), 3**0.5),  # from a corner on
        ((2.0, 0.0, 3.0), (0.0, 0.0, 5.0), 0.5**0.5),  # x + z = 5 past the edge x = 1, z = 3
    ],
)
def test_segment_to_box(a, b, distance):
    half = np.array([1.0, 2.0, 3.0])
    found = segment_box(np.array(a, float), np.array(b, float), half)
    assert found == pytest.approx(distance, abs=1e-15)


def test_no_point_of_a_segment_is_nearer_than_it_is_said_to_be():
    rng = np.random.default_rng(1)
    n = 300
    a, b, c, d = rng.uniform(-2.0, 2.0, (4, n, 3))
    half = rng.uniform(0.1, 1.0, (n, 3))
    s = np.linspace(0.0, 1.0, 2001)[:, None, None]
    along = a + s * (b - a)
    boxes = np.linalg.norm(np.maximum(np.abs(along) - half, 0.0), axis=2).min(axis=0)
    others = segment_point(c, d, along).min(axis=0)
    for found, dense in ((segment_box(a, b, half), boxes), (segment_segment(a, b, c, d), others)):
        assert np.all(found <= dense + 1e-12)
        assert np.all(dense - found < 2e-3)


@pytest.mark.parametrize("kind", ["capsule", "box", "sphere"])
def test_capsules_agree_with_coal(kind):
    coal = pytest.importorskip("coal")
    rng = np.random.default_rng(2)
    found, theirs = [], []
    for q, p in zip(units(rng, 400), rng.uniform(-1.5, 1.5, (400, 3)), strict=True):
        length, radius, size = *rng.uniform(0.05, 0.5, 2), rng.uniform(0.1, 0.6, 3)
        half = np.array([0.0, 0.0, 0.5 * length])
        a, b = p + rotate(q, -half), p + rotate(q, half)
        pose = coal.Transform3s()
        pose.setRotation(np.stack([rotate(q, axis) for axis in np.eye(3)], axis=1))
        pose.setTranslation(p)
        shape = {
            "capsule": lambda s=size: coal.Capsule(s[0], 2.0 * s[1]),
            "box": lambda s=size: coal.Box(*(2.0 * s)),
            "sphere": lambda s=size: coal.Sphere(s[0]),
        }[kind]()
        up = np.array([0.0, 0.0, size[1]])
        ours = {
            "capsule": lambda a=a, b=b, up=up, s=size: segment_segment(a, b, -up, up) - s[0],
            "box": lambda a=a, b=b, s=size: segment_box(a, b, s),
            "sphere": lambda a=a, b=b, s=size: segment_point(a, b, np.zeros(3)) - s[0],
        }[kind]()
        answer = coal.DistanceResult()
        request = coal.DistanceRequest()
        coal.distance(
            coal.Capsule(radius, length), pose, shape, coal.Transform3s(), request, answer
        )
        if answer.min_distance > 0.0:  # coal's depth of penetration is another thing
            found.append(float(ours - radius))
            theirs.append(answer.min_distance)
    assert len(found) > 200
    np.testing.assert_allclose(found, theirs, atol=1e-6)


def test_it_is_double_precision():
    a, b = np.zeros(3, np.float32), np.ones(3, np.float32)
    assert geometry.segment_point(a.astype(float), b.astype(float), np.ones(3) * 2).dtype == float
