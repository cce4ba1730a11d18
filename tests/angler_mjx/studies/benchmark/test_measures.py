"""Measures of plans against closed forms; plans as bytes and back."""

import math

import numpy as np
import pytest

from angler_mjx.planning.planner import NoPlan, joint_path, way_points
from angler_mjx.studies.benchmark import measures
from angler_mjx.studies.benchmark import path_archive as bytes_of


def test_length_and_turning_of_a_polygon():
    """Of n sides with circumradius R: 2 n R sin(pi / n), and n - 1 turns of 2 pi / n."""
    n, radius = 12, 3.0
    angle = 2 * math.pi * np.arange(n + 1) / n
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle], axis=1)
    assert measures.length_m(points) == pytest.approx(2 * n * radius * math.sin(math.pi / n))
    assert measures.turn_rad(points) == pytest.approx((n - 1) * 2 * math.pi / n)


def test_turning_back_is_half_a_turn_and_a_small_turn_is_not_lost():
    back = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 0]], float)
    assert measures.turn_rad(back) == pytest.approx(math.pi)
    small = np.array([[0, 0, 0], [1, 0, 0], [2, 1e-6, 0]], float)
    assert measures.turn_rad(small) == pytest.approx(1e-6, rel=1e-6)


def test_repeated_points_turn_nobody():
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 0], [1, 1, 0]], float)
    assert measures.turn_rad(points) == pytest.approx(math.pi / 2)
    assert measures.turn_rad(points[:1]) == 0.0


@pytest.mark.parametrize("joints", [False, True])
def test_plans_come_back_from_bytes_as_they_were(joints, rng):
    def path(n):
        time, place = np.sort(rng.random(n)), rng.random((n, 3))
        if joints:
            return joint_path(time, place, rng.random(n), rng.random((n, 4)))
        return way_points(time, place)

    given = [path(3), NoPlan("why"), path(7)]
    data = bytes_of.pack_paths(given)
    found = bytes_of.unpack_paths(data)
    assert found[1] is None
    for one, two in ((given[0], found[0]), (given[2], found[2])):
        assert type(one) is type(two)
        np.testing.assert_array_equal(one.time_s, two.time_s)
        np.testing.assert_array_equal(bytes_of.points_m(one), bytes_of.points_m(two))
        if joints:
            for name in ("velocity", "acceleration", "degree", "commanded"):
                np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    assert bytes_of.compute_digest(data) == bytes_of.compute_digest(bytes_of.pack_paths(given))
    assert bytes_of.compute_digest(data) != bytes_of.compute_digest(
        bytes_of.pack_paths([given[0], given[2]])
    )
    assert bytes_of.unpack_paths(bytes_of.pack_paths([NoPlan("x")])) == [None]


@pytest.fixture
def rng():
    return np.random.default_rng(5)
