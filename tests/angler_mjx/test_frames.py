"""Round trips, and agreement of vectors, rotations and quaternions with textbook matrices."""

import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx import frames

# The two conventions as matrices: NED axes in ENU, FRD axes in FLU.
NED_FROM_ENU = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
FRD_FROM_FLU = np.diag([1.0, -1, -1])
# float64 products of numbers near 1: a few rounding errors of 1e-16.
ROUNDING = 1e-14


def rotation(q):
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


@pytest.fixture(scope="module")
def quaternions():
    drawn = np.random.default_rng(3).normal(size=(200, 4))
    return drawn / np.linalg.norm(drawn, axis=1, keepdims=True)


@pytest.mark.parametrize(
    ("there", "back", "size"),
    [
        (frames.vector_enu_to_ned, frames.vector_ned_to_enu, 3),
        (frames.body_flu_to_frd, frames.body_frd_to_flu, 3),
        (frames.body_flu_to_frd, frames.body_frd_to_flu, 6),
        (frames.quaternion_enu_to_ned, frames.quaternion_ned_to_enu, 4),
    ],
)
def test_there_and_back_is_nothing(there, back, size):
    value = np.random.default_rng(size).normal(size=(5, 7, size))
    np.testing.assert_allclose(back(there(value)), value, atol=ROUNDING)


def test_vectors_follow_the_matrices():
    v = np.random.default_rng(1).normal(size=(50, 3))
    np.testing.assert_array_equal(frames.vector_enu_to_ned(v), v @ NED_FROM_ENU.T)
    np.testing.assert_array_equal(frames.body_flu_to_frd(v), v @ FRD_FROM_FLU.T)
    wrench = np.concatenate([v, v[::-1]], axis=1)
    np.testing.assert_array_equal(
        frames.body_flu_to_frd(wrench),
        np.concatenate([v @ FRD_FROM_FLU.T, v[::-1] @ FRD_FROM_FLU.T], axis=1),
    )


def test_attitude_agrees_with_the_change_of_basis(quaternions):
    for q in quaternions:
        expected = NED_FROM_ENU @ rotation(q) @ FRD_FROM_FLU.T
        np.testing.assert_allclose(
            rotation(frames.quaternion_enu_to_ned(q)), expected, atol=ROUNDING
        )


def test_rotated_vector_is_the_same_arrow_in_both_conventions(quaternions):
    v = np.array([0.3, -1.1, 0.7])
    for q in quaternions[:20]:
        in_ned = rotation(frames.quaternion_enu_to_ned(q)) @ frames.body_flu_to_frd(v)
        np.testing.assert_allclose(in_ned, frames.vector_enu_to_ned(rotation(q) @ v), atol=ROUNDING)


def test_a_vehicle_heading_north_has_the_identity_attitude_in_ned():
    half = np.sqrt(0.5)
    north = np.array([half, 0.0, 0.0, half])
    np.testing.assert_allclose(frames.quaternion_enu_to_ned(north), [1.0, 0, 0, 0], atol=ROUNDING)


@pytest.mark.parametrize("namespace", [np, jnp])
def test_kind_and_dtype_are_kept(namespace):
    for function, size in (
        (frames.vector_enu_to_ned, 3),
        (frames.body_flu_to_frd, 6),
        (frames.quaternion_enu_to_ned, 4),
    ):
        given = namespace.ones((2, size), dtype=namespace.float32)
        got = function(given)
        assert type(got) is type(given)
        assert got.dtype == given.dtype


DEGREE_KM = {0: (110.574, 111.320), 15: (110.649, 107.551), 30: (110.852, 96.486)} | {
    45: (111.132, 78.847),
    60: (111.412, 55.800),
    75: (111.618, 28.902),
}
"""Lengths of a degree of latitude and of longitude on WGS84 by latitude, km, as published (National
Geospatial-Intelligence Agency, "Length of a degree of latitude and longitude")."""


@pytest.mark.parametrize(("latitude", "lengths"), DEGREE_KM.items())
@pytest.mark.parametrize("longitude", [-122.3, 0.0, 179.999])
def test_a_small_angle_is_the_published_part_of_a_degree(latitude, lengths, longitude):
    origin = frames.GeodeticOrigin(latitude_deg=latitude, longitude_deg=longitude)
    x, y = frames.geodetic_to_local(origin, latitude, longitude + 0.001)
    assert x == pytest.approx(lengths[1], abs=1e-3)  # metres of a thousandth
    assert abs(y) < 1e-3
    x, y = frames.geodetic_to_local(origin, latitude + 0.001, longitude)
    assert y == pytest.approx(lengths[0], abs=1e-3)
    assert abs(x) < 1e-9


def test_ecef_is_the_published_position():
    """Values of the tests of pymap3d (geodetic2ecef), which are those of MATLAB."""
    x, y, z = frames._geodetic_to_ecef(42.0, -82.0, 200.0)
    assert (x, y, z) == pytest.approx((660675.2518247, -4700948.68316, 4245737.66222), abs=1e-3)


@pytest.mark.parametrize("latitude", [-65.0, 0.0, 47.6, 85.0])
@pytest.mark.parametrize(("x", "y"), [(0.0, 0.0), (123.4, -56.7), (-9000.0, 9000.0)])
def test_local_positions_come_back(latitude, x, y):
    origin = frames.GeodeticOrigin(latitude_deg=latitude, longitude_deg=179.9, altitude_m=300.0)
    there = frames.local_to_geodetic(origin, x, y)
    assert frames.geodetic_to_local(origin, *there) == pytest.approx((x, y), abs=1e-5)
