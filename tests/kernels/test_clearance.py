"""Distances against dense numerical minimisation in numpy and against coal's GJK."""

import coal
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import clearance

from ..angler_mjx.compiling import quickly

N = 2500


@pytest.fixture(scope="module", autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


def random_segments(rng, n=N):
    """Random segments; some short, some of no length, some along an axis, some with equal ends."""
    a = rng.uniform(-2, 2, (n, 3))
    d = rng.normal(size=(n, 3))
    d[: n // 10] = 0.0
    d[n // 10 : n // 5, 1:] = 0.0
    d[n // 5 : n // 4] *= 1e-6
    return a, a + d


def random_quaternions(rng, n=N):
    q = rng.normal(size=(n, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def matrix(q):
    w, x, y, z = q.T
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
        ],
        -2,
    )


def minimise(f, n):
    """Least value of n convex functions on [0, 1] by ternary search; f takes and gives [n]."""
    lo, hi = np.zeros(n), np.ones(n)
    for _ in range(90):  # (2/3)^90 = 1e-16
        s, t = lo + (hi - lo) / 3, hi - (hi - lo) / 3
        left = f(s) < f(t)
        lo, hi = np.where(left, lo, s), np.where(left, t, hi)
    return f((lo + hi) / 2)


def outside_box(p, lo, hi):
    return np.linalg.norm(p - np.clip(p, lo, hi), axis=-1)


def to_segment(p, a, b):
    d = b - a
    square = np.maximum((d * d).sum(-1), 1e-300)
    s = np.clip(((p - a) * d).sum(-1) / square, 0, 1)
    return np.linalg.norm(a + s[..., None] * d - p, axis=-1)


def along(a, b, s):
    return a + s[:, None] * (b - a)


# Ternary search finds a minimum where the square of the gap is flat: half the digits of a double
# in the parameter, all of them in the value; 1e-7 covers gaps near zero, where the root is steep.
SEARCH = 1e-7
# coal stops GJK at the tolerance it is given (1e-10 of squared length, so 1e-5 of length).
COAL = 1e-5


def test_point_box_inside_outside():
    rng = np.random.default_rng(0)
    p = rng.uniform(-3, 3, (N, 3))
    lo = rng.uniform(-2, 0, (N, 3))
    hi = lo + rng.uniform(0, 3, (N, 3))
    got = quickly(jax.vmap(clearance.point_box))(p, lo, hi)
    np.testing.assert_allclose(got, outside_box(p, lo, hi), atol=1e-14)  # rounding
    assert np.all(np.asarray(got)[np.all((p > lo) & (p < hi), axis=1)] == 0.0)


def test_segment_point_equals_dense_search(deviation):
    rng = np.random.default_rng(1)
    a, b = random_segments(rng)
    p = rng.uniform(-2, 2, (N, 3))
    got = quickly(jax.vmap(clearance.segment_point))(a, b, p)
    want = minimise(lambda s: np.linalg.norm(along(a, b, s) - p, axis=1), N)
    deviation.close("clearance.segments", got, want, atol=SEARCH)


def test_segment_segment_equals_dense_search(deviation):
    rng = np.random.default_rng(2)
    a1, b1 = random_segments(rng)
    a2, b2 = random_segments(rng)
    parallel = slice(N // 3, N // 2)
    b2[parallel] = a2[parallel] + rng.uniform(-2, 2, (N // 2 - N // 3, 1)) * (b1 - a1)[parallel]
    nearly = slice(N // 2, 2 * N // 3)
    b2[nearly] = a2[nearly] + (b1 - a1)[nearly] + 1e-7 * rng.normal(size=b2[nearly].shape)
    got = quickly(jax.vmap(clearance.segment_segment))(a1, b1, a2, b2)
    want = minimise(lambda s: to_segment(along(a1, b1, s), a2, b2), N)
    deviation.close("clearance.segments", got, want, atol=SEARCH)


def test_segment_segment_in_single_precision(deviation):
    rng = np.random.default_rng(3)
    a1, b1 = random_segments(rng)
    a2 = a1 + 0.3 * rng.normal(size=a1.shape)
    tilt = 10.0 ** rng.uniform(-6, 0, (N, 1))  # crossing at every small angle
    b2 = a2 + (b1 - a1) + tilt * rng.normal(size=a1.shape)
    single = [np.asarray(x, np.float32) for x in (a1, b1, a2, b2)]
    got = quickly(jax.vmap(clearance.segment_segment))(*single)
    a1, b1, a2, b2 = (x.astype(float) for x in single)
    want = minimise(lambda s: to_segment(along(a1, b1, s), a2, b2), N)
    # Half the digits of float32 at the 2 m scale of the coordinates: the parameter of a nearly
    # parallel crossing loses the others, and the gap is flat there.
    deviation.close("clearance.segments_single", got, want, atol=3e-5)


def test_segment_box_equals_dense_search(deviation):
    rng = np.random.default_rng(4)
    a, b = random_segments(rng)
    lo = rng.uniform(-2, 1, (N, 3))
    hi = lo + rng.uniform(0, 2, (N, 3))
    got = quickly(jax.vmap(clearance.segment_box))(a, b, lo, hi)
    want = minimise(lambda s: outside_box(along(a, b, s), lo, hi), N)
    deviation.close("clearance.segments", got, want, atol=SEARCH)
    assert (want < 1e-9).sum() > 50, "the draw holds segments that enter the box"
    single = (np.asarray(x, np.float32) for x in (a, b, lo, hi))
    # Coordinates up to 4 m in float32: 2e-7 each, some operations; flat in the parameter.
    np.testing.assert_allclose(quickly(jax.vmap(clearance.segment_box))(*single), want, atol=3e-6)


def coal_distance(shape1, r1, t1, shape2, r2, t2):
    request = coal.DistanceRequest()
    request.enable_signed_distance = False
    request.gjk_tolerance = 1e-10
    request.gjk_max_iterations = 1000
    result = coal.DistanceResult()
    pose1, pose2 = coal.Transform3s(r1, t1), coal.Transform3s(r2, t2)
    return max(coal.distance(shape1, pose1, shape2, pose2, request, result), 0.0)


def test_capsules_against_every_kind_equal_coal(deviation):
    rng = np.random.default_rng(5)
    kind = rng.integers(0, 3, N)
    size = rng.uniform(0.1, 1.0, (N, 3))
    p, q = rng.uniform(-2, 2, (N, 3)), random_quaternions(rng)
    centre, hull_q = rng.uniform(-2, 2, (N, 3)), random_quaternions(rng)
    half, r = rng.uniform(0.05, 0.6, N), rng.uniform(0.05, 0.3, N)
    R, hull_R = matrix(q), matrix(hull_q)
    axis = hull_R[:, :, 2] * half[:, None]

    @quickly
    @jax.vmap
    def ours(a, b, r, p, q, kind, size):
        return clearance.capsules_obstacle(a[None], b[None], r[None], p, q, kind, size)

    got = np.asarray(ours(centre - axis, centre + axis, r, p, q, kind, size))
    want = np.empty(N)
    for i in range(N):
        x, y, z = size[i]
        shape = (coal.Sphere(x), coal.Box(2 * x, 2 * y, 2 * z), coal.Capsule(x, 2 * y))[kind[i]]
        hull = coal.Capsule(r[i], 2 * half[i])
        want[i] = coal_distance(hull, hull_R[i], centre[i], shape, R[i], p[i])
    deviation.close("clearance.obstacles_coal", np.maximum(got, 0.0), want, atol=COAL)
    assert 100 < (want == 0).sum() < N - 100, "the draw holds both touching and clear pairs"


def test_unions_take_the_least_pair():
    rng = np.random.default_rng(6)
    a1, b1 = random_segments(rng, 40)
    a2, b2 = random_segments(rng, 40)
    r1, r2 = rng.uniform(0.1, 0.3, 40), rng.uniform(0.1, 0.3, 40)
    got = clearance.capsules_capsules(a1[:3], b1[:3], r1[:3], a2[:4], b2[:4], r2[:4])
    pairs = [
        minimise(lambda s, i=i, j=j: to_segment(along(a1[[i]], b1[[i]], s), a2[j], b2[j]), 1)[0]
        - r1[i]
        - r2[j]
        for i in range(3)
        for j in range(4)
    ]
    assert got == pytest.approx(min(pairs), abs=SEARCH)


@pytest.mark.parametrize("shape", [(9, 8, 7), (2, 5, 1)])
def test_capsules_grid_is_exact_below_its_cap(shape, deviation):
    rng = np.random.default_rng(7)
    n, cell, origin = 2000, 1.5, np.array([-3.0, 1.0, -12.0])
    occupied = rng.random(shape) < 0.1
    centre = origin + cell * rng.uniform(-1.5, np.array(shape) + 1.5, (n, 3))
    a, b = centre + rng.uniform(-0.3, 0.3, (2, n, 3))
    a2, b2 = centre + rng.uniform(-0.3, 0.3, (2, n, 3))
    r = np.array([0.1, 0.2])

    @quickly
    @jax.vmap
    def ours(a, b, centre):
        return clearance.capsules_grid(
            a, b, jnp.asarray(r), centre, occupied, jnp.asarray(origin), jnp.asarray(cell)
        )

    got = np.asarray(ours(np.stack([a, a2], 1), np.stack([b, b2], 1), centre))
    every = np.full(n, np.inf)
    for index in np.argwhere(occupied):
        lo = origin + cell * index
        for x, y, radius in ((a, b, r[0]), (a2, b2, r[1])):
            gap = minimise(lambda s, x=x, y=y, lo=lo: outside_box(along(x, y, s), lo, lo + cell), n)
            every = np.minimum(every, gap - radius)
    ends = [np.linalg.norm(e - centre, axis=1) for e in (a, b, a2, b2)]
    cap = cell - np.maximum(np.maximum(*ends[:2]) + r[0], np.maximum(*ends[2:]) + r[1])
    deviation.close("clearance.grid", got, np.minimum(every, cap), atol=SEARCH)
    assert (every < cap).sum() > 100, "the draw holds hulls near cells"


def test_point_grid_gives_distance_and_outward_normal():
    rng = np.random.default_rng(8)
    n, cell, origin, shape = 2000, 0.8, np.array([1.0, -2.0, 0.5]), (6, 5, 7)
    occupied = rng.random(shape) < 0.1
    p = origin + cell * rng.uniform(-0.5, np.array(shape) + 0.5, (n, 3))

    @quickly
    @jax.vmap
    def ours(p):
        return clearance.point_grid(p, occupied, jnp.asarray(origin), jnp.asarray(cell))

    distance, normal = (np.asarray(x) for x in ours(p))
    corners = origin + cell * np.argwhere(occupied)
    gap = outside_box(p[:, None], corners, corners + cell)
    want = gap.min(axis=1)
    np.testing.assert_allclose(distance, np.minimum(want, cell), atol=1e-12)  # rounding
    near = (want > 0) & (want < cell)
    low = corners[gap.argmin(axis=1)]
    touch = p - distance[:, None] * normal
    np.testing.assert_allclose(touch[near], np.clip(p, low, low + cell)[near], atol=1e-12)
    inside = want == 0
    assert inside.sum() > 50
    leaving = ((p - low - cell / 2) * normal).sum(axis=1)
    assert np.all(leaving[inside] > 0)
    np.testing.assert_allclose(np.linalg.norm(normal[near | inside], axis=1), 1.0, atol=1e-12)


def test_gradients_equal_finite_differences_and_stay_finite_in_contact():
    rng = np.random.default_rng(9)
    n = 400
    a, b = random_segments(rng, n)
    size = rng.uniform(0.1, 1.0, (n, 3))
    p, q, kind = rng.uniform(-2, 2, (n, 3)), random_quaternions(rng, n), rng.integers(0, 3, n)
    r = np.array([0.1])

    def gap(x, a, b, p, q, kind, size):
        return clearance.capsules_obstacle((a + x)[None], (b + x)[None], r, p, q, kind, size)

    both = quickly(jax.vmap(jax.value_and_grad(gap)))
    args = (a, b, p, q, kind, size)
    value, grad = both(np.zeros((n, 3)), *args)
    assert np.all(np.isfinite(grad))
    step, numeric = 1e-6, np.empty((n, 3))
    for i in range(3):
        shift = np.zeros((n, 3))
        shift[:, i] = step
        numeric[:, i] = (both(shift, *args)[0] - both(-shift, *args)[0]) / (2 * step)
    # Away from contact. Kinks of the distance itself (equally near features) have no gradient; they
    # are no wider than a step, and none of the draws meets one.
    clear = np.asarray(value) > 1e-3
    # Moving straight away gains as much distance as is moved, whichever feature is nearest; but for
    # some roundings of float64, in gaps that are small against where the shapes are.
    np.testing.assert_allclose(np.linalg.norm(grad, axis=1)[clear], 1.0, rtol=1e-12)
    error = np.abs(np.asarray(grad) - numeric).max(axis=1)[clear]
    # Central differences: step^2 curvature (1e-12 / 1e-3) plus 1e-16 / step of rounding.
    assert error.max() < 1e-6
