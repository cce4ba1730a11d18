"""The GPU's program for the search, interpreted, against the readable search."""

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.planning.path_search import search, search_kernel
from angler_mjx.planning.path_search.lattice import FreeSpace, LatticeLayout, Terrain
from angler_mjx.planning.path_search.traffic import Balls
from angler_mjx.world.rock.grid import Grid

CELL = 1.5
SHAPE = (5, 4, 7)
LAYOUT = LatticeLayout(shape=SHAPE)
N_LAYER = 20
N_WORLD = 24


def asked(seed, n_ball=5):
    """Random cells, edges, balls, ends and layers at which the goal may be kept."""
    random = np.random.default_rng(seed)
    cells = random.random(SHAPE) < 0.85
    edges = random.random((13, *SHAPE)) < 0.8
    start, goal = (np.argwhere(cells)[random.integers(cells.sum())] for _ in range(2))
    low, size = np.array([3.0, -2.0, -11.0]), np.array(SHAPE) * CELL
    centre = low + random.random((n_ball, 3)) * size
    centre = centre + np.cumsum(random.normal(size=(N_LAYER, n_ball, 3)) * 0.3, axis=0)
    radius = np.where(random.random((N_LAYER, n_ball)) < 0.3, -1.0, 0.3 + random.random(n_ball))
    free = FreeSpace(
        cells=LAYOUT.pack_cells(jnp.array(cells)),
        edges=jax.vmap(LAYOUT.pack_cells)(jnp.array(edges)),
    )
    return {
        "origin": low,
        "free": free,
        "balls": Balls(centre_m=centre.astype(np.float32), radius_m=radius.astype(np.float32)),
        "start": start,
        "first": random.integers(0, 3),
        "goal": goal,
        "may_stay": random.random(N_LAYER) < 0.7,
    }


def land_at(origin):
    """Only what a search reads of the land: it is told what is free."""
    return Terrain(
        grid=Grid(occupied=jnp.zeros(SHAPE, bool), origin_m=origin, cell_m=jnp.array(CELL)),
        columns=None,
        gap_m=None,
        obstacles=None,
        edge_gap_m=None,
        cell_gap_m=None,
        layout=LAYOUT,
    )


def readable(origin, free, balls, start, first, goal, may_stay):
    at = LAYOUT.guard_size + start[0] * LAYOUT.row + start[1]
    bit = jnp.where(jnp.arange(LAYOUT.total) == at, jnp.uint32(1) << start[2].astype("u4"), 0)
    return search.search_reachable(land_at(origin), free, balls, bit, first, goal, may_stay)


def by_kernel(origin, free, balls, start, first, goal, may_stay, interpret):
    return search_kernel.search_reachable(
        land_at(origin), free, balls, (start, first), goal, may_stay, interpret=interpret
    )


def compared(n_ball, block_form):
    worlds = [asked(seed, n_ball) for seed in range(N_WORLD)]
    worlds = jax.tree.map(lambda *leaves: jnp.stack(leaves), *worlds)
    forms = readable, block_form(by_kernel)
    return [jax.jit(jax.vmap(lambda w, one=one: one(**w)))(worlds) for one in forms]


def test_reaches_the_same_cells_at_the_same_layers(block_form):
    (history, arrival, reached), (by_program, its_arrival, it_reached) = compared(5, block_form)
    np.testing.assert_array_equal(reached, it_reached)
    np.testing.assert_array_equal(arrival, its_arrival)
    assert 0.3 < np.mean(reached) < 1.0
    # Columns between the rows are guards; after its arrival a program writes nothing.
    columns = np.arange(LAYOUT.inner).reshape(SHAPE[0], LAYOUT.row)[:, : SHAPE[1]].ravel()
    until = np.where(reached, arrival, N_LAYER - 1)
    for world in range(N_WORLD):
        layers = slice(0, until[world] + 1)
        np.testing.assert_array_equal(
            np.asarray(history)[world, layers][:, columns],
            np.asarray(by_program)[world, layers][:, columns],
        )


def test_lowers_for_cuda(lower_for_gpu):
    world = asked(0)

    def one(w):
        return search_kernel.search_reachable(
            land_at(w["origin"]),
            w["free"],
            w["balls"],
            (w["start"], w["first"]),
            w["goal"],
            w["may_stay"],
        )

    worlds = jax.tree.map(lambda leaf: jnp.stack([jnp.asarray(leaf)] * 2), world)
    lower_for_gpu(jax.vmap(one), worlds)
