"""Moving obstacles in the grid planner's traffic, judged by positions sampled with NumPy."""

from functools import partial

import numpy as np
import pytest

from angler_mjx.planning.path_search.bodies import GOAL_CLEAR_S, bodies_traffic
from angler_mjx.planning.path_search.robot_search import PathSearchConfig
from angler_mjx.sim.information import ObstacleInformation

from ..compiling import quickly
from .problems import plan_world
from .test_grid import make_world

HORIZON_S = 60.0
CONFIG = PathSearchConfig(horizon_s=HORIZON_S)
RADIUS, SPEED, BODY = np.float32([0.4]), np.float32([0.5]), 0.6
TIMES = np.arange(0.0, HORIZON_S + 0.25, 0.5)
OPEN = make_world(np.zeros((9, 7, 7), bool), [(1, 3, 3)], [(7, 3, 3)])
FINE = np.arange(0.0, HORIZON_S, 0.02)

run = quickly(partial(plan_world, config=CONFIG))


def told(places, moves=True, velocity=(0.0, 0.0, 0.0), times=TIMES):
    """One body at ``places`` [T, 3]."""
    n = len(places)
    return ObstacleInformation(
        kind=np.int32([0]),
        half_size_m=np.float32([[BODY, 0.0, 0.0]]),
        radius_m=np.float32([BODY]),
        exists=np.array([True]),
        moves=np.array([moves]),
        velocity_mps=np.float32([velocity]),
        time_s=np.float32(times),
        p_m=np.float32(places)[None],
        q=np.broadcast_to(np.float32([1.0, 0, 0, 0]), (1, n, 4)),
    )


def gap(path, places, times=TIMES, stands_s=GOAL_CLEAR_S):
    """Least distance of the centres from the start to some time after the arrival."""
    end = float(np.asarray(path.time_s)[0].max())
    t = FINE[end + stands_s > FINE]
    robot = along(path, t)
    body = np.stack([np.interp(t, times, np.asarray(places)[:, k]) for k in range(3)], axis=1)
    return np.linalg.norm(robot - body, axis=1).min()


def along(path, t):
    when, where = np.asarray(path.time_s)[0], np.asarray(path.position_m)[0]
    return np.stack([np.interp(t, when, where[:, k]) for k in range(3)], axis=1)


@pytest.fixture(scope="module")
def blind():
    """Straight along the lane, 9 m in 18 s."""
    return quickly(partial(plan_world, config=CONFIG))(OPEN, RADIUS, SPEED)


def test_what_comes_along_the_lane_is_kept_clear(blind):
    start, goal = OPEN.start_m[0], OPEN.goal_m[0]
    share = np.clip(TIMES / 30.0, 0.0, 1.0)[:, None]
    # To the side at its end, so that it does not stand where the robot begins.
    onto = goal + share * (start + np.float32([0, 3.0, 0]) - goal) * np.float32([1, 0, 0])
    onto[:, 1] = goal[1] + 3.0 * np.clip(share[:, 0] - 0.7, 0.0, 0.3) / 0.3
    known = told(onto)
    seen = run(OPEN, RADIUS, SPEED, obstacles=known)
    assert blind.found.all()
    assert seen.found.all()
    # Told every half second and sampled fifty times a second: below 1 mm.
    assert gap(seen, onto) >= RADIUS[0] + BODY - 1e-3
    assert gap(blind, onto) < RADIUS[0] + BODY
    # A body that stands is no traffic but on the map: here at the goal, which has then no path.
    stands = told(onto, moves=False)
    assert (np.asarray(bodies_traffic(stands, HORIZON_S).until_s) < 0.0).all()
    assert not run(OPEN, RADIUS, SPEED, obstacles=stands).found.any()


def test_what_was_seen_once_goes_straight_on(blind):
    middle = 0.5 * (OPEN.start_m[0] + OPEN.goal_m[0])
    velocity = np.float32([0.0, 0.25, 0.0])
    begin = middle - 9.0 * velocity  # in the middle of the lane when the robot is, 9 s after
    known = told(begin[None], velocity=velocity, times=[0.0])
    seen = run(OPEN, RADIUS, SPEED, obstacles=known)
    assert seen.found.all()
    places = begin + TIMES[:, None] * velocity
    assert gap(blind, places) < 0.1
    assert gap(seen, places) >= RADIUS[0] + BODY - 1e-3


def test_a_goal_need_only_be_clear_for_a_moment(blind):
    """A body that comes to the goal for good: before it the robot arrives, after it never."""
    goal = OPEN.goal_m[0]
    far = goal + np.float32([0, 0, 4.0])
    arrival = float(blind.time_s.max())
    for comes_s, arrives in ((arrival + 12.0, True), (arrival - 8.0, False)):
        share = np.clip((TIMES - comes_s) / 8.0, 0.0, 1.0)[:, None]
        places = far + share * (goal - far)
        seen = run(OPEN, RADIUS, SPEED, obstacles=told(places))
        assert bool(seen.found.all()) is arrives
        if arrives:
            assert gap(seen, places) >= RADIUS[0] + BODY - 1e-3
    # Nothing comes near the start, where a robot without a way stays.
    np.testing.assert_array_equal(seen.position_m[0], np.tile(OPEN.start_m[0], (CONFIG.n_point, 1)))


def test_thinned_ways_hold_every_place_that_was_told():
    rng = np.random.default_rng(1)
    wave = np.cumsum(rng.normal(size=(TIMES.size, 3)), axis=0) * 0.4
    traffic = bodies_traffic(told(wave), HORIZON_S)
    when, where = np.asarray(traffic.time_s)[0], np.asarray(traffic.position_m)[0]
    way = np.stack([np.interp(TIMES, when, where[:, k]) for k in range(3)], axis=1)
    off = np.linalg.norm(way - wave, axis=1).max()
    # float32 on ten metres.
    assert float(traffic.reach_m[0]) == pytest.approx(BODY + off, abs=1e-5)
    assert off > 0.5
    assert when.size < TIMES.size / 3
