"""Order of passing: judged by clocks that are simulated here, and by distances in closed form."""

import jax
import numpy as np
import pytest

from angler_mjx.planning.online import order
from angler_mjx.robot.control.commands.trajectory import Trajectory

from ...compiling import quickly

REACH = 1.0


def lines(*paths):
    """Plans of robots, each of (time, point) pairs, padded."""
    rows = max(len(path) for path in paths)
    padded = [list(path) + [path[-1]] * (rows - len(path)) for path in paths]
    return Trajectory(
        time_s=np.array([[t for t, _ in path] for path in padded], np.float32),
        position_m=np.array([[p for _, p in path] for path in padded], np.float32),
        found=np.ones(len(paths), bool),
    )


CROSS = lines(
    [(0, (-5, 0, 0)), (10, (5, 0, 0))],
    [(0, (0, -5, 0)), (5, (0, -5, 0)), (15, (0, 5, 0))],
)
"""The first passes the crossing at 5 s, the second at 10 s."""

BESIDE = lines(
    [(0, (-5, 0, 0)), (20, (5, 0, 0))],
    [(0, (-5, 0.9, 0)), (20, (5, 0.9, 0))],
)
"""Nearer than their reach all the way, and never one behind the other."""

RING = lines(
    [(0, (-6, 1, 0)), (12, (6, 1, 0))],
    [(0, (1, -8, 0)), (16, (1, 8, 0))],
    [(0, (10, -1, 0)), (20, (-10, -1, 0))],
    [(0, (-1, 12, 0)), (24, (-1, -12, 0))],
)
"""Each crosses two others; whoever is late is waited for all round."""


@pytest.fixture(scope="module")
def table():
    return quickly(lambda plan, reach: order.build_order(plan, reach, samples=64))


@pytest.fixture(scope="module")
def bound():
    return quickly(lambda found, clocks: order.clock_limits(found, clocks)[0])


def place(plan, robot, clock):
    time, point = np.asarray(plan.time_s[robot]), np.asarray(plan.position_m[robot])
    return np.array([np.interp(clock, time, point[:, axis]) for axis in range(3)])


def run(table, bound, plan, rates, kept, end_s, dt=0.1, less_s=0.0):
    """Clocks that run at rates; the least distance of any two robots, and the clocks at the end.

    Clocks that are held stop ``less_s`` before their bounds.
    """
    robots = len(rates)
    found = table(plan, np.full((robots, robots), REACH, np.float32))
    clocks, least = np.zeros(robots, np.float32), np.inf
    for _ in range(round(end_s / dt)):
        most = np.maximum(clocks, bound(found, clocks) - np.float32(less_s)) if kept else np.inf
        clocks = np.minimum(clocks + np.float32(dt) * np.array(rates, np.float32), most)
        where = [place(plan, i, clocks[i]) for i in range(robots)]
        for i in range(robots):
            for j in range(i):
                least = min(least, float(np.linalg.norm(where[i] - where[j])))
    return least, clocks


@pytest.mark.parametrize("kept", [False, True])
def test_who_is_late_is_waited_for(table, bound, kept):
    """At half its speed the first is at the crossing with the second, at 10 s."""
    least, clocks = run(table, bound, CROSS, [0.5, 1.0], kept, 40.0)
    assert (least >= REACH) == kept
    assert np.all(clocks > 15.0)


def test_nobody_waits_who_is_in_time(table, bound):
    free, kept = (run(table, bound, CROSS, [1.0, 1.0], x, 15.0)[1] for x in (False, True))
    np.testing.assert_array_equal(free, kept)


@pytest.mark.parametrize("less_s", [0.0, 1e-5])
def test_who_go_side_by_side_wait_for_each_other_and_not_for_ever(table, bound, less_s):
    """However the last bits of clocks and bounds are rounded."""
    least, clocks = run(table, bound, BESIDE, [1.0, 0.5], True, 45.0, less_s=less_s)
    assert np.all(clocks > 20.0)
    apart = [np.linalg.norm(place(BESIDE, 0, t) - place(BESIDE, 1, t)) for t in (0.0, 10.0, 20.0)]
    assert least > min(apart) - 0.05


@pytest.mark.parametrize("late", range(4))
def test_teams_never_stand_and_never_meet(table, bound, late):
    rates = [1.0] * 4
    rates[late] = 0.3
    least, clocks = run(table, bound, RING, rates, True, 90.0)
    assert least >= REACH
    assert np.all(clocks > 24.0)


def test_who_is_behind_all_others_is_never_held(table, bound):
    """Whatever the clocks are: random ones, on plans that cross each other at random."""
    draw = np.random.default_rng(0)
    ends = draw.uniform(-4, 4, (6, 2, 3)).astype(np.float32)
    plan = lines(*([(0, a), (float(draw.uniform(4, 20)), b)] for a, b in ends))
    found = table(plan, np.full((6, 6), REACH, np.float32))
    clocks = draw.uniform(0, 20, (200, 6)).astype(np.float32)
    most, _ = (np.asarray(x) for x in jax.vmap(order.clock_limits, (None, 0))(found, clocks))
    first = np.argmin(clocks, axis=1)
    rows = np.arange(len(clocks))
    assert np.all(most[rows, first] > clocks[rows, first])
    assert np.mean(np.isfinite(most)) > 0.1


def test_who_hears_late_waits_no_less(table):
    """Clocks that were heard are behind the true ones: bounds by them are nowhere farther."""
    found = table(RING, np.full((4, 4), REACH, np.float32))
    rng, nobody = np.random.default_rng(2), np.zeros((4, 4), bool)
    at_m, still = np.zeros((4, 4, 3), np.float32), np.zeros((4, 4), np.float32)
    bound = quickly(
        lambda clocks, heard: order.clock_limits(
            found,
            clocks,
            nobody[0],
            at_m[0],
            still[0],
            order.ObservedTeam(clock_s=heard, stands=nobody, at_m=at_m, speed_mps=still),
        )[0]
    )
    plain = quickly(lambda clocks: order.clock_limits(found, clocks)[0])
    held = 0
    for _ in range(20):
        clocks = rng.uniform(0.0, 12.0, 4).astype(np.float32)
        true = np.broadcast_to(clocks, (4, 4)).copy()
        np.testing.assert_array_equal(bound(clocks, true), plain(clocks))
        late = np.maximum(true - rng.uniform(0.0, 4.0, (4, 4)).astype(np.float32), 0.0)
        late[np.eye(4, dtype=bool)] = clocks
        most = bound(clocks, late)
        assert np.all(most <= plain(clocks))
        held += np.sum(most < plain(clocks))
    assert held > 0
