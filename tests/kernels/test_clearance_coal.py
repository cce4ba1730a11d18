"""Clearance of hulls against coal, many poses, in double and in single precision."""

import coal
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import clearance

from ..angler_mjx.compiling import quickly

# coal stops GJK at the tolerance it is given (1e-10 of squared length, so 1e-5 of length).
DOUBLE = 1e-5
KINDS = {jnp.float64: "double", jnp.float32: "single"}
# Numbers that float32 does not hold: the grid itself is rounded in single precision.
SHAPE, CELL, ORIGIN = (12, 12, 12), 1.3, np.array([-7.7, 8.3, -19.9])
N_HULL, N_POSE, N_CAPSULE = 8, 5000, 3


@pytest.fixture(scope="module", autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


def rotations(rng, n):
    q = rng.normal(size=(n, 4))
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, -1) for row in rows], -2), np.stack([w, x, y, z], -1)


def along_z(d):
    """A rotation that takes z to the direction of d."""
    z = d / np.linalg.norm(d)
    x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], 1)


def sample_hulls(rng, n):
    """Ends [n, c, 3] about the origin and radii [n, c]."""
    a, b = rng.uniform(-0.35, 0.35, (2, n, N_CAPSULE, 3))
    return a, b, rng.uniform(0.05, 0.2, (n, N_CAPSULE))


def request():
    wanted = coal.DistanceRequest()
    wanted.enable_signed_distance = False
    wanted.gjk_tolerance = 1e-10
    wanted.gjk_max_iterations = 1000
    return wanted


def capsules_of(a, b, r):
    """coal's capsules of one hull with their poses in the body."""
    return [
        (coal.Capsule(r[k], np.linalg.norm(b[k] - a[k])), along_z(b[k] - a[k]), (a[k] + b[k]) / 2)
        for k in range(N_CAPSULE)
    ]


def coal_to_cells(boxes, hull, R, p):
    """Distance of a hull in the poses R, p to a manager of boxes; coal finds the nearest itself."""
    movers = [(coal.CollisionObject(shape), turn, at) for shape, turn, at in capsules_of(*hull)]
    callback, wanted = coal.DistanceCallBackDefault(), request()
    out = np.full(len(p), np.inf)
    for shape, turn, at in movers:
        turns, origins = R @ turn, p + R @ at
        for i in range(len(p)):
            shape.setTransform(coal.Transform3s(turns[i], origins[i]))
            shape.computeAABB()
            callback.data.clear()
            callback.data.request = wanted
            boxes.distance(shape, callback)
            out[i] = min(out[i], max(callback.data.result.min_distance, 0.0))
    return out


@pytest.fixture(scope="module")
def cell_queries():
    """40,000 poses of hulls among cells with coal's distances."""
    rng = np.random.default_rng(0)
    occupied = rng.random(SHAPE) < 0.12
    boxes = coal.DynamicAABBTreeCollisionManager()
    objects = []  # the manager holds no reference of its own
    for index in np.argwhere(occupied):
        pose = coal.Transform3s(np.eye(3), ORIGIN + CELL * (index + 0.5))
        objects.append(coal.CollisionObject(coal.Box(CELL, CELL, CELL), pose))
        boxes.registerObject(objects[-1])
    boxes.setup()
    a, b, r = sample_hulls(rng, N_HULL)
    p = ORIGIN + CELL * rng.uniform(-0.5, np.array(SHAPE) + 0.5, (N_HULL, N_POSE, 3))
    R = rotations(rng, N_HULL * N_POSE)[0].reshape(N_HULL, N_POSE, 3, 3)
    want = np.stack([coal_to_cells(boxes, (a[i], b[i], r[i]), R[i], p[i]) for i in range(N_HULL)])
    ends = [p[:, :, None] + np.einsum("hnij,hcj->hnci", R, x) for x in (a, b)]
    every = np.broadcast_to(r[:, None], (N_HULL, N_POSE, N_CAPSULE))
    flat = [x.reshape(-1, *x.shape[2:]) for x in (*ends, every, p)]
    return occupied, flat, want.reshape(-1)


def cells_error(cell_queries, dtype):
    """|ours - coal's| [40,000], both held to the radius up to which ours is exact."""
    occupied, flat, want = cell_queries
    table = clearance.cell_neighbours(jnp.asarray(occupied)).reshape(-1)
    origin, cell = jnp.asarray(ORIGIN, dtype), jnp.asarray(CELL, dtype)

    @jax.jit
    @jax.vmap
    def ours(a, b, r, p):
        index, lo = clearance.neighbour_window(p, origin, cell, SHAPE)
        return clearance.capsules_neighbours(a, b, r, p, lo, table[index], cell)

    got = np.asarray(ours(*(jnp.asarray(x, dtype) for x in flat)), float)
    a, b, r, p = flat
    reach = [np.linalg.norm(x - p[:, None], axis=2) + r for x in (a, b)]
    cap = CELL - np.maximum(*reach).max(axis=1)
    assert want.size == 40_000
    assert (want < cap).mean() > 0.5, "most hulls are near a cell"
    assert (want > 0.0).mean() > 0.3, "many hulls are clear"
    return np.abs(np.maximum(got, 0.0) - np.minimum(want, cap))


def test_hulls_to_cells_equal_coal_in_double(cell_queries, deviation):
    deviation("clearance.cells_coal_double", cells_error(cell_queries, jnp.float64), DOUBLE)


def test_hulls_to_cells_equal_coal_in_single(cell_queries, deviation):
    # Hulls and cells stand up to 25 m from the origin, where float32 has steps of 1.9e-6 m: half a
    # step is lost for each end, for the grid's origin and for the corner of the looked-up cells.
    # What follows works on lengths of a few metres and adds some 1e-7 m.
    deviation("clearance.cells_coal_single", cells_error(cell_queries, jnp.float32), 1e-5)


@pytest.fixture(scope="module")
def hull_pairs():
    """Pairs of hulls side by side with coal's distances."""
    rng = np.random.default_rng(1)
    n = 2000
    (a1, b1, r1), (a2, b2, r2) = sample_hulls(rng, n), sample_hulls(rng, n)
    shift = rng.uniform(-1.2, 1.2, (n, 1, 3))
    a2, b2 = a2 + shift, b2 + shift
    want, wanted, result = np.full(n, np.inf), request(), coal.DistanceResult()
    for i in range(n):
        other = capsules_of(a2[i], b2[i], r2[i])
        for shape, turn, at in capsules_of(a1[i], b1[i], r1[i]):
            for shape2, turn2, at2 in other:
                pose, pose2 = coal.Transform3s(turn, at), coal.Transform3s(turn2, at2)
                result.clear()
                gap = coal.distance(shape, pose, shape2, pose2, wanted, result)
                want[i] = min(want[i], max(gap, 0.0))
    return (a1, b1, r1, a2, b2, r2), want


@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
def test_hulls_to_hulls_equal_coal(hull_pairs, dtype, deviation):
    arguments, want = hull_pairs
    ours = quickly(jax.vmap(clearance.capsules_capsules))
    got = np.asarray(ours(*(jnp.asarray(x, dtype) for x in arguments)), float)
    # In single too: lengths of some metres, 1e-7 each.
    deviation.close(f"clearance.hulls_coal_{KINDS[dtype]}", np.maximum(got, 0.0), want, atol=DOUBLE)
    assert 100 < (want == 0).sum() < want.size - 100, "both touching and clear pairs"


@pytest.fixture(scope="module")
def hulls_at_obstacles():
    """Hulls beside spheres, boxes and capsules with coal's distances."""
    rng = np.random.default_rng(2)
    n = 2000
    a, b, r = sample_hulls(rng, n)
    kind, size = rng.integers(0, 3, n), rng.uniform(0.1, 1.0, (n, 3))
    p, (R, q) = rng.uniform(-2, 2, (n, 3)), rotations(rng, n)
    want, wanted, result = np.full(n, np.inf), request(), coal.DistanceResult()
    for i in range(n):
        x, y, z = size[i]
        shape = (coal.Sphere(x), coal.Box(2 * x, 2 * y, 2 * z), coal.Capsule(x, 2 * y))[kind[i]]
        pose = coal.Transform3s(R[i], p[i])
        for capsule, turn, at in capsules_of(a[i], b[i], r[i]):
            result.clear()
            gap = coal.distance(capsule, coal.Transform3s(turn, at), shape, pose, wanted, result)
            want[i] = min(want[i], max(gap, 0.0))
    return (a, b, r, p, q), kind, size, want


@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32])
def test_hulls_to_obstacles_equal_coal(hulls_at_obstacles, dtype, deviation):
    arguments, kind, size, want = hulls_at_obstacles
    ours = quickly(jax.vmap(clearance.capsules_obstacle))
    floats = [jnp.asarray(x, dtype) for x in arguments]
    got = np.asarray(ours(*floats, kind, jnp.asarray(size, dtype)), float)
    # In single too: lengths of some metres, 1e-7 each, and an attitude of unit length.
    key = f"clearance.hull_obstacles_coal_{KINDS[dtype]}"
    deviation.close(key, np.maximum(got, 0.0), want, atol=DOUBLE)
    assert 100 < (want == 0).sum() < want.size - 100, "both touching and clear pairs"
