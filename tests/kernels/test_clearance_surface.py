"""Signed surface of a grid of cells against all cells in NumPy, in double precision."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from angler_kernels import clearance

from ..angler_mjx.compiling import quickly

ORIGIN, CELL = np.array([-3.1, 1.7, -12.3]), 0.7
ROUNDING = 1e-12
"""Of coordinates up to 20 m in float64, in some operations."""
SEGMENT_SAMPLES = np.linspace(0.0, 1.0, 201)
SHAPES = [(6, 5, 7), (2, 5, 1), (1, 1, 1)]


@pytest.fixture(scope="module", autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


def boxes(occupied, origin=ORIGIN, cell=CELL):
    """Lower corners of all occupied cells, and of all free ones with two rings around the grid."""
    padded = np.pad(occupied, 2)
    return [origin + cell * (np.argwhere(kind) - 2) for kind in (padded, ~padded)]


def nearest(p, lo, cell=CELL):
    """Distances [n] of points to the nearest of some cells, and vectors [n, 3] to its points."""
    if not len(lo):
        return np.full(len(p), np.inf), np.full((len(p), 3), np.inf)
    gap = np.clip(p[:, None], lo, lo + cell) - p[:, None]
    length = np.linalg.norm(gap, axis=-1)
    rows = np.arange(len(p)), length.argmin(axis=1)
    return length[rows], gap[rows]


def signed(p, occupied, origin=ORIGIN, cell=CELL):
    """Signed distances [n], cut at one cell, by all cells."""
    rock, free = boxes(occupied, origin, cell)
    outside, inside = nearest(p, rock, cell)[0], nearest(p, free, cell)[0]
    return np.where(outside > 0, np.minimum(outside, cell), -np.minimum(inside, cell))


def surfaces(p, occupied, origin=ORIGIN, cell=CELL, dtype=float):
    """Distances [n] and normals [n, 3] of the kernel."""
    grid = jnp.asarray(occupied), jnp.asarray(origin, dtype), jnp.asarray(cell, dtype)
    return tuple(np.asarray(x) for x in _surfaces(jnp.asarray(p, dtype), *grid))


def segments(a, b, occupied, origin=ORIGIN, cell=CELL, dtype=float):
    """Parameters [n], distances [n] and normals [n, 3] of the kernel."""
    grid = jnp.asarray(occupied), jnp.asarray(origin, dtype), jnp.asarray(cell, dtype)
    ends = jnp.asarray(a, dtype), jnp.asarray(b, dtype)
    return tuple(np.asarray(x) for x in _segments(*ends, *grid))


def _with_neighbours(kernel):
    """Kernel that takes occupied cells [nx, ny, nz] in place of packed neighbours."""

    def run(*args):
        *points, occupied, origin, cell = args
        return kernel(*points, clearance.cell_neighbours(occupied), origin, cell)

    return run


_surfaces = quickly(jax.vmap(_with_neighbours(clearance.point_surface), (0, None, None, None)))
_segments = quickly(jax.vmap(_with_neighbours(clearance.segment_surface), (0, 0, None, None, None)))


def points_around(rng, shape, n):
    return ORIGIN + CELL * rng.uniform(-1.5, np.array(shape) + 1.5, (n, 3))


@pytest.mark.parametrize("fill", [0.1, 0.5, 0.95, 1.0])
@pytest.mark.parametrize("shape", SHAPES)
def test_points_have_the_signed_distance_of_all_cells(shape, fill, deviation):
    rng = np.random.default_rng(1)
    occupied = rng.random(shape) < fill
    occupied.flat[0] = True
    p = points_around(rng, shape, 3000)
    distance, normal = surfaces(p, occupied)
    want = signed(p, occupied)
    deviation.close("clearance.surface", distance, want, atol=ROUNDING)
    assert (want < 0).sum() > 20
    assert (want > 0).sum() > 20
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-14)


@pytest.mark.parametrize("shape", SHAPES)
def test_normals_lead_from_the_surface_to_points_outside_and_out_of_rock_inside(shape):
    rng = np.random.default_rng(2)
    occupied = rng.random(shape) < 0.4
    occupied.flat[-1] = True
    p = points_around(rng, shape, 3000)
    distance, normal = surfaces(p, occupied)
    rock, free = boxes(occupied)
    near = np.abs(distance) < CELL
    foot = p - distance[:, None] * normal
    # The foot lies on the surface: it touches rock and free space.
    for cells in (rock, free):
        np.testing.assert_allclose(nearest(foot[near], cells)[0], 0.0, atol=1e-13)
    # One step outwards changes the distance by the step: rock is behind, free space in front.
    step = 1e-6 * CELL
    ahead = signed(p + step * normal, occupied) - signed(p - step * normal, occupied)
    np.testing.assert_allclose(ahead[near], 2 * step, rtol=1e-5)
    assert (distance[near] < 0).sum() > 20


def wall(dtype):
    """A wall four cells thick across a grid, its upper plane, and points on all seams near it."""
    occupied = np.zeros((6, 6, 8), bool)
    occupied[:, :, :4] = True
    origin, cell = np.array([0.1, -7.3, 0.0], dtype), dtype(0.3)
    steps = np.arange(2, 5).astype(dtype)
    seams = [origin[i] + cell * steps for i in range(2)]
    nudged = [
        np.concatenate([s, np.nextafter(s, dtype(99)), np.nextafter(s, dtype(-99)), s + cell / 7])
        for s in seams
    ]
    heights = dtype(1.2) + cell * np.array([-0.9, -0.3, -1e-4, 1e-4, 0.3, 0.9], dtype)
    p = np.array(list(itertools.product(*nudged, heights)), dtype)
    return occupied, origin, cell, p


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_flat_wall_has_one_normal_across_its_seams(dtype):
    occupied, origin, cell, p = wall(dtype)
    distance, normal = surfaces(p, occupied, origin, cell, dtype)
    assert distance.dtype == normal.dtype == dtype
    np.testing.assert_array_equal(normal, np.broadcast_to([0.0, 0.0, 1.0], p.shape))
    # Some roundings of the height.
    np.testing.assert_allclose(distance, p[:, 2] - 1.2, atol=8 * np.finfo(dtype).eps)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("side", [-1, 1])
def test_a_point_on_a_wall_has_distance_zero_and_the_outward_normal(axis, side):
    occupied = np.zeros((4, 4, 4), bool)
    np.moveaxis(occupied, axis, 0)[2 if side < 0 else 1] = True
    # Whole numbers: the points lie on the plane exactly, on faces, seams and crossings of seams.
    along = [1.0, 1.25, 1.5, 2.0, 3.0]
    p = np.array([np.insert(uv, axis, 2.0) for uv in itertools.product(along, along)])
    distance, normal = surfaces(p, occupied, np.zeros(3), 1.0)
    np.testing.assert_array_equal(distance, 0.0)
    np.testing.assert_array_equal(normal, np.broadcast_to(side * np.eye(3)[axis], p.shape))


def test_edges_and_corners_of_a_cell_have_normals_out_of_it():
    occupied = np.zeros((3, 3, 3), bool)
    occupied[1, 1, 1] = True
    corners = np.array(list(itertools.product((1.0, 1.5, 2.0), repeat=3)))
    corners = corners[np.any(corners != 1.5, axis=1)]
    distance, normal = surfaces(corners, occupied, np.zeros(3), 1.0)
    np.testing.assert_array_equal(distance, 0.0)
    outward = np.sign(corners - 1.5)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-15)
    # Within the normals of the cell at that edge or corner.
    assert np.all((normal * outward >= 0) & ((outward != 0) | (normal == 0)))


def test_the_border_of_the_grid_is_a_surface():
    occupied = np.ones((3, 4, 5), bool)
    middle = np.array([1.5, 2.0, 2.5])
    for axis, n in enumerate(occupied.shape):
        for edge, sign in ((0.0, -1.0), (float(n), 1.0)):
            p = np.tile(middle, (3, 1))
            p[:, axis] = edge + sign * np.array([-0.25, 0.0, 0.25])
            distance, normal = surfaces(p, occupied, np.zeros(3), 1.0)
            np.testing.assert_array_equal(distance, [-0.25, 0.0, 0.25])
            np.testing.assert_array_equal(normal, np.tile(sign * np.eye(3)[axis], (3, 1)))


def test_deep_rock_and_open_water_are_one_cell_away_from_the_surface():
    p = np.array([[3.5, 3.5, 3.5], [-1e30, 0.0, 0.0], [1e30, 1e30, -1e30], [3.5, 3.5, 9.0]])
    for dtype in (np.float32, np.float64):
        distance, normal = surfaces(p, np.ones((7, 7, 7), bool), np.zeros(3), 1.0, dtype)
        np.testing.assert_array_equal(distance, [-1.0, 1.0, 1.0, 1.0])
        np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, rtol=1e-6)


QUARTERS = st.lists(st.lists(st.integers(-5, 17), min_size=3, max_size=3), min_size=16, max_size=16)
"""Points at quarters of cells: on faces, edges, corners, seams and midway between two walls."""
GRIDS = st.integers(0, 2**27 - 1).map(
    lambda bits: np.array([bits >> i & 1 for i in range(27)], bool).reshape(3, 3, 3)
)
UNIT = {"origin": np.zeros(3), "cell": 1.0}


@settings(max_examples=80, deadline=None)
@given(occupied=GRIDS, quarters=QUARTERS, dtype=st.sampled_from([np.float32, np.float64]))
def test_points_at_ties_have_a_unit_normal_and_the_distance_of_all_cells(occupied, quarters, dtype):
    p = np.array(quarters) / 4.0
    distance, normal = surfaces(p, occupied, **UNIT, dtype=dtype)
    tolerance = 4 * np.finfo(dtype).eps
    np.testing.assert_allclose(distance, signed(p, occupied, **UNIT), atol=tolerance)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=tolerance)
    foot = p - distance[:, None] * normal
    near = np.abs(distance) < 1.0
    for cells in boxes(occupied, **UNIT):
        if near.any():
            assert nearest(foot[near], cells, 1.0)[0].max() <= tolerance


def random_segments(rng, shape, n):
    """Ends of segments of at most one cell, a tenth of them points, a tenth along an axis."""
    a = points_around(rng, shape, n)
    d = rng.normal(size=(n, 3))
    d[: n // 10] = 0.0
    d[n // 10 : n // 5, 1:] = 0.0
    length = np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-9)
    return a, a + CELL * rng.uniform(0, 1, (n, 1)) * d / length


def along(a, b, t):
    return a + t[:, None] * (b - a)


def sampled_signed(a, b, occupied):
    """Signed distances [n, samples] of evenly spaced points of segments, by all cells."""
    return np.stack([signed(a + s * (b - a), occupied) for s in SEGMENT_SAMPLES], axis=1)


@pytest.mark.parametrize("fill", [0.15, 0.6])
@pytest.mark.parametrize("shape", SHAPES)
def test_segments_outside_rock_have_the_distance_of_all_cells(shape, fill, deviation):
    rng = np.random.default_rng(3)
    occupied = rng.random(shape) < fill
    occupied.flat[0] = True
    a, b = random_segments(rng, shape, 200)
    t, distance, normal = segments(a, b, occupied)
    sampled = sampled_signed(a, b, occupied)
    length = np.linalg.norm(b - a, axis=1)
    cap = CELL - length / 2
    outside = sampled.min(axis=1) > 0
    # Between samples the distance falls by at most half their spacing.
    spacing = length / (len(SEGMENT_SAMPLES) - 1)
    want = np.minimum(sampled.min(axis=1), cap)
    assert np.all((distance <= want + 1e-13)[outside])
    assert np.all((distance >= want - spacing / 2 - 1e-13)[outside])
    at = signed(along(a, b, t), occupied)
    deviation.close(
        "clearance.surface", distance[outside], np.minimum(at, cap)[outside], atol=ROUNDING
    )
    assert np.all((t >= 0) & (t <= 1))
    assert (outside & (want < cap)).sum() > 20
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-14)


def test_segments_outside_rock_agree_with_capsules_of_the_same_axis(deviation):
    rng = np.random.default_rng(4)
    occupied, n, r = rng.random((6, 5, 7)) < 0.15, 2000, 0.05
    a, b = random_segments(rng, occupied.shape, n)
    _, distance, _ = segments(a, b, occupied)
    capsules = quickly(jax.vmap(clearance.capsules_grid, (0, 0, None, 0, None, None, None)))(
        a[:, None], b[:, None], jnp.asarray([r]), (a + b) / 2, occupied, ORIGIN, CELL
    )
    deviation.close(
        "clearance.surface", np.maximum(distance, 0.0) - r, np.asarray(capsules), atol=ROUNDING
    )


@pytest.mark.parametrize("shape", SHAPES)
def test_segments_in_rock_name_a_point_near_the_deepest(shape):
    rng = np.random.default_rng(5)
    occupied = rng.random(shape) < 0.6
    occupied.flat[0] = True
    a, b = random_segments(rng, shape, 200)
    t, distance, normal = segments(a, b, occupied)
    sampled = sampled_signed(a, b, occupied)
    deepest = sampled.min(axis=1)
    inside = deepest < 0
    np.testing.assert_allclose(
        distance[inside], signed(along(a, b, t), occupied)[inside], atol=ROUNDING
    )
    length = np.linalg.norm(b - a, axis=1)
    spacing = length / (len(SEGMENT_SAMPLES) - 1)
    first = np.where(sampled < 0, SEGMENT_SAMPLES, np.inf).min(axis=1)
    last = np.where(sampled < 0, SEGMENT_SAMPLES, -np.inf).max(axis=1)
    slack = np.where(inside, last - first, 0.0) * length / 16 + spacing + 1e-13
    # Depths are compared up to one cell less half the length.
    bound = np.maximum(deepest, length / 2 - CELL)
    assert np.all((distance <= bound + slack)[inside])
    assert np.all((distance >= deepest - spacing - 1e-13)[inside])
    assert inside.sum() > 4
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-14)


def test_a_segment_through_a_wall_is_deepest_at_its_end_and_leaves_upwards():
    occupied, origin, cell, _ = wall(float)
    rng = np.random.default_rng(6)
    n = 200
    below = origin + cell * np.stack([*rng.uniform(2, 4, (2, n)), rng.uniform(3.1, 3.9, n)], 1)
    above = below + cell * np.stack([*rng.uniform(-0.4, 0.4, (2, n)), rng.uniform(0, 0.8, n)], 1)
    for a, b, end in ((below, above, 0.0), (above, below, 1.0)):
        t, distance, normal = segments(a, b, occupied, origin, cell)
        np.testing.assert_array_equal(t, end)
        np.testing.assert_allclose(distance, below[:, 2] - 4 * cell, atol=1e-14)
        np.testing.assert_array_equal(normal, np.broadcast_to([0.0, 0.0, 1.0], a.shape))


def test_the_distance_of_a_segment_is_continuous_where_it_enters_an_edge():
    """Its middle meets the edge of a cell; both ends stay free."""
    occupied = np.zeros((3, 3, 3), bool)
    occupied[1, 1, 1] = True
    depth = np.array([-1e-3, -1e-6, -1e-9, 0.0, 1e-9, 1e-6, 1e-3, 0.1])
    middle = np.stack([1 + depth, 1 + depth, np.full_like(depth, 1.5)], axis=1)
    half = np.array([0.3, -0.3, 0.0])
    t, distance, normal = segments(middle - half, middle + half, occupied, **UNIT)
    np.testing.assert_allclose(t[np.abs(depth) > 1e-7], 0.5, atol=1e-6)
    want = np.where(depth < 0, -np.sqrt(2) * depth, -depth)
    np.testing.assert_allclose(distance, want, atol=1e-12)
    assert np.all(normal[:, :2] <= 0)


def test_a_segment_without_length_is_a_point():
    rng = np.random.default_rng(7)
    occupied = rng.random((6, 5, 7)) < 0.5
    p = points_around(rng, occupied.shape, 500)
    _, distance, normal = segments(p, p, occupied)
    want = surfaces(p, occupied)
    np.testing.assert_allclose(distance, want[0], atol=1e-14)
    near = np.abs(distance) < CELL
    np.testing.assert_allclose(normal[near], want[1][near], atol=1e-9)


@settings(max_examples=80, deadline=None)
@given(
    occupied=GRIDS,
    starts=QUARTERS,
    steps=st.lists(st.lists(st.integers(-2, 2), min_size=3, max_size=3), min_size=16, max_size=16),
    dtype=st.sampled_from([np.float32, np.float64]),
)
def test_segments_at_ties_are_finite_and_as_low_as_their_ends(occupied, starts, steps, dtype):
    a = np.array(starts) / 4.0
    b = a + np.array(steps) / 4.0
    t, distance, normal = segments(a, b, occupied, **UNIT, dtype=dtype)
    length = np.linalg.norm(b - a, axis=1)
    tolerance = 8 * np.finfo(dtype).eps
    assert np.all((t >= 0) & (t <= 1))
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=tolerance)
    at = signed(along(a, b, t.astype(float)), occupied, **UNIT)
    np.testing.assert_allclose(distance, np.minimum(at, 1 - length / 2), atol=tolerance)
    lowest = np.min([signed(a + s * (b - a), occupied, **UNIT) for s in np.linspace(0, 1, 9)], 0)
    assert np.all(distance <= np.maximum(lowest, length / 2 - 1) + length / 16 + tolerance)


def test_far_segments_are_clear_and_finite():
    a = np.array([[-1e30, 0.0, 0.0], [1e30, 1e30, -1e30], [1.5, 1.5, 9.0]])
    for dtype in (np.float32, np.float64):
        t, distance, normal = segments(a, a, np.ones((3, 3, 3), bool), **UNIT, dtype=dtype)
        np.testing.assert_array_equal(distance, 1.0)
        assert np.all((t >= 0) & (t <= 1))
        np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, rtol=1e-6)
