"""The nearest of many bodies against all pairs in numpy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels.neighbour_search import find_nearest

from ..angler_mjx.compiling import quickly

WITHIN = 1.0
# The same lengths in double, subtracted in another order.
ROUNDING = 1e-12


@pytest.fixture(scope="module", autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


def ball_gap(one, other):
    """A body that is smaller than its bounding sphere: the sphere's place is not its own."""
    (p, r), (q, s) = one, other
    return jnp.sqrt(jnp.sum((p - q) ** 2)) - r - s


def one_world(centre, sphere, position, r, within):
    return find_nearest(centre, sphere, (position, r), ball_gap, within)


worlds = jax.vmap(one_world, (0, 0, 0, 0, None))


@pytest.fixture(scope="module")
def search():
    return quickly(worlds)


def sample(rng, n_world, n, extent):
    centre = rng.uniform(-extent, extent, (n_world, n, 3))
    position = centre + rng.uniform(-0.1, 0.1, centre.shape)
    r = rng.uniform(0.02, 0.2, (n_world, n))
    sphere = np.linalg.norm(position - centre, axis=2) + r
    return centre, sphere, position, r


def all_pairs(position, r):
    gap = (
        np.linalg.norm(position[:, :, None] - position[:, None], axis=3)
        - r[:, :, None]
        - r[:, None]
    )
    gap[:, np.arange(gap.shape[1]), np.arange(gap.shape[1])] = np.inf
    return gap


def check(search, world):
    _, _, position, r = world
    distance, index = (np.asarray(x) for x in search(*world, WITHIN))
    gap = all_pairs(position, r)
    least = gap.min(axis=2)
    np.testing.assert_allclose(distance, np.minimum(least, WITHIN), atol=ROUNDING)
    np.testing.assert_array_equal(index[least > WITHIN], -1)
    near = least < WITHIN
    named = np.take_along_axis(gap, np.maximum(index, 0)[..., None], axis=2)[..., 0]
    np.testing.assert_allclose(named[near], least[near], atol=ROUNDING)
    return near


@pytest.mark.parametrize("extent", [0.4, 2.0, 8.0, 1e3, 1e5])
def test_equals_all_pairs_from_a_crowd_to_a_wide_sea(search, extent):
    # In a crowd every body is a candidate of every other; at 1e5 m most bodies are beyond the
    # outermost cells.
    rng = np.random.default_rng(0)
    world = sample(rng, 6, 200, extent)
    if extent >= 1e3:  # pairs that would never meet by chance
        for part in (world[0], world[2]):
            part[:, 150:] = part[:, :50] + 0.3
    near = check(search, world)
    assert near.mean() > 0.1, "some bodies are near others"
    assert extent < 8.0 or not near.all()


def test_one_world_does_not_see_another(search):
    rng = np.random.default_rng(1)
    world = sample(rng, 6, 200, 4.0)
    together = search(*world, WITHIN)
    for i in range(6):
        alone = search(*(np.repeat(x[i : i + 1], 6, axis=0) for x in world), WITHIN)
        np.testing.assert_array_equal(together[0][i], alone[0][0])
        np.testing.assert_array_equal(together[1][i], alone[1][0])


def test_both_of_a_pair_get_the_same_number(search):
    distance, index = (
        np.asarray(x) for x in search(*sample(np.random.default_rng(2), 6, 200, 3.0), WITHIN)
    )
    where, one = np.nonzero(index >= 0)
    other = index[where, one]
    mutual = index[where, other] == one
    assert mutual.sum() > 300
    np.testing.assert_array_equal(distance[where, one][mutual], distance[where, other][mutual])


def test_bodies_on_the_edges_of_cells_and_at_one_place(search):
    # A lattice with the spacing of the cells puts every body on a corner of its cell.
    r, apart = 0.1, WITHIN + 0.2 - 1e-9
    lattice = np.stack(np.meshgrid(*(np.arange(6.0),) * 3, indexing="ij"), -1).reshape(-1, 3)
    position = np.tile(lattice[:200] * apart, (6, 1, 1))
    position[1, 100:] = position[1, :100]
    position[2] = 7.0
    radii = np.full((6, 200), r)
    check(search, (position, radii, position, radii))


@pytest.mark.parametrize("n", [1, 2])
def test_few_bodies(search, n):
    world = sample(np.random.default_rng(3), 1, n, 0.2)
    distance, index = (np.asarray(x) for x in search(*world, WITHIN))
    if n == 1:
        np.testing.assert_array_equal(distance, [[WITHIN]])
        np.testing.assert_array_equal(index, [[-1]])
    else:
        check(search, world)
        np.testing.assert_array_equal(index, [[1, 0]])


def test_gradient_is_that_of_the_nearest_pair(search):
    centre, sphere, position, r = sample(np.random.default_rng(4), 6, 200, 3.0)

    def total(shift):
        moved = (centre + shift, sphere, position + shift, r)
        return jnp.sum(worlds(*moved, WITHIN)[0])

    got = np.asarray(quickly(jax.grad(total))(np.zeros_like(position)))
    _, index = (np.asarray(x) for x in search(centre, sphere, position, r, WITHIN))
    want = np.zeros_like(position)
    for w, i in zip(*np.nonzero(index >= 0), strict=True):
        j = index[w, i]
        away = (position[w, i] - position[w, j]) / np.linalg.norm(position[w, i] - position[w, j])
        want[w, i] += away
        want[w, j] -= away
    np.testing.assert_allclose(got, want, atol=1e-9)  # unit vectors, sums of a few of them
