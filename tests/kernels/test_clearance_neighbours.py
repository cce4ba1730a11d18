"""Distances by looked-up neighbours: against the 27 cells, finite differences and plain loops."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import clearance

from ..angler_mjx.compiling import quickly

SHAPE, CELL, ORIGIN = (9, 8, 7), 1.5, np.array([-3.0, 1.0, -12.0])
N = 2000
# Both ways add and multiply the same lengths of up to 20 m in double, in another order.
ROUNDING = 1e-12


cell_neighbours = quickly(clearance.cell_neighbours)


@pytest.fixture(scope="module", autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="module")
def occupied():
    return np.random.default_rng(0).random(SHAPE) < 0.15


@pytest.fixture(scope="module")
def hulls():
    """Three capsules about points in and around the grid: ends [N, 3, 3], radii [3], points."""
    rng = np.random.default_rng(1)
    centre = ORIGIN + CELL * rng.uniform(-1.5, np.array(SHAPE) + 1.5, (N, 3))
    a = centre[:, None] + rng.uniform(-0.35, 0.35, (N, 3, 3))
    b = centre[:, None] + rng.uniform(-0.35, 0.35, (N, 3, 3))
    b[: N // 10] = a[: N // 10]  # spheres
    b[N // 10 : N // 5, :, 1:] = a[N // 10 : N // 5, :, 1:]  # along an axis
    return a, b, np.array([0.05, 0.1, 0.2]), centre


@pytest.fixture(scope="module")
def by_neighbours(occupied):
    """Distance and gradient of the hull's place, by look-up."""
    table = cell_neighbours(jnp.asarray(occupied)).reshape(-1)

    def gap(shift, a, b, r, centre):
        at, cell = centre + shift, jnp.asarray(CELL)
        index, lo = clearance.neighbour_window(at, jnp.asarray(ORIGIN), cell, SHAPE)
        mask = table[index]
        return clearance.capsules_neighbours(a + shift, b + shift, r, at, lo, mask, cell)

    return quickly(jax.vmap(jax.value_and_grad(gap), (0, 0, 0, None, 0)))


@pytest.fixture(scope="module")
def by_window(occupied):
    """Distance and gradient of the hull's place, by all 27 cells."""

    def gap(shift, a, b, r, centre):
        grid = (jnp.asarray(occupied), jnp.asarray(ORIGIN), jnp.asarray(CELL))
        return clearance.capsules_grid(a + shift, b + shift, r, centre + shift, *grid)

    return quickly(jax.vmap(jax.value_and_grad(gap), (0, 0, 0, None, 0)))


def unpack(mask):
    return np.array([bool(mask & (1 << i)) for i in range(27)]).reshape(3, 3, 3)


@pytest.mark.parametrize("shape", [SHAPE, (2, 5, 1)])
def test_cell_neighbours_packs_what_stands_around_each_cell(shape):
    cells = np.random.default_rng(2).random(shape) < 0.3
    packed = np.asarray(cell_neighbours(jnp.asarray(cells)))
    assert packed.dtype == np.int32
    assert packed.shape == tuple(n + 2 for n in shape)
    around = np.pad(cells, 2)
    for x, y, z in np.ndindex(packed.shape):
        expected = around[x : x + 3, y : y + 3, z : z + 3]
        np.testing.assert_array_equal(unpack(packed[x, y, z]), expected)


def test_neighbour_window_holds_every_cell_nearer_than_one_edge(occupied):
    rng = np.random.default_rng(3)
    p = ORIGIN + CELL * rng.uniform(-4, np.array(SHAPE) + 4, (N, 3))
    p[:20] *= 10.0 ** rng.uniform(1, 15, (20, 1))  # a robot that has diverged
    look = quickly(
        jax.vmap(
            lambda x: clearance.neighbour_window(x, jnp.asarray(ORIGIN), jnp.asarray(CELL), SHAPE)
        )
    )
    index, lo = (np.asarray(x) for x in look(p))
    packed = np.asarray(cell_neighbours(jnp.asarray(occupied))).reshape(-1)
    assert index.dtype == np.int32
    assert np.all((index >= 0) & (index < packed.size))
    cells = np.argwhere(occupied)
    corners = ORIGIN + CELL * cells
    gap = np.linalg.norm(p[:, None] - np.clip(p[:, None], corners, corners + CELL), axis=2)
    for i in range(N):
        # The window's cells, by place; a cell of the grid stands within rounding of one of them.
        offset = np.rint((corners - lo[i]) / CELL)
        inside = np.all((offset >= 0) & (offset <= 2), axis=1)
        assert np.all(inside[gap[i] < CELL - ROUNDING])
        seen = np.zeros((3, 3, 3), bool)
        seen[tuple(offset[inside].astype(int).T)] = True
        np.testing.assert_array_equal(unpack(packed[index[i]]), seen)


def test_neighbour_window_stays_inside_for_a_place_that_is_no_number():
    nowhere = jnp.full(3, jnp.nan)
    index, _ = clearance.neighbour_window(nowhere, jnp.asarray(ORIGIN), jnp.asarray(CELL), SHAPE)
    assert 0 <= int(index) < np.prod([n + 2 for n in SHAPE])


def test_distances_that_do_not_matter_are_cut_off(occupied, hulls, by_neighbours):
    """Below the limit as without one, and the limit itself beyond it."""
    a, b, r, centre = hulls
    exact = np.asarray(by_neighbours(np.zeros((N, 3)), a, b, r, centre)[0])
    limit = np.random.default_rng(2).uniform(0.0, 0.6, N)
    table = cell_neighbours(jnp.asarray(occupied)).reshape(-1)

    def gap(a, b, centre, limit):
        cell = jnp.asarray(CELL)
        index, lo = clearance.neighbour_window(centre, jnp.asarray(ORIGIN), cell, SHAPE)
        return clearance.capsules_neighbours(a, b, r, centre, lo, table[index], cell, limit)

    got = np.asarray(quickly(jax.vmap(gap))(a, b, centre, limit))
    np.testing.assert_allclose(got, np.minimum(exact, limit), atol=ROUNDING)
    assert (exact < limit).sum() > 100
    assert (exact > limit).sum() > 100


def test_capsules_equal_the_search_of_all_27_cells(hulls, by_neighbours, by_window):
    a, b, r, centre = hulls
    still = np.zeros((N, 3))
    got, got_grad = (np.asarray(x) for x in by_neighbours(still, a, b, r, centre))
    want, want_grad = (np.asarray(x) for x in by_window(still, a, b, r, centre))
    np.testing.assert_allclose(got, want, atol=ROUNDING)
    assert (want > 0.3).sum() > 100, "the draw holds clear hulls"
    assert (want < 0.0).sum() > 100, "the draw holds touching hulls"
    # Gradients differ only where two features are equally near, which overlap makes common: the
    # depth counts as minus the radius for every cell that the axis is in.
    clear = want > 0.0
    same = np.abs(got_grad - want_grad).max(axis=1)[clear] < 1e-9  # unit vectors, some operations
    assert np.mean(same) > 0.99
    assert np.all(np.isfinite(got_grad))


def test_a_long_hull_can_be_nearest_to_the_cell_that_its_centre_is_farther_from():
    # A rod of 0.9 m and radius 0.05 m from its centre forward; a cell 0.31 m behind the centre and
    # one 1.19 m ahead: 0.26 and 0.24 m from the hull.
    cells = np.zeros((3, 3, 3), bool)
    cells[0, 1, 1] = cells[2, 1, 1] = True
    mask = cell_neighbours(jnp.asarray(cells))[2, 2, 2]
    centre = jnp.array([1.81, 2.25, 2.25])
    a, b = centre[None], centre[None] + jnp.array([[0.9, 0.0, 0.0]])
    radius, cell = jnp.array([0.05]), jnp.asarray(CELL)
    got = clearance.capsules_neighbours(a, b, radius, centre, jnp.zeros(3), mask, cell)
    assert got == pytest.approx(0.24, abs=ROUNDING)


def test_gradient_equals_finite_differences(hulls, by_neighbours):
    a, b, r, centre = hulls
    value, grad = (np.asarray(x) for x in by_neighbours(np.zeros((N, 3)), a, b, r, centre))
    step, numeric = 1e-6, np.empty((N, 3))
    for i in range(3):
        shift = np.zeros((N, 3))
        shift[:, i] = step
        up, down = (by_neighbours(sign * shift, a, b, r, centre)[0] for sign in (1, -1))
        numeric[:, i] = (up - down) / (2 * step)
    clear = value > 1e-3
    assert (np.linalg.norm(numeric, axis=1) > 0.5)[clear].sum() > 300, "many gaps below the cap"
    error = np.abs(grad - numeric).max(axis=1)[clear]
    # Central differences: step^2 curvature (1e-12 / 1e-3) plus 1e-15 / step of rounding; a few
    # draws stand at a kink, where two features are equally near.
    assert np.mean(error < 1e-6) > 0.99


def test_bodies_in_lockstep_do_not_disturb_each_other(hulls, by_neighbours, occupied, monkeypatch):
    # A kernel keeps one array per coordinate and goes round its loop until the last body is done,
    # with nothing that holds the others still. The functions take such arrays as they are.
    a, b, r, centre = (x[:200] if x.shape[0] == N else x for x in hulls)
    want = by_neighbours(np.zeros((N, 3)), *hulls)[0][:200]

    def lockstep(going_on, body, carry):
        while bool(jnp.any(going_on(carry))):
            carry = body(carry)
        return carry

    monkeypatch.setattr(jax.lax, "while_loop", lockstep)
    table = cell_neighbours(jnp.asarray(occupied)).reshape(-1)
    origin, cell = jnp.asarray(ORIGIN), jnp.asarray(CELL)
    index, lo = clearance.neighbour_window(jnp.asarray(centre.T), origin, cell, SHAPE)
    mask = table[index]
    assert len({int(m).bit_count() for m in mask}) > 5, "bodies have different numbers of cells"
    assert np.any(mask == 0)
    ends = (jnp.asarray(np.moveaxis(x, 0, -1)) for x in (a, b))
    radii = jnp.broadcast_to(r[:, None], (3, 200))
    cells = jnp.full(200, CELL)
    got = clearance.capsules_neighbours(*ends, radii, jnp.asarray(centre.T), lo, mask, cells)
    np.testing.assert_allclose(got, want, atol=ROUNDING)


def test_points_equal_the_search_of_all_27_cells(occupied):
    rng = np.random.default_rng(4)
    p = ORIGIN + CELL * rng.uniform(-1.5, np.array(SHAPE) + 1.5, (N, 3))
    p[:200] = ORIGIN + CELL * rng.integers(0, 7, (200, 3))  # corners of cells
    origin, cell = jnp.asarray(ORIGIN), jnp.asarray(CELL)
    table = cell_neighbours(jnp.asarray(occupied)).reshape(-1)

    @quickly
    @jax.vmap
    def both(p):
        index, lo = clearance.neighbour_window(p, origin, cell, SHAPE)
        ours = clearance.point_neighbours(p, lo, table[index], cell)
        return ours, clearance.point_grid(p, jnp.asarray(occupied), origin, cell)

    (distance, normal), (want, want_normal) = jax.tree.map(np.asarray, both(p))
    np.testing.assert_allclose(distance, want, atol=ROUNDING)
    near = (want < CELL) & (np.arange(N) >= 200)
    np.testing.assert_allclose(normal[near], want_normal[near], atol=1e-9)  # roots of small gaps
    assert (want == 0.0).sum() > 50
    assert (want == CELL).sum() > 50
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=ROUNDING)
