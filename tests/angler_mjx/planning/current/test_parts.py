"""Parts of the planner in currents, each against a closed form or a computation in NumPy."""

import itertools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from angler_mjx.planning.current import planner, search, shaping
from angler_mjx.planning.current.map import step_costs
from angler_mjx.planning.current.motion_cost import NO_PATH_COST, cost_and_speed, power_model
from angler_mjx.planning.current.timetable import schedule_departures
from angler_mjx.planning.path_search.traffic import GridTraffic
from angler_mjx.robot.control.commands.trajectory import Trajectory, hold_position

from ...compiling import quickly
from ..problems import problem

CRUISE = 0.5
TERMINAL = np.array([1.5, 1.0, 0.7])
STILL = np.zeros(3, np.float32)


def robot(objective, effort=0.7, limited=False):
    """A robot whose axes differ: 80, 120 and 200 W at 1 m/s, above 20 W at rest."""
    speed = np.linspace(0.0, 1.0, 9) * TERMINAL[:, None]
    power = 20.0 + np.array([80.0, 120.0, 200.0])[:, None] * speed**3
    cruise, terminal = jnp.float32(CRUISE), jnp.asarray(TERMINAL, jnp.float32)
    power = jnp.asarray(power, jnp.float32)
    return power_model(cruise, terminal, power, effort, objective, limited)


def land_of(**keys):
    return jax.jit(planner._problem_terrain)(problem(**keys))


def test_steps_lead_to_all_26_neighbours():
    steps = {tuple(step) for step in search.STEPS.tolist()}
    assert len(search.STEPS) == len(steps) == 26
    assert steps == {s for s in itertools.product((-1, 0, 1), repeat=3) if any(s)}


def cheapest(robot, d, c, limit_mps=np.inf):
    """Cost of a metre and speed over ground of the best speed through the water, in NumPy."""
    factor, n, limit = (
        np.asarray(a, float) for a in (robot.factor, robot.exponent, robot.limit_mps)
    )
    rest, hurry = float(robot.rest_w), float(robot.time_weight_w)

    def watts(axes):
        return rest + np.sum((factor * np.abs(axes) ** n) ** (4 / 3)) ** 0.75

    still = watts(np.array([CRUISE, 0.0, 0.0])) + hurry
    ahead = np.array([d[0], d[1], 0.0]) / np.hypot(d[0], d[1])
    body = np.stack([ahead, np.cross([0.0, 0.0, 1.0], ahead), [0.0, 0.0, 1.0]])
    best = (NO_PATH_COST, 0.1 * CRUISE)
    for ratio in (0.5, 0.75, 1.0, 1.25, 1.5, 2.0):
        # s d - c has the length V: s^2 - 2 s d.c + c.c - V^2 = 0.
        roots = np.roots([1.0, -2.0 * d @ c, c @ c - (ratio * CRUISE) ** 2])
        if np.iscomplex(roots).any() or roots.real.max() <= 0.1 * CRUISE:
            continue
        speed = min(roots.real.max(), limit_mps)
        axes = body @ (speed * d - c)
        if np.sum((axes / limit) ** 2) <= 1.0:
            best = min(best, ((watts(axes) + hurry) * CRUISE / (still * speed), speed))
    return best


@pytest.mark.parametrize("limited", [False, True])
def test_the_pace_of_least_energy_is_the_best_of_all_speeds(limited):
    rng = np.random.default_rng(3)
    d = rng.normal(size=(300, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    c = 0.35 * rng.normal(size=(300, 3))
    swims = robot("energy", limited=limited)
    cost, speed = jax.vmap(lambda d, c: cost_and_speed(swims, d, c))(jnp.asarray(d), jnp.asarray(c))
    limit_mps = CRUISE if limited else np.inf
    want = np.array([cheapest(swims, *row, limit_mps) for row in zip(d, c, strict=True)])
    assert (np.max(speed) > CRUISE) == (not limited)
    goes = want[:, 0] < NO_PATH_COST
    assert 100 < goes.sum() < 280, "some currents cannot be overcome"
    np.testing.assert_allclose(cost, want[:, 0], rtol=2e-3)
    np.testing.assert_allclose(speed[~goes], 0.1 * CRUISE, rtol=1e-6)
    # Two speeds may cost the same to rounding.
    assert np.mean(np.abs(np.asarray(speed) / want[:, 1] - 1.0) < 1e-3) > 0.98


@pytest.mark.parametrize("limited", [False, True])
@pytest.mark.parametrize("stays", [True, False])
def test_legs_take_zermelos_time(stays, limited):
    rng = np.random.default_rng(1)
    points = rng.uniform(0.0, 10.0, (6, 3)).astype(np.float32)
    c = np.array([0.2, -0.1, 0.05])
    swims, water = robot("time", limited=limited), jnp.asarray(c, jnp.float32)
    leg = shaping.leg_costs(swims, jnp.asarray(points), lambda p, t: water, jnp.float32(0.0), stays)
    gap = np.diff(points, axis=0)
    length = np.linalg.norm(gap, axis=1)
    along = gap @ c / length
    speed = along + np.sqrt(CRUISE**2 - c @ c + along**2)
    assert speed.min() < CRUISE < speed.max()
    if limited:
        speed = np.minimum(speed, CRUISE)
    np.testing.assert_allclose(leg.span_s, length / speed, rtol=1e-4)
    np.testing.assert_allclose(leg.cost, length * CRUISE / speed, rtol=1e-4)


def test_slopes_are_smoothed_by_the_inverse_second_difference():
    fixed = np.array([0, 0, 0, 1, 0, 0, 0, 0, 1, 1, 0], bool)
    slope = np.random.default_rng(2).normal(size=(len(fixed), 3))
    second = 2.0 * np.eye(len(fixed)) - np.eye(len(fixed), k=1) - np.eye(len(fixed), k=-1)
    want = np.zeros_like(slope)
    free = np.flatnonzero(~fixed)
    want[free] = np.linalg.solve(second[np.ix_(free, free)], slope[free])
    found = shaping._smooth_slope(jnp.asarray(slope, jnp.float32), jnp.asarray(fixed))
    np.testing.assert_allclose(found, want, atol=1e-5)


@pytest.mark.parametrize("ball", [False, True])
def test_metres_near_rock_and_obstacles_cost_by_their_distance(ball):
    obstacles = {"radius_m": [1.2], "p_m": [[[5.2, 2.1, 3.0]]]} if ball else None
    land = land_of(cells=6, rock=[np.s_[2, 3, :4]], obstacles=obstacles)
    assert (land.cell_gap_m is not None) == ball
    centres = [np.arange(6) + 0.5] * 3
    at = np.stack(np.meshgrid(*centres, indexing="ij"), axis=-1)
    rock = np.array([[2, 3, k] for k in range(4)], float)
    off = np.maximum(np.maximum(rock - at[..., None, :], at[..., None, :] - rock - 1.0), 0.0)
    gap = np.linalg.norm(off, axis=-1).min(axis=-1)
    gap = np.minimum(gap, np.minimum(at, 6.0 - at).min(axis=-1))
    if ball:
        gap = np.minimum(gap, np.linalg.norm(at - [5.2, 2.1, 3.0], axis=-1) - 1.2)
    p = np.random.default_rng(4).uniform(0.6, 5.4, (200, 3))
    missing = np.maximum(0.5 * 0.8 + 0.4 - RegularGridInterpolator(centres, gap)(p), 0.0)
    near = jax.vmap(lambda p: shaping._nearness_cost(land, p, jnp.float32(0.8)))(
        jnp.asarray(p, jnp.float32)
    )
    assert 20 < np.count_nonzero(missing) < 180
    np.testing.assert_allclose(near, 100.0 * missing**2, atol=2e-3)


def test_steps_are_free_where_all_cells_of_their_block_keep_clear():
    shape, clearance, rock = (6, 6, 6), 0.45, np.array([[1, 4, 2], [4, 1, 3]], float)
    land = land_of(cells=6, rock=[np.s_[1, 4, 2], np.s_[4, 1, 3]])
    team = jax.tree.map(lambda leaf: leaf[None], robot("time"))
    clear_of = jnp.full(1, clearance, jnp.float32)
    cost = np.asarray(step_costs(land, team, clear_of, lambda p: jnp.zeros(3))[0])
    at = np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in shape), indexing="ij"), axis=-1)
    off = np.maximum(np.maximum(rock - at[..., None, :], at[..., None, :] - rock - 1.0), 0.0)
    clear = np.linalg.norm(off, axis=-1).min(axis=-1) >= clearance
    assert 0.7 < clear.mean() < 1.0
    for number, step in enumerate(search.STEPS):
        for cell in np.ndindex(shape):
            ends = np.stack([cell, cell + step])
            low, high = ends.min(axis=0), ends.max(axis=0) + 1
            inside = np.all(low >= 0) and np.all(high <= shape)
            free = inside and clear[tuple(map(slice, low, high))].all()
            want = np.linalg.norm(step) if free else np.inf
            assert cost[number][cell] == pytest.approx(want, rel=1e-3), (step, cell)


def test_places_on_the_faces_lie_in_the_last_cells():
    land = land_of(cells=6)
    place = jnp.array([[0.0, 0.0, 0.0], [6.0, 6.0, 6.0], [5.99, 6.01, 0.5], [1.5, 2.0, -0.1]])
    want = [[0, 0, 0], [5, 5, 5], [5, 5, 0], [1, 2, 0]]
    np.testing.assert_array_equal(planner._cells_at(land, place), want)


@pytest.fixture(scope="module")
def descended():
    """A function of a size, and the way bent at first, that gives the way after the descent."""
    land, swims = land_of(cells=8), robot("time")
    grid = land.grid

    @quickly
    def run(points, size):
        bigger = replace(
            land,
            grid=replace(grid, cell_m=size * grid.cell_m, origin_m=size * grid.origin_m),
            gap_m=size * land.gap_m,
        )
        return shaping.descend_path(
            bigger,
            swims,
            points,
            jnp.float32(0.4) * size,
            jnp.float32(0.0),
            lambda p, t: jnp.zeros(3),
            stays=True,
        )

    return lambda points, size: np.asarray(run(jnp.asarray(points * size), jnp.float32(size)))


BENT = np.array(
    [
        [1.5, 1.5, 4.0],
        [2.0, 4.0, 4.0],
        [2.6, 5.0, 4.0],
        [3.0, 6.0, 4.0],
        [6.0, 6.0, 4.0],
        [6.5, 2.0, 4.0],
    ],
    np.float32,
)


def test_a_bent_way_in_still_water_becomes_straight(descended):
    way = descended(BENT, 1.0)
    ahead = (BENT[-1] - BENT[0]) / np.linalg.norm(BENT[-1] - BENT[0])
    aside = np.linalg.norm(np.cross(way - BENT[0], ahead), axis=1)
    assert aside.max() < 0.03
    np.testing.assert_allclose(way[[0, -1]], BENT[[0, -1]], atol=1e-5)
    length = np.linalg.norm(np.diff(way, axis=0), axis=1).sum()
    assert length < 1.001 * np.linalg.norm(BENT[-1] - BENT[0])


def test_a_way_of_another_size_is_bent_alike(descended):
    np.testing.assert_allclose(descended(BENT, 4.0), 4.0 * descended(BENT, 1.0), atol=0.02)


def test_a_team_goes_at_once_past_bodies_that_leave_room():
    """The way passes a standing ball of 0.3 m at 1 m: 0.3 + 0.1 m of the robot leave 0.3 m."""
    start, goal = np.array([0.0, 0.0, 0.0]), np.array([4.0, 0.0, 0.0])
    ways = Trajectory(
        time_s=jnp.array([[[0.0, 8.0]]]),
        position_m=jnp.asarray(np.stack([start, goal])[None, None], jnp.float32),
        found=jnp.ones((1, 1), bool),
    )
    held = hold_position(jnp.asarray(start[None], jnp.float32), 2)

    def goes(y):
        bodies = GridTraffic(
            time_s=jnp.zeros((1, 1)),
            position_m=jnp.array([[[2.0, y, 0.0]]]),
            reach_m=jnp.array([0.3]),
            until_s=jnp.full(1, jnp.inf),
        )
        radius = jnp.full(1, 0.3, jnp.float32)
        return bool(schedule_departures(ways, held, radius, bodies, 0.1, 60.0).found[0])

    assert goes(1.0)
    assert goes(0.72)
    assert not goes(0.68)
