"""Free space, search and way back against the rules written out for every cell on its own.

And what is seen, met and pulled straight, against geometry.
"""

import itertools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.planning.path_search.bodies import select_still
from angler_mjx.planning.path_search.lattice import (
    EDGES,
    build_terrain,
    free_space,
    line_of_sight,
    span_bits,
)
from angler_mjx.planning.path_search.search import search_reachable
from angler_mjx.planning.path_search.string_pulling import pull_string
from angler_mjx.planning.path_search.tracing import Route, trace_back
from angler_mjx.planning.path_search.traffic import (
    Balls,
    GridTraffic,
    PlannedTraffic,
    build_balls,
    is_motion_clear,
)
from angler_mjx.world.environment import Environment
from angler_mjx.world.obstacles import SPHERE, STATIC, Obstacles
from angler_mjx.world.rock.grid import Grid

from ..compiling import quickly
from .rules import STEPS, Scene, clear, layers_of, segment_gap, taken

SHAPE, CELL, LAYERS, OTHERS, LAYER_S = (4, 4, 5), 1.5, 30, 3, 1.25
ORIGIN = np.array([-3.0, 1.0, -12.0])
FLOOR_M = -11.0
"""Above the centres of the lowest cells less the clearance, below those of the next."""
CLEARANCE_M = 0.6
WAYS_BACK = 40
"""From so many places that were reached the way back is walked."""
FAR = np.array([99.0, 99.0, 99.0, 0.1])
"""A sphere that is in nobody's way."""
NOBODY = np.zeros((LAYERS, OTHERS, 3)), np.full((LAYERS, OTHERS), -1.0)
ALWAYS = np.ones(LAYERS, bool)


def make_world(occupied, sphere):
    n = np.zeros
    return Environment(
        grid=Grid(occupied=occupied, origin_m=np.float32(ORIGIN), cell_m=np.float32(CELL)),
        floor_z_m=np.float32(FLOOR_M),
        obstacles=Obstacles(
            kind=np.array([SPHERE], np.int32),
            size_m=np.float32([[sphere[3], 0.0, 0.0]]),
            motion=np.array([STATIC], np.int32),
            path=n((1, 8), np.float32),
            p0=np.float32(sphere[None, :3]),
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


def terrain_of(world):
    return build_terrain(world.grid, world.floor_z_m, select_still(world.obstacles))


@quickly
def explore(world, others, start, first, goal, may_stay, ends, scattered):
    """All that the planner does on its lattice for one robot, and the ways back from ``ends``.

    Those once more through ``scattered`` sets, that no search has made.
    """
    land = terrain_of(world)
    free = free_space(land, jnp.asarray(CLEARANCE_M))
    layout = land.layout
    # The start's bit, in the layout that `Layout.pack` documents.
    cells = jnp.zeros(SHAPE, bool).at[start[0], start[1], start[2]].set(True)
    history, last, found = search_reachable(
        land, free, others, layout.pack_cells(cells), first, goal, may_stay
    )

    @jax.vmap
    def back(sets, cell, layer):
        end, begin = (cell, layer), (start, first)
        return trace_back(land, free, others, sets, jnp.asarray(LAYER_S), end, begin)

    cells, layers = jnp.concatenate([goal[None], ends[:, :3]]), jnp.append(last, ends[:, 3])
    n = len(cells)
    sets = jnp.repeat(jnp.stack([history, scattered]), n, axis=0)
    routes = back(sets, jnp.tile(cells, (2, 1)), jnp.tile(layers, 2))
    return land.gap_m, free, history, last, found, routes


def pack(cells):
    """Words [layers, inner] of cells [layers, nx, ny, nz]: a column each, a guard after each x."""
    columns = (cells << np.arange(SHAPE[2])).sum(axis=-1).astype(np.uint32)
    return np.pad(columns, ((0, 0), (0, 0), (0, 1))).reshape(LAYERS, -1)


def unpack(words, layers=LAYERS):
    """The other way round."""
    columns = np.asarray(words).reshape(layers, SHAPE[0], SHAPE[1] + 1)
    assert not columns[:, :, -1].any(), "guards stay empty"
    return (columns[:, :, :-1, None] >> np.arange(32, dtype=np.uint32))[..., : SHAPE[2]] & 1 > 0


def gap_to_rock(occupied):
    """Distance from each cell's centre to rock, faces and floor, m, by every box there is."""
    centre = np.moveaxis(np.indices(SHAPE), 0, -1) + 0.5
    low = np.argwhere(occupied)
    away = np.abs(centre[..., None, :] - low - 0.5) - 0.5
    rock = np.linalg.norm(np.maximum(away, 0.0), axis=-1).min(axis=-1, initial=np.inf)
    faces = np.minimum(centre, SHAPE - centre).min(axis=-1)
    floor = ORIGIN[2] + centre[..., 2] * CELL - FLOOR_M
    return np.minimum(np.minimum(rock, faces) * CELL, floor)


class Case:
    """One world of one robot and what the planner found in it, beside what the rules say."""

    def __init__(self, occupied, sphere, centre, radius, start, first, goal, may_stay):
        self.start, self.first, self.goal, self.may_stay = start, first, goal, may_stay
        self.gap = gap_to_rock(occupied)
        cells = ORIGIN + (np.moveaxis(np.indices(SHAPE), 0, -1) + 0.5) * CELL
        apart = np.linalg.norm(cells - sphere[:3], axis=-1) - sphere[3]
        self.scene = Scene(
            origin=ORIGIN,
            cell=CELL,
            free=(self.gap >= CLEARANCE_M) & (apart >= CLEARANCE_M),
            centre=centre,
            radius=radius,
            sphere=sphere + np.array([0.0, 0.0, 0.0, CLEARANCE_M]),
        )
        self.ways = self.scene.ways()
        self.reached = self.scene.reached(self.ways, start, first)
        there = self.reached[:, *goal] & may_stay
        self.arrival = int(np.argmax(there)) if there.any() else None
        self.end = LAYERS - 1 if self.arrival is None else self.arrival
        places = np.argwhere(self.reached[: self.end + 1])
        rng = np.random.default_rng(0)
        picked = rng.choice(len(places), WAYS_BACK)
        self.ends = np.roll(places[picked], -1, axis=1).astype(np.int32)
        others = Balls(centre_m=np.float32(centre), radius_m=np.float32(radius))
        given = (np.int32(start), np.int32(first), np.int32(goal), may_stay, self.ends)
        self.scattered = rng.random(self.reached.shape) < 0.4
        found = jax.device_get(
            explore(make_world(occupied, sphere), others, *given, pack(self.scattered))
        )
        self.found_gap, self.free, self.history, self.last, self.found, self.routes = found


def draw(seed):
    """Rock in a tenth of the cells; balls that jump from layer to layer, hard to get past."""
    rng = np.random.default_rng(seed)
    occupied = rng.random(SHAPE) < 0.1
    start, goal = (0, 0, 1), (3, 3, 4)
    occupied[start] = occupied[goal] = False
    low, high = ORIGIN, ORIGIN + CELL * np.array(SHAPE)
    centre = rng.uniform(low, high, (LAYERS, OTHERS, 3))
    radius = rng.uniform(0.0, 0.9, (LAYERS, OTHERS))
    radius[
        rng.random((LAYERS, OTHERS)) < 0.3
    ] = -1.0  # as `build_balls` says that one does not count
    sphere = np.array([*rng.uniform(low, high), 0.3])
    return Case(
        occupied,
        sphere,
        centre,
        radius,
        start,
        int(rng.integers(0, 3)),
        goal,
        np.arange(LAYERS) >= rng.integers(0, 20),
    )


def corridor():
    """One way of thirteen steps, bent four times, and nobody in it."""
    occupied = np.ones(SHAPE, bool)
    occupied[:, 0, 1] = occupied[3, :3, 1] = occupied[:, 2, 1] = False
    occupied[0, 2, 1:] = occupied[:3, 2, 4] = False
    return Case(occupied, FAR, *NOBODY, (0, 0, 1), 0, (2, 2, 4), ALWAYS)


@pytest.fixture(scope="module")
def cases():
    return [draw(seed) for seed in range(10)]


def test_the_distance_to_rock_faces_and_floor(cases):
    for case in cases:
        # It looks three cells away: the faces of this grid are never farther.
        np.testing.assert_allclose(case.found_gap, case.gap, atol=1e-5)


def test_free_cells_and_steps(cases):
    guard = SHAPE[1] + 2
    inner = SHAPE[0] * (SHAPE[1] + 1)
    for case in cases:
        words = case.free.cells[None, guard : guard + inner]
        np.testing.assert_array_equal(unpack(words, 1)[0], case.scene.free)
        edges = unpack(case.free.edges[:, guard : guard + inner], len(EDGES))
        for edge, free in zip(EDGES, edges, strict=True):
            step = tuple(np.subtract(edge.far, edge.near).tolist())
            for low in itertools.product(*map(range, SHAPE)):
                a = tuple(np.add(low, edge.near).tolist())
                assert free[low] == ((a, step) in case.ways), (edge, low)


def test_cells_are_reached_when_the_rules_say(cases):
    shares = []
    for case in cases:
        history, end = unpack(case.history), case.end + 1
        np.testing.assert_array_equal(history[:end], case.reached[:end])
        assert not history[end:].any()
        shares.append(case.reached[:end].mean())
    # Balls that block nothing or everything would prove nothing.
    assert 0.05 < np.mean(shares) < 0.7


def test_the_goal_is_reached_at_the_first_layer_that_it_can_be_kept_from(cases):
    for case in cases:
        assert case.found == (case.arrival is not None)
        assert case.last == (case.arrival or 0)
    assert sum(case.found for case in cases) >= len(cases) // 2


def test_a_goal_that_can_never_be_kept_is_not_reached():
    start = (1, 1, 1)
    case = Case(np.zeros(SHAPE, bool), FAR, *NOBODY, start, 0, start, ~ALWAYS)
    assert case.reached[-1].any()
    assert not case.found
    assert case.last == 0


def test_a_ball_below_the_grid_takes_nothing_in_it():
    """Its top is half a metre below the lowest cells' faces, and the floor lower still."""
    world = replace(make_world(np.zeros(SHAPE, bool), FAR), floor_z_m=np.float32(-99.0))
    start = np.int32([1, 1, 0])
    under = ORIGIN + (start + 0.5) * CELL - [0.0, 0.0, 0.5 * CELL + 1.0]
    given = (start, np.int32(0), start, ~ALWAYS, np.zeros((WAYS_BACK, 4), np.int32))
    scattered = pack(np.zeros((LAYERS, *SHAPE), bool))
    sets = []
    for radius in (NOBODY[1], np.full((LAYERS, OTHERS), 0.5)):
        centre = np.tile(under, (LAYERS, OTHERS, 1))
        others = Balls(centre_m=np.float32(centre), radius_m=np.float32(radius))
        sets.append(unpack(explore(world, others, *given, scattered)[2]))
    assert sets[0][:, 1, 1, 0].all()
    np.testing.assert_array_equal(*sets)


def rows(route):
    """A route's rows up to its end: cell, layer of arrival, layer of leaving."""
    cell = (route.position_m - ORIGIN) / CELL - 0.5
    np.testing.assert_allclose(cell, np.round(cell), atol=1e-5)
    times = np.stack([route.arrive_s, route.leave_s]) / LAYER_S
    np.testing.assert_allclose(times, np.round(times), atol=1e-5)
    cells, (arrive, leave) = np.round(cell).astype(int), np.round(times).astype(int)
    return [(tuple(c), a, b) for c, a, b in zip(cells.tolist(), arrive, leave, strict=True)]


def off_line(point, a, b):
    """Distance of a cell from the line through the cells a and b."""
    way, off = np.subtract(b, a), np.subtract(point, a)
    return np.linalg.norm(off - way * (off @ way / max(way @ way, 1)))


def follow(case, reached, met, which, end):
    """Walk from (cell, layer) back to the start beside a route; waits, steps, and whether it ends.

    At each place it waits if it can, and else comes by the step that begins nearest to the line.
    """
    route = jax.tree.map(lambda leaf: leaf[which], case.routes)
    found = rows(route)
    cell, n = end
    leave, waited, k = n, 0, len(found) - 1

    def was(cell, n):
        return n >= case.first and case.scene.holds(cell) and reached[n][cell]

    while n > case.first:
        if was(cell, n - 1) and clear(met, cell, (0, 0, 0), n - 1):
            n, waited = n - 1, waited + 1
            continue
        possible = {}
        for step in STEPS:
            a, begin = tuple(np.subtract(cell, step).tolist()), n - layers_of(step)
            if (a, step) in case.ways and was(a, begin) and clear(met, a, step, begin):
                possible[a] = off_line(a, case.start, cell), begin
        if not possible:
            assert not route.whole
            return np.array([waited, len(found) - 1 - k, 0])
        assert found[k] == (cell, n, leave)
        k -= 1
        if k == route.begin and not route.whole:
            break  # a cell that it got stuck in is not told
        cell = found[k][0]
        assert cell in possible
        off, n = possible[cell]
        assert off <= min(possible.values())[0] + 1e-3
        leave = n
    else:
        assert found[k] == (cell, n, leave)
        assert route.whole == (cell == case.start)
    assert route.begin == k
    assert found[:k] == [(case.start, 0, 0)] * k
    return np.array([waited, len(found) - 1 - k, int(route.whole)])


def test_ways_back_are_among_those_there_are_and_the_ones_that_are_promised(cases):
    searched, scattered = np.zeros(3, int), np.zeros(3, int)
    for case in cases:
        met = taken(case.scene, upright=False)
        ends = [((*case.goal,), case.arrival)] if case.found else []
        ends += [((i, j, k), n) for i, j, k, n in case.ends.tolist()]
        first = 0 if case.found else 1
        for which, end in enumerate(ends, start=first):
            done = follow(case, case.reached, met, which, end)
            assert done[2] == 1
            searched += done
            scattered += follow(case, case.scattered, met, which + 1 + WAYS_BACK, end)
    # Waits and steps, enough of both to tell; through scattered sets not all come to the start.
    assert (searched > 400).all()
    assert (scattered[:2] > 400).all()
    assert scattered[2] < searched[2]


def test_a_way_of_as_many_steps_as_the_layers_allow():
    case = corridor()
    # Two layers a step; no corner can be cut.
    assert case.arrival == 26
    assert case.last == 26
    met = taken(case.scene, upright=False)
    done = follow(case, case.reached, met, 0, (case.goal, 26))
    np.testing.assert_array_equal(done, [0, 13, 1])


def test_who_comes_to_a_cell_only_after_a_step_does_not_meet_it():
    """The first step there is: layers 0 and 1. From layer 2 on a ball stands where it ended."""
    occupied = np.ones(SHAPE, bool)
    occupied[:2, 0, 1] = False
    goal = (1, 0, 1)
    centre = np.tile(ORIGIN + (np.array(goal) + 0.5) * CELL, (LAYERS, OTHERS, 1))
    radius = np.where(np.arange(LAYERS) < 2, -1.0, 0.3)[:, None].repeat(OTHERS, axis=1)
    case = Case(occupied, FAR, centre, radius, (0, 0, 1), 0, goal, ALWAYS)
    assert (case.found, case.last) == (True, 2)
    met = taken(case.scene, upright=False)
    np.testing.assert_array_equal(follow(case, case.reached, met, 0, (goal, 2)), [0, 1, 1])


def slab(a, b, low, high):
    """Whether the segment a b meets the box from low to high; by its shares along each axis."""
    way = b - a
    with np.errstate(divide="ignore"):
        ends = np.stack([(low - a) / way, (high - a) / way])
    return max(0.0, ends.min(axis=0).max()) <= min(1.0, ends.max(axis=0).min())


def test_what_is_seen_in_a_straight_line():
    """Rock grown by the clearance along each axis, box by box; the sphere as it is."""
    rng = np.random.default_rng(3)
    occupied = rng.random(SHAPE) < 0.08
    sphere = np.array([*(ORIGIN + CELL * np.array([1.1, 2.6, 2.2])), 0.4])
    low = ORIGIN + np.argwhere(occupied) * CELL
    a, b = (rng.uniform(ORIGIN, ORIGIN + CELL * np.array(SHAPE), (300, 3)) for _ in range(2))
    # Some along an axis, or in a plane of it.
    b[:60, 0], b[30:90, 1], b[60:120, 2] = a[:60, 0], a[30:90, 1], a[60:120, 2]
    # Some begin or end where a coordinate is 0, which is a place like any other.
    a[120:170, 0] = b[170:220, 0] = 0.0

    @quickly
    @jax.vmap
    def seen(a, b):
        return line_of_sight(terrain_of(make_world(occupied, sphere)), a, b, CLEARANCE_M)

    found = np.asarray(seen(np.float32(a), np.float32(b)))

    def expected(a, b, clearance):
        boxes = any(slab(a, b, box - clearance, box + CELL + clearance) for box in low)
        near = segment_gap(a, b, sphere[None, :3])[0] - sphere[3]
        return not boxes and near >= clearance

    # float32: within 0.1 mm of the clearance both answers are right.
    pairs = list(zip(a, b, strict=True))
    sure = [[expected(*ends, CLEARANCE_M + off) for off in (1e-4, -1e-4)] for ends in pairs]
    must, may = np.array(sure).T
    assert (must <= found).all()
    assert (found <= may).all()
    assert 0.2 < must.mean() < 0.8


def test_words_of_spans_hold_the_bits_from_first_to_last():
    low, high = np.mgrid[-35:70, -35:70].reshape(2, -1)
    words = np.asarray(span_bits(jnp.asarray(low), jnp.asarray(high)))
    bits = np.arange(32)
    expected = (low[:, None] <= bits) & (bits <= high[:, None])
    np.testing.assert_array_equal(words >> bits[:, None].astype(np.uint32) & 1, expected.T)


SPAN_S, POINTS = 20.0, 5


def draw_traffic(rng, n):
    """Polylines of n robots; the second stands for a while, the last one's rows are padded."""
    time = np.sort(rng.uniform(0.0, SPAN_S, (n, POINTS)), axis=1)
    time[:, 0] = 0.0
    point = rng.uniform(-4.0, 4.0, (n, POINTS, 3))
    point[1, 2] = point[1, 1]
    time[-1, 3:], point[-1, 3:] = time[-1, 2], point[-1, 2]
    until = np.where(np.arange(n) % 3 == 0, rng.uniform(2.0, 15.0, n), np.inf)
    until[2] = -1.0
    return GridTraffic(
        time_s=np.float32(time),
        position_m=np.float32(point),
        reach_m=np.float32(rng.uniform(1.0, 3.0, n)),
        until_s=np.float32(until),
    )


def where(traffic, t):
    """Places [n, len(t), 3] at times t."""
    rows = zip(traffic.time_s, traffic.position_m, strict=True)
    return np.array([[np.interp(t, s, p[:, k]) for k in range(3)] for s, p in rows]).swapaxes(1, 2)


def test_balls_hold_the_others_during_each_layer_and_are_not_larger_than_need_be():
    traffic = draw_traffic(np.random.default_rng(1), 7)
    n_layer, fine = 12, 50
    found = quickly(lambda given: build_balls(given, jnp.asarray(LAYER_S), n_layer))(traffic)
    centre, radius = (np.asarray(x, float).swapaxes(0, 1) for x in (found.centre_m, found.radius_m))
    share = np.arange(n_layer)[:, None] + np.linspace(0.0, 1.0, fine + 1)
    place = where(traffic, LAYER_S * share.ravel()).reshape(7, n_layer, fine + 1, 3)
    np.testing.assert_allclose(centre, place[:, :, fine // 2], atol=1e-4)
    counts = LAYER_S * np.arange(n_layer) <= traffic.until_s[:, None]
    assert (radius[~counts] < 0.0).all()
    grown = radius - traffic.reach_m[:, None]
    away = np.linalg.norm(place - centre[:, :, None], axis=-1).max(axis=-1)
    assert (grown >= away)[counts].all()
    # The way along a polyline that is sampled is shorter by its corners, 3 mm at the most here.
    way = np.linalg.norm(np.diff(place, axis=2), axis=-1)
    longest = np.maximum(way[..., : fine // 2].sum(-1), way[..., fine // 2 :].sum(-1))
    straight = np.abs(away - longest) < 1e-3
    assert (grown <= longest + 2.2e-3)[counts & straight].all()
    assert (counts & straight).sum() > 40


def test_steady_motion_is_clear_of_others_exactly_where_it_is():
    rng = np.random.default_rng(2)
    traffic, n = draw_traffic(rng, 4), 300
    a, b = rng.uniform(-4.0, 4.0, (2, n, 3))
    begin = rng.uniform(0.0, SPAN_S, n)
    end = begin + np.where(rng.random(n) < 0.2, 0.0, rng.uniform(0.0, 5.0, n))
    b = np.where((end > begin)[:, None], b, a)
    given = (np.float32(x) for x in (a, begin, b, end))
    test = quickly(jax.vmap(is_motion_clear, in_axes=(None, 0, 0, 0, 0)))
    found = np.asarray(test(traffic, *given))
    share = np.linspace(0.0, 1.0, 1001)[:, None]
    gap = []
    for i in range(n):
        t = begin[i] + share[:, 0] * (end[i] - begin[i])
        apart = np.linalg.norm(where(traffic, t) - a[i] - share * (b[i] - a[i]), axis=-1)
        counts = t <= traffic.until_s[:, None]
        gap.append(np.where(counts, apart - traffic.reach_m[:, None], np.inf).min())
    gap = np.array(gap)
    # 5 ms apart at 10 m/s: 5 cm between two looks, so 5 mm at most where they pass the least gap.
    sure = np.abs(gap) > 0.02
    np.testing.assert_array_equal(found[sure], gap[sure] > 0.0)
    assert 0.3 < found.mean() < 0.8


def round_a_wall(until_s):
    """Half a metre a second round the end of a wall; from start over a corner to the goal.

    Another robot stands on the second leg up to ``until_s``.
    """
    occupied = np.zeros(SHAPE, bool)
    occupied[1, :2] = True  # x from -1.5 m to 0, y from 1 m to 4 m
    route = Route(
        position_m=jnp.array([[-2.25, 1.75, -8.0], [-2.25, 5.5, -8.0], [2.25, 5.5, -8.0]]),
        arrive_s=jnp.array([0.0, 10.0, 25.0]),
        leave_s=jnp.array([0.0, 12.0, 40.0]),
        begin=jnp.array(1),
        whole=jnp.array(True),
    )
    stands = GridTraffic(
        time_s=jnp.array([[0.0, 1.0]]),
        position_m=jnp.tile(jnp.array([0.5, 5.5, -8.0]), (1, 2, 1)),
        reach_m=jnp.array([0.5]),
        until_s=jnp.array([until_s]),
    )
    return route, run_pull(
        make_world(occupied, FAR), PlannedTraffic(robots=stands, bodies=None), route
    )


@quickly
def run_pull(world, others, route):
    return pull_string(
        terrain_of(world), others, route, jnp.asarray(0.3), jnp.asarray(0.5), n_point=5
    )


def test_a_way_with_a_corner_is_pulled_to_its_three_points():
    route, path = round_a_wall(until_s=-1.0)
    assert path.found
    # Legs of 3.75 m and 4.5 m; the straight way to the goal would lead through the wall.
    np.testing.assert_allclose(path.time_s, [0.0, 7.5, 16.5, 16.5, 16.5], rtol=1e-6)
    np.testing.assert_array_equal(path.position_m[:3], route.position_m)
    np.testing.assert_array_equal(path.position_m[3:] - route.position_m[2], 0.0)


def test_a_way_of_which_one_leg_meets_somebody_is_not_found():
    """No search has made this timetable: it leads through who stands on its second leg."""
    assert not round_a_wall(until_s=100.0)[1].found
    # Who goes before it comes within reach is not met: it would after 4.5 s of the leg, at 12 s.
    assert round_a_wall(until_s=11.0)[1].found
