import itertools
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels.clearance import capsules_obstacle
from angler_mjx.errors import UnsupportedError
from angler_mjx.planning.path_search import search
from angler_mjx.planning.path_search.robot_search import PathSearchConfig
from angler_mjx.world.environment import Environment
from angler_mjx.world.obstacles import BOX, CAPSULE, DRIFT, SPHERE, STATIC, Obstacles
from angler_mjx.world.rock.grid import Grid

from ..compiling import quickly
from ..lattice import least_costs
from .problems import plan_world

CELL = 1.5
SHAPE = (12, 10, 9)
RADIUS = np.array([0.4, 0.45, 0.35, 0.4], np.float32)
SPEED = np.array([0.5, 0.42, 0.36, 0.5], np.float32)
CONFIG = PathSearchConfig()
N_WORLD = 8

# Corners of the grid, one cell in; every goal but the last is the start of another robot.
STARTS = np.array([[1, 1, 1], [10, 8, 7], [1, 8, 1], [10, 1, 7]])
GOALS = np.array([[10, 8, 7], [1, 1, 1], [10, 1, 7], [1, 8, 4]])


def make_obstacles(
    kind=SPHERE, motion=DRIFT, p0=(0.0, 0.0, 0.0), size=(1.0, 1.0, 1.0), exists=False
):
    # One turn about x by 40 degrees, so that a box or capsule is not aligned with the cells.
    q0 = np.array([[np.cos(0.35), np.sin(0.35), 0.0, 0.0]], np.float32)
    return Obstacles(
        kind=np.array([kind], np.int32),
        size_m=np.array([size], np.float32),
        motion=np.array([motion], np.int32),
        path=np.zeros((1, 8), np.float32),
        p0=np.array([p0], np.float32),
        q0=q0,
        nu0=np.zeros((1, 6), np.float32),
        mass_kg=np.ones(1, np.float32),
        inertia_kgm2=np.ones((1, 3), np.float32),
        volume_m3=np.ones(1, np.float32),
        M_A=np.zeros((1, 6), np.float32),
        D_l=np.zeros((1, 6), np.float32),
        D_q=np.zeros((1, 6), np.float32),
        exists=np.array([exists]),
        kinds=(kind,),
        motions=(motion,),
    )


def make_world(occupied, starts, goals, obstacles=None, floor_below=0.0):
    shape = np.array(occupied.shape)
    origin = np.array([-shape[0], -shape[1], 0.0]) * CELL / 2 + [0, 0, -2 - shape[2] * CELL]
    n = len(starts)

    def centre(cells):
        return np.asarray(origin + (np.asarray(cells) + 0.5) * CELL, np.float32)

    return Environment(
        grid=Grid(
            occupied=np.asarray(occupied),
            origin_m=origin.astype(np.float32),
            cell_m=np.float32(CELL),
        ),
        floor_z_m=np.float32(origin[2] - floor_below),
        obstacles=obstacles if obstacles is not None else make_obstacles(),
        current=(),
        start_m=centre(starts),
        start_yaw_rad=np.zeros(n, np.float32),
        goal_m=centre(goals),
        density=np.float32(occupied.mean()),
        path_ratio=np.ones(n, np.float32),
        line_free=np.zeros(n, bool),
        redraws=np.int32(0),
        valid=np.array(True),
    )


def random_rock(rng, density, keep):
    occupied = rng.random(SHAPE) < density
    for cell in keep:
        i, j, k = np.maximum(cell - 1, 0)
        occupied[i : cell[0] + 2, j : cell[1] + 2, k : cell[2] + 2] = False
    return occupied


def stack(worlds):
    return jax.tree.map(lambda *leaf: np.stack(leaf), *worlds)


def dense(times, points, step=0.02):
    """Positions of a path at dense times, by numpy."""
    t = np.arange(0.0, CONFIG.horizon_s + 5.0, step)
    return np.stack([np.interp(t, times, points[:, k]) for k in range(3)], axis=-1)


def rock_gap(world, points):
    """Least distance of points [n, 3] to any occupied cell of the world."""
    low = world.grid.origin_m + np.argwhere(world.grid.occupied) * CELL
    outside = np.maximum(np.maximum(low - points[:, None], points[:, None] - low - CELL), 0.0)
    return np.sqrt(np.sum(outside**2, axis=-1)).min(initial=np.inf)


@pytest.fixture(scope="module")
def planner():
    @quickly
    def run(worlds):
        return jax.vmap(lambda w: plan_world(w, jnp.asarray(RADIUS), jnp.asarray(SPEED), CONFIG))(
            worlds
        )

    def call(worlds):
        return jax.tree.map(np.asarray, run(stack(worlds)))

    return call


@pytest.fixture(scope="module")
def worlds():
    rng = np.random.default_rng(5)
    density = [0.0, 0.05, 0.1, 0.1, 0.2, 0.2, 0.3, 0.3]
    keep = np.concatenate([STARTS, GOALS])
    return [make_world(random_rock(rng, d, keep), STARTS, GOALS) for d in density]


@pytest.fixture(scope="module")
def plans(planner, worlds):
    return planner(worlds)


def team_gap(position, time, radius=RADIUS):
    """Least distance between hulls of a team over all times."""
    tracks = [dense(t, p) for t, p in zip(time, position, strict=True)]
    return min(
        np.linalg.norm(tracks[i] - tracks[j], axis=-1).min() - radius[i] - radius[j]
        for i, j in itertools.combinations(range(len(tracks)), 2)
    )


def test_most_plans_are_found(plans):
    # At most 30 % rock, starts and goals in the open: a planner that fails often here is broken.
    assert plans.found.mean() > 0.9
    assert plans.found[:4].all()


def test_paths_begin_and_end_where_they_should(plans, worlds):
    for w, world in enumerate(worlds):
        np.testing.assert_array_equal(plans.position_m[w, :, 0], world.start_m)
        np.testing.assert_array_equal(plans.time_s[w, :, 0], 0.0)
        end = np.where(plans.found[w][:, None], world.goal_m, world.start_m)
        np.testing.assert_array_equal(plans.position_m[w, :, -1], end)
    assert (np.diff(plans.time_s, axis=-1) >= 0.0).all()
    assert (plans.time_s <= CONFIG.horizon_s).all()


def test_no_path_comes_near_rock(plans, worlds):
    for w, world in enumerate(worlds):
        for i in range(len(RADIUS)):
            track = dense(plans.time_s[w, i], plans.position_m[w, i], step=0.1)
            # 1 mm for float32 at 10 m and the planner's own 0.1 mm.
            assert rock_gap(world, track) >= RADIUS[i] + CONFIG.margin_m - 1e-3
            low = world.grid.origin_m + RADIUS[i]
            high = world.grid.origin_m + CELL * np.array(SHAPE) - RADIUS[i]
            assert (track >= low).all()
            assert (track <= high).all()


def test_robots_keep_apart_at_all_times(plans):
    for w in range(N_WORLD):
        # The margin is kept, but for 1 mm of rounding, wherever plans met at all.
        assert team_gap(plans.position_m[w], plans.time_s[w]) >= CONFIG.margin_m - 2e-3


def test_never_faster_than_cruise_speed(plans):
    span = np.diff(plans.time_s, axis=-1)
    way = np.linalg.norm(np.diff(plans.position_m, axis=2), axis=-1)
    # 1 mm: float32 rounding of positions of 10 m and times of 100 s.
    assert (way <= SPEED[None, :, None] * span + 1e-3).all()


def test_path_of_a_lone_robot_is_no_longer_than_the_lattice_path(planner, worlds):
    # The goals of robots 1 to 3 are their starts, off the way of robot 0: it alone moves.
    layers = (2.0, 3.0, 4.0)
    lone = []
    for world in worlds:
        goals = STARTS.copy()
        goals[0] = (9, 7, 6)
        lone.append(make_world(world.grid.occupied, STARTS, goals))
    plans = planner(lone)
    excess = []
    for w, world in enumerate(lone):
        free = ~world.grid.occupied
        quickest = least_costs(free, STARTS[0], layers)[9, 7, 6]
        shortest = CELL * least_costs(free, STARTS[0])[9, 7, 6]
        assert plans.found[w, 0] == np.isfinite(quickest)
        if plans.found[w, 0]:
            way = np.linalg.norm(np.diff(plans.position_m[w, 0], axis=0), axis=-1).sum()
            # A layer is half a step at cruise speed; the pulled path only goes ahead of it.
            assert plans.time_s[w, 0, -1] <= quickest * 0.5 * CELL / SPEED[0] + 1e-3
            excess.append(way / shortest)
    # Rounding 2.83 and 3.46 up to whole layers may choose another lattice path than the shortest,
    # at most 3/2.83 = 6 % longer; pulling gains more than that on the mean.
    assert max(excess) <= 1.06
    assert np.mean(excess) < 1.0


def test_empty_water_is_crossed_in_a_straight_line(plans, worlds):
    straight = np.linalg.norm(worlds[0].goal_m[0] - worlds[0].start_m[0])
    # Robot 0 has nobody to give way to once the starts of the others are left.
    assert plans.time_s[0, 0, -1] <= straight / SPEED[0] * 1.1
    way = np.linalg.norm(np.diff(plans.position_m[0, 0], axis=0), axis=-1).sum()
    assert way <= 1.05 * straight


def test_same_input_same_bytes(planner, plans, worlds):
    again = planner(worlds)
    for a, b in zip(jax.tree.leaves(plans), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_batch_and_robots_in_groups_are_planned_the_same(plans, worlds, monkeypatch):
    """Alone, and marking four robots in groups of three, of which the last is not full."""
    # The loops of a batch end when its slowest world ends; alone, a world ends earlier.
    monkeypatch.setattr(search, "ROBOTS_PER_LOOP", 3)
    single = quickly(partial(plan_world, config=CONFIG))
    for w in (0, 1, 4, 7):
        alone = single(worlds[w], RADIUS, SPEED)
        np.testing.assert_array_equal(alone.found, plans.found[w])
        # 0.1 mm and 0.1 ms: the two programs may round differently in float32 at 100 s.
        np.testing.assert_allclose(alone.position_m, plans.position_m[w], atol=1e-4)
        np.testing.assert_allclose(alone.time_s, plans.time_s[w], atol=1e-4)


def corridor(bay):
    """A corridor one cell wide along x at (y, z) = (4, 4), with a bay half way."""
    occupied = np.ones(SHAPE, bool)
    occupied[1:11, 4, 4] = False
    if bay:
        occupied[5, 5, 4] = False
    # Two cells in rock for robots 2 and 3, which stay there.
    occupied[1, 1, 1] = occupied[10, 8, 7] = False
    return occupied


def test_swap_in_a_corridor_never_collides(planner):
    starts = np.array([[1, 4, 4], [10, 4, 4], [1, 1, 1], [10, 8, 7]])
    goals = np.array([[10, 4, 4], [1, 4, 4], [1, 1, 1], [10, 8, 7]])
    # Where robot 1 begins next to the bay it can wait there until robot 0 has passed.
    beside = starts.copy(), goals.copy()
    beside[0][1], beside[1][1] = (6, 4, 4), (1, 4, 4)
    scenes = [
        make_world(corridor(False), starts, goals),
        make_world(corridor(True), starts, goals),
        make_world(corridor(True), *beside),
    ]
    plans = planner([*scenes, *[scenes[0]] * (N_WORLD - 3)])
    for w in range(3):
        assert team_gap(plans.position_m[w], plans.time_s[w]) >= CONFIG.margin_m - 2e-3
        assert plans.found[w, 2:].all()
    assert not plans.found[0, :2].all()


def test_a_robot_waits_in_a_bay_for_another_to_pass(planner):
    # Robot 0 comes down the corridor; robot 1 must go the other way and can only dodge it there.
    starts = np.array([[10, 4, 4], [3, 4, 4], [1, 1, 1], [10, 8, 7]])
    goals = np.array([[1, 4, 4], [10, 4, 4], [1, 1, 1], [10, 8, 7]])
    # From 30 s on the start of robot 1 is no longer kept clear: robot 0 waits for that, then comes.
    plans = planner([make_world(corridor(True), starts, goals)] * N_WORLD)
    assert plans.found[0].all()
    assert team_gap(plans.position_m[0], plans.time_s[0]) >= CONFIG.margin_m - 2e-3
    bay = make_world(corridor(True), [[5, 5, 4]], [[5, 5, 4]]).start_m[0]
    near = np.linalg.norm(plans.position_m[0, 1] - bay, axis=-1)
    assert near.min() < 0.5 * CELL


def test_closed_goal_fails_alone(planner, worlds):
    occupied = worlds[1].grid.occupied.copy()
    # A shell of rock about the goal of robot 3 (1, 8, 4), which itself stays free.
    occupied[0:3, 7:10, 3:6] = True
    occupied[1, 8, 4] = False
    world = make_world(occupied, STARTS, GOALS)
    plans = planner([world] * N_WORLD)
    # Robot 2 ends at the start of robot 3, which stays: it is not let in either.
    np.testing.assert_array_equal(plans.found[0], [True, True, False, False])
    assert (plans.position_m[0, 3] == world.start_m[3]).all()
    assert team_gap(plans.position_m[0], plans.time_s[0]) >= CONFIG.margin_m - 2e-3


@pytest.fixture(scope="module")
def passing():
    """A function (starts, goals, config) -> world and plans of two robots in open water."""
    config = PathSearchConfig(margin_m=0.9)
    run = quickly(partial(plan_world, config=config))

    def call(starts, goals):
        world = make_world(np.zeros((9, 7, 7), bool), starts, goals)
        path = run(world, RADIUS[:2], SPEED[:2])
        return jax.tree.map(np.asarray, path), config

    return call


# The straight way leads past the one that stays at a distance of a cell, 1.5 m: clear of the hulls
# (0.4 m and 0.45 m), but not by the margin of 0.9 m as well.
LANE = (1, 3, 3), (7, 3, 3)
BESIDE = (4, 4, 3)


@pytest.mark.parametrize("first_stays", [True, False])
def test_robots_keep_the_margin_beyond_their_radii(passing, first_stays):
    ways = [(BESIDE, BESIDE), LANE] if first_stays else [LANE, (BESIDE, BESIDE)]
    path, config = passing(*(np.array(cells) for cells in zip(*ways, strict=True)))
    assert path.found.all()
    gap = team_gap(path.position_m, path.time_s, RADIUS[:2])
    # As for all teams: 2 mm for rounding and for looking at times 20 ms apart.
    assert gap >= config.margin_m - 2e-3


@pytest.mark.parametrize(
    "off",
    [(0.0, 0.3, 0.0), (0.5, 0.3, 0.6), (0.7, 0.3, 0.7), (-0.7, 0.3, 0.7), (-0.5, 0.3, 0.6)],
    ids=["near", "edge", "corner", "behind", "edge behind"],
)
def test_ends_nearer_to_rock_than_the_margin_are_met_at_cruise_speed(beside_rock, off):
    """There the last leg keeps to the timetable of the search, and that has to count it.

    From a corner of the cell to its centre it is farther than a layer's way of 0.75 m; from the
    edges here by 9 cm.
    """
    start, goal, path = beside_rock(off)
    assert path.found[0]
    np.testing.assert_array_equal(path.position_m[0, 0], start[0])
    np.testing.assert_array_equal(path.position_m[0, -1], goal[0])
    span = np.diff(np.asarray(path.time_s[0]))
    way = np.linalg.norm(np.diff(np.asarray(path.position_m[0]), axis=0), axis=-1)
    # 1 mm, as for all paths.
    assert (way <= SPEED[0] * span + 1e-3).all()


@pytest.fixture(scope="module")
def beside_rock():
    """A function off -> start, goal and plan; both lie so beside the centre of their cell."""
    occupied = np.zeros((8, 7, 7), bool)
    occupied[1, 4, 3] = occupied[6, 4, 3] = True
    world = make_world(occupied, [[1, 3, 3]], [[6, 3, 3]])
    # 0.45 m from the rock's face: the hull has 5 cm to spare, the margin is 20 cm.
    return lambda off: from_beside(world, off, off)


run_beside = quickly(partial(plan_world, config=PathSearchConfig(margin_m=0.2)))


def from_beside(world, start_off, goal_off):
    """Start, goal and plan of one robot; both ends lie beside the centre of their cell."""
    start, goal = world.start_m + np.float32(start_off), world.goal_m + np.float32(goal_off)
    moved = Environment(**{**vars(world), "start_m": start, "goal_m": goal})
    return start, goal, run_beside(moved, RADIUS[:1], SPEED[:1])


@pytest.fixture(scope="module")
def hasty():
    """Plans within 10 s that keep off no start."""
    return quickly(partial(plan_world, config=PathSearchConfig(horizon_s=10.0, start_hold_s=0.0)))


def test_a_path_that_meets_a_start_in_its_first_second_is_taken_back(hasty):
    """Robot 1 has no way, so it stays; robot 0 was not told to keep off where it starts."""
    occupied = np.zeros((9, 7, 7), bool)
    occupied[4, 5, 5] = True
    world = make_world(occupied, [LANE[0], (2, 3, 3)], [LANE[1], (4, 5, 5)])
    path = hasty(world, RADIUS[:2], np.float32([5.0, 5.0]))
    assert not path.found.any()
    # At 5 m/s it would have passed a start a cell ahead within a second; one off its way it may.
    world = make_world(occupied, [LANE[0], (2, 1, 1)], [LANE[1], (4, 5, 5)])
    path = hasty(world, RADIUS[:2], np.float32([5.0, 5.0]))
    np.testing.assert_array_equal(path.found, [True, False])
    x = np.interp(1.0, path.time_s[0], path.position_m[0, :, 0])
    assert x > world.start_m[0, 0] + 2 * CELL


def test_goal_past_the_horizon_is_not_found(hasty):
    """In open water, and behind a wall, where each leg of the way alone ends before it."""
    wall = np.zeros((9, 7, 7), bool)
    wall[4, :, :6] = True
    corners = [(1, 1, 1), (1, 5, 1)], [(7, 5, 5), (1, 5, 1)]  # robot 1 stays
    for occupied in (np.zeros((9, 7, 7), bool), wall):
        world = make_world(occupied, *corners)
        way = float(np.linalg.norm(world.goal_m[0] - world.start_m[0]))
        late = hasty(world, RADIUS[:2], np.float32([0.99 * way / 10.0, 1.0]))
        np.testing.assert_array_equal(late.found, [False, True])
        assert (np.asarray(late.position_m[0]) == world.start_m[0]).all()
        in_time = hasty(world, RADIUS[:2], np.float32([2.0 * way / 10.0, 1.0]))
        assert in_time.found.all()


def test_static_obstacles_and_floor_are_kept_clear():
    shapes = [
        (SPHERE, (-4.6, 0.2, -7.0), (1.6, 0.0, 0.0)),
        (BOX, (0.3, -0.1, -7.2), (1.2, 1.5, 1.9)),
        (CAPSULE, (4.4, 0.3, -7.1), (0.8, 2.0, 0.0)),
    ]
    each = [make_obstacles(kind, STATIC, p0, size, exists=True) for kind, p0, size in shapes]
    rows = {
        name: np.concatenate([getattr(one, name) for one in each])
        for name in vars(each[0])
        if name not in ("kinds", "motions")
    }
    obstacles = Obstacles(**rows, kinds=(SPHERE, BOX, CAPSULE), motions=(STATIC,))
    # The floor stands inside the second layer of cells.
    world = make_world(
        np.zeros((12, 7, 7), bool), [[0, 3, 3]], [[11, 3, 3]], obstacles, floor_below=-2.0
    )
    path = quickly(partial(plan_world, config=CONFIG))(world, RADIUS[:1], SPEED[:1])
    assert path.found[0]
    track = dense(np.asarray(path.time_s[0]), np.asarray(path.position_m[0]), step=0.1)

    @quickly
    def gaps(points):
        def gap(p, row):
            return capsules_obstacle(p[None], p[None], jnp.zeros(1), *row)

        table = (obstacles.p0, obstacles.q0, obstacles.kind, obstacles.size_m)
        one = jax.vmap(gap, in_axes=(None, 0))
        return jax.vmap(one, in_axes=(0, None))(points, table)

    # Each of the three stands in the straight line.
    straight = np.linspace(world.start_m[0], world.goal_m[0], len(track))
    assert (gaps(straight).min(axis=0) < RADIUS[0]).all()
    assert gaps(track).min() >= RADIUS[0] + CONFIG.margin_m - 1e-3
    assert track[:, 2].min() >= world.floor_z_m + RADIUS[0] + CONFIG.margin_m - 1e-3


def test_starts_and_goals_off_the_centres_are_met_exactly():
    world = make_world(np.zeros((8, 7, 7), bool), [[1, 1, 1]], [[6, 5, 5]])
    start, goal, path = from_beside(world, [[0.3, -0.2, 0.25]], [[-0.4, 0.1, 0.3]])
    assert path.found[0]
    np.testing.assert_array_equal(path.position_m[0, 0], start[0])
    np.testing.assert_array_equal(path.position_m[0, -1], goal[0])
    # Nothing in the way: a straight line at cruise speed, up to float32 rounding of 60 s.
    straight = np.linalg.norm(goal - start) / SPEED[0]
    np.testing.assert_allclose(path.time_s[0, -1], straight, rtol=1e-5)


def test_too_high_a_grid_is_refused():
    world = make_world(np.zeros((2, 2, 33), bool), [[0, 0, 0]], [[1, 1, 32]])
    with pytest.raises(UnsupportedError, match="33"):
        jax.eval_shape(partial(plan_world, config=CONFIG), world, RADIUS[:1], SPEED[:1])
