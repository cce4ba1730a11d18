"""Fields of ways against Dijkstra on a graph that is built from the rule, and walked."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from angler_mjx.planning.routes import route_fields
from angler_mjx.world import routes as reading
from angler_mjx.world.environment import Environment
from angler_mjx.world.obstacles import SPHERE, STATIC, Obstacles
from angler_mjx.world.rock.grid import Grid

from ...compiling import quickly

SHAPE, CELL, CLEARANCE, FLOOR = (7, 6, 5), 1.5, 0.6, -11.0
ORIGIN = np.array([-3.0, 1.0, -12.0])
SPHERE_M, RADIUS = np.array([2.5, 6.0, -7.3]), 0.5
POCKET = (1, 1, 3)
"""A free cell with rock on all its sides: no way leads there, nor out."""
IN_ROCK = (5, 1, 3)
PLACES = np.array(
    [(0, 0, 1), (6, 5, 4), (6, 0, 2), (0, 5, 3), POCKET, IN_ROCK, (3, 3, 2), (2, 0, 4), (6, 3, 1)]
)
"""More than are relaxed at once."""


def rock():
    cells = np.random.default_rng(5).random(SHAPE) < 0.15
    for step in itertools.product((-1, 0, 1), repeat=3):
        cells[tuple(np.add(POCKET, step))] = any(step)
    cells[IN_ROCK] = True
    for place in PLACES:
        cells[tuple(place)] = tuple(place) == IN_ROCK
    return cells


def centres(shape=SHAPE, cell=CELL):
    index = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)
    return ORIGIN + (index + 0.5) * cell


def gap(occupied, points):
    """Distance [...] of points [..., 3] to rock, faces, floor and the sphere; numpy, by boxes."""
    low = ORIGIN + CELL * np.argwhere(occupied)
    off = np.maximum(np.maximum(low - points[..., None, :], points[..., None, :] - low - CELL), 0)
    upper = ORIGIN + CELL * np.array(SHAPE)
    return np.min(
        [
            np.linalg.norm(off, axis=-1).min(axis=-1),
            np.minimum(points - ORIGIN, upper - points).min(axis=-1),
            points[..., 2] - FLOOR,
            np.linalg.norm(points - SPHERE_M, axis=-1) - RADIUS,
        ],
        axis=0,
    )


def may_go(clear, a, b):
    """All cells of the block that a and b span are clear, and the line passes the sphere."""
    block = [range(min(i, j), max(i, j) + 1) for i, j in zip(a, b, strict=True)]
    if not all(clear[cell] for cell in itertools.product(*block)):
        return False
    p, q = (ORIGIN + (np.array(end) + 0.5) * CELL for end in (a, b))
    s = np.clip(np.dot(SPHERE_M - p, q - p) / np.dot(q - p, q - p), 0.0, 1.0)
    return np.linalg.norm(p + s * (q - p) - SPHERE_M) - RADIUS >= CLEARANCE


@pytest.fixture(scope="module")
def graph():
    """Which cells are clear, and lengths [cells, cells] in m; inf where there is no way."""
    clear = gap(rock(), centres()) >= CLEARANCE
    rows = []
    for a in np.ndindex(SHAPE):
        for step in itertools.product((-1, 0, 1), repeat=3):
            b = tuple(np.add(a, step))
            inside = all(0 <= i < n for i, n in zip(b, SHAPE, strict=True))
            if any(step) and inside and may_go(clear, a, b):
                at = [np.ravel_multi_index(cell, SHAPE) for cell in (a, b)]
                rows.append((*at, CELL * np.linalg.norm(step)))
    i, j, length = zip(*rows, strict=True)
    n = np.prod(SHAPE)
    return clear, dijkstra(coo_array((length, (i, j)), shape=(n, n)).tocsr())


@pytest.fixture(scope="module")
def drawn():
    n = np.zeros
    world = Environment(
        grid=Grid(
            occupied=jnp.asarray(rock()), origin_m=jnp.asarray(ORIGIN), cell_m=jnp.asarray(CELL)
        ),
        floor_z_m=jnp.asarray(FLOOR),
        obstacles=Obstacles(
            kind=np.array([SPHERE], np.int32),
            size_m=np.float32([[RADIUS, 0.0, 0.0]]),
            motion=np.array([STATIC], np.int32),
            path=n((1, 8), np.float32),
            p0=np.float32(SPHERE_M[None]),
            q0=np.float32([[1.0, 0.0, 0.0, 0.0]]),
            nu0=n((1, 6), np.float32),
            mass_kg=n(1, np.float32),
            inertia_kgm2=n((1, 3), np.float32),
            volume_m3=n(1, np.float32),
            M_A=n((1, 6), np.float32),
            D_l=n((1, 6), np.float32),
            D_q=n((1, 6), np.float32),
            exists=np.array([True]),
            kinds=(SPHERE,),
            motions=(STATIC,),
        ),
        current=(),
        start_m=n((1, 3), np.float32),
        start_yaw_rad=n(1, np.float32),
        goal_m=n((1, 3), np.float32),
        density=np.float32(0.0),
        path_ratio=n(1, np.float32),
        line_free=n(1, bool),
        redraws=np.int32(0),
        valid=np.array(True),
    )
    place_m = ORIGIN + (PLACES + np.array([0.5, 0.6, 0.4])) * CELL

    @quickly
    def all_of(world, place_m):
        routes = route_fields.compute_routes(world, place_m, jnp.asarray(CLEARANCE))
        cells = jnp.stack(jnp.meshgrid(*map(jnp.arange, SHAPE), indexing="ij"), axis=-1)
        cells = cells.reshape(-1, 3)

        def of_place(place):
            return jax.vmap(lambda cell: reading.step_toward(routes, place, cell))(cells)

        after, length = jax.vmap(of_place)(jnp.arange(len(PLACES)))
        middle = jax.vmap(lambda cell: reading.centre_m(routes, cell))(cells)
        told = jax.vmap(
            lambda place: jax.vmap(lambda p: reading.distance_to_goal(routes, place, p))(middle)
        )(jnp.arange(len(PLACES)))
        fine = jnp.asarray(centres(tuple(4 * k for k in SHAPE), CELL / 4))
        return after, length, told, reading.is_clear(routes, *jnp.moveaxis(fine, -1, 0))

    return [np.asarray(x) for x in all_of(world, jnp.asarray(place_m))], place_m


def test_lengths_are_those_of_dijkstra_and_there_is_none_where_he_finds_none(graph, drawn):
    clear, lengths = graph
    (_, length, _, _), _ = drawn
    flat = clear.reshape(-1)
    for place, found in zip(PLACES, length, strict=True):
        to = lengths[:, np.ravel_multi_index(place, SHAPE)]
        if not clear[tuple(place)]:
            assert np.all(np.isinf(found))
            continue
        np.testing.assert_array_equal(np.isinf(found[flat]), np.isinf(to[flat]))
        reached = flat & np.isfinite(to)
        # Told in eighths of a cell's edge.
        np.testing.assert_allclose(found[reached], to[reached], atol=CELL / 16 + 1e-5)
    pocket = np.ravel_multi_index(POCKET, SHAPE)
    others = [i for i, place in enumerate(PLACES) if tuple(place) != POCKET]
    assert np.all(np.isinf(length[others, pocket]))
    assert np.count_nonzero(np.isfinite(length[list(map(tuple, PLACES)).index(POCKET)][flat])) == 1


def test_steps_lead_down_to_the_place_over_moves_that_the_rule_allows(graph, drawn):
    clear, lengths = graph
    (after, length, _, _), _ = drawn
    walked = 0
    for place, to, found in zip(PLACES, after, length, strict=True):
        for cell in np.argwhere(clear):
            at = np.ravel_multi_index(cell, SHAPE)
            if np.isinf(found[at]):
                continue
            whole = lengths[at, np.ravel_multi_index(place, SHAPE)]
            way = 0.0
            while tuple(cell) != tuple(place):
                following = to[np.ravel_multi_index(cell, SHAPE)]
                assert may_go(clear, tuple(cell), tuple(following))
                way += CELL * np.linalg.norm(following - cell)
                cell = following
                walked += 1
            assert way == pytest.approx(whole, abs=1e-4)
    assert walked > 1000


def test_of_equally_long_paths_the_step_that_ends_nearest_to_the_goal_is_taken(graph, drawn):
    clear, lengths = graph
    (after, _, _, _), _ = drawn
    chosen = 0
    for goal, to in zip(PLACES, after, strict=True):
        whole = lengths[:, np.ravel_multi_index(goal, SHAPE)].reshape(SHAPE)
        for cell in map(tuple, np.argwhere(clear & np.isfinite(whole) & (whole > 0.0))):
            off = []
            for step in itertools.product((-1, 0, 1), repeat=3):
                b = tuple(np.add(cell, step))
                if not all(0 <= i < n for i, n in zip(b, SHAPE, strict=True)) or not any(step):
                    continue
                longer = whole[b] + CELL * np.linalg.norm(step) - whole[cell]
                if abs(longer) < 1e-6 and may_go(clear, cell, b):
                    off.append(np.linalg.norm(b - goal))
            taken = to[np.ravel_multi_index(cell, SHAPE)]
            assert np.linalg.norm(taken - goal) == pytest.approx(min(off))
            chosen += max(off) > min(off) + 1e-6
    assert chosen > 100


def test_cells_without_clearance_lead_to_a_free_one_beside_them(graph, drawn):
    clear, _ = graph
    (after, length, _, _), _ = drawn
    led = 0
    for cell in np.argwhere(~clear):
        at = np.ravel_multi_index(cell, SHAPE)
        beside = [
            tuple(other)
            for other in np.argwhere(clear & np.isfinite(length[0].reshape(SHAPE)))
            if np.max(np.abs(other - cell)) == 1
        ]
        if beside:
            nearest = min(np.linalg.norm(np.subtract(other, cell)) for other in beside)
            assert tuple(after[0, at]) in beside
            assert np.linalg.norm(after[0, at] - cell) == pytest.approx(nearest)
            led += 1
    assert led > 20


def test_a_distance_ends_at_the_place_itself_and_never_undercuts_the_straight_line(graph, drawn):
    clear, lengths = graph
    (_, _, told, _), place_m = drawn
    middle, flat = centres().reshape(-1, 3), clear.reshape(-1)
    for place, at, distance in zip(PLACES, place_m, told, strict=True):
        if not clear[tuple(place)]:
            assert np.all(np.isinf(distance))
            continue
        to = lengths[:, np.ravel_multi_index(place, SHAPE)]
        reached = flat & np.isfinite(to)
        straight = np.linalg.norm(middle - at, axis=1)
        assert np.all(distance[reached] >= straight[reached] - CELL / 16 - 0.3)
        near = np.linalg.norm(middle - at, axis=1) < 0.3
        np.testing.assert_allclose(distance[near], straight[near], atol=1e-5)
        np.testing.assert_allclose(distance[reached], to[reached], atol=CELL / 16 + 0.3)


def test_cubes_are_clear_where_their_centres_keep_the_distance(drawn):
    clear = drawn[0][3]
    room = gap(rock(), centres(tuple(4 * n for n in SHAPE), CELL / 4))
    sure = np.abs(room - CLEARANCE) > 1e-4
    assert 0.1 < clear.mean() < 0.8
    np.testing.assert_array_equal(clear[sure], (room >= CLEARANCE)[sure])
