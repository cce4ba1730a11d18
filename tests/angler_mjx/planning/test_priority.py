"""Search over priorities: teams that one order cannot plan, judged by places sampled with NumPy."""

from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.planning.path_search.robot_search import (
    MAX_LAYERS,
    PathSearchConfig,
    required_layers,
)
from angler_mjx.planning.priority import planner
from angler_mjx.planning.priority.queue import run_slots
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import load_scenario

from ..compiling import quickly
from .problems import plan_world, world_problem
from .test_grid import CELL, make_world, stack

CONFIG = PathSearchConfig(horizon_s=90.0, start_hold_s=5.0)
BUDGET = 12
RADIUS, SPEED = np.full(3, 0.4, np.float32), np.full(3, 0.5, np.float32)


def tube():
    """A dead end, open on the left; robot 0's goal stands in the way to robot 1's.

    In the order of their index robot 0 goes first and blocks; robot 2 is alone above.
    """
    rock = np.ones((9, 5, 5), bool)
    rock[:3] = False
    rock[:, 2, 2] = False
    rock[:, :, 4] = False
    return make_world(rock, [(0, 2, 2), (0, 0, 2), (0, 0, 4)], [(5, 2, 2), (8, 2, 2), (8, 0, 4)])


def walled():
    """Robot 1's goal is in rock all around: nobody can plan it, whatever the order."""
    rock = np.zeros((9, 5, 5), bool)
    rock[5:8, 1:4, 1:4] = True
    rock[6, 2, 2] = False
    return make_world(rock, [(0, 2, 2), (0, 0, 2), (0, 0, 4)], [(8, 2, 2), (6, 2, 2), (8, 0, 4)])


def easy():
    """Open water: the first order will do."""
    rock = np.zeros((9, 5, 5), bool)
    return make_world(rock, [(0, 2, 2), (0, 0, 2), (0, 0, 4)], [(8, 2, 2), (8, 0, 2), (8, 4, 4)])


def crossing():
    """Open water: straight lines of robots 0 and 1 cross in the middle at the same time."""
    rock = np.zeros((9, 5, 5), bool)
    return make_world(rock, [(0, 2, 2), (8, 0, 2), (0, 0, 4)], [(8, 2, 2), (0, 4, 2), (8, 0, 4)])


WORLDS = stack([tube(), walled(), easy(), tube()])
SEEDS = np.arange(4, dtype=np.uint32)


@cache
def program(slots, config):
    @quickly
    def run(worlds, seeds, radius):
        def build_problem(world, seed):
            one = partial(world_problem, seed=seed, horizon_s=config.horizon_s)
            return one(world, radius, jnp.asarray(SPEED))

        problems = jax.vmap(build_problem)(worlds, seeds)
        return planner.plan_teams(problems, config, BUDGET, slots=slots)

    return run


def plans(worlds, seeds, slots, config=CONFIG, radius=RADIUS):
    return program(slots, config)(worlds, seeds, radius)


@pytest.fixture(scope="module")
def found():
    return plans(WORLDS, SEEDS, slots=2)


@pytest.fixture(scope="module")
def in_order():
    run = jax.vmap(partial(plan_world, config=CONFIG), in_axes=(0, None, None))
    return quickly(run)(WORLDS, RADIUS, SPEED)


def test_another_order_plans_what_the_first_cannot(found, in_order):
    np.testing.assert_array_equal(in_order.found[0], [True, False, True])
    assert np.asarray(found.found)[[0, 2, 3]].all()
    # Whose goal cannot be reached has no way, and takes nobody else's.
    np.testing.assert_array_equal(found.found[1], [True, False, True])


def test_a_team_in_which_nobody_is_in_the_way_is_planned_as_by_grid(found, in_order):
    for leaf, other in zip(jax.tree.leaves(found), jax.tree.leaves(in_order), strict=True):
        np.testing.assert_array_equal(leaf[2], other[2])


def test_no_two_robots_meet_whether_they_have_ways_or_not(found):
    t = np.arange(0.0, CONFIG.horizon_s, 0.02)
    for w in range(4):
        at = np.stack(
            [
                np.stack([np.interp(t, found.time_s[w, r], p[:, k]) for k in range(3)], axis=1)
                for r, p in enumerate(np.asarray(found.position_m[w]))
            ]
        )
        np.testing.assert_array_equal(at[:, 0], WORLDS.start_m[w])
        for r in range(3):
            goal = WORLDS.goal_m[w, r] if found.found[w, r] else WORLDS.start_m[w, r]
            np.testing.assert_allclose(at[r, -1], goal, atol=1e-5)
            for other in range(r):
                gap = np.linalg.norm(at[r] - at[other], axis=1).min()
                # Sampled every 1 cm of way.
                assert gap >= RADIUS[r] + RADIUS[other] + CONFIG.margin_m - 0.02


def least_gap(paths, w):
    """Least distance of robots 0 and 1 of world w, sampled every 1 cm of way."""
    t = np.arange(0.0, CONFIG.horizon_s, 0.02)
    times, points = np.asarray(paths.time_s[w]), np.asarray(paths.position_m[w])
    at = [
        np.stack([np.interp(t, times[r], points[r, :, k]) for k in range(3)], axis=1)
        for r in (0, 1)
    ]
    return np.linalg.norm(at[0] - at[1], axis=1).min()


def test_room_beyond_the_margin_is_kept_where_there_is_some():
    worlds = stack([crossing(), tube()])
    close, wide = (
        plans(worlds, SEEDS[:2], slots=2, config=replace(CONFIG, room_m=room))
        for room in (0.0, 0.8)
    )
    reach = 2 * RADIUS[0] + CONFIG.margin_m
    assert reach - 0.02 <= least_gap(close, 0) < reach + 0.8 - 0.02
    assert least_gap(wide, 0) >= reach + 0.8 - 0.02
    # Robots that share a tube have none, and have ways all the same.
    assert np.asarray(wide.found).all()
    assert reach - 0.02 <= least_gap(wide, 1)


def two_lanes():
    """Robots 0 and 1 swap the ends of one of two lanes, one cell apart; robot 2 is alone above."""
    rock = np.ones((9, 5, 5), bool)
    rock[:, 2:4, 2] = False
    rock[:, 0, 4] = False
    return make_world(rock, [(0, 2, 2), (8, 2, 2), (0, 0, 4)], [(8, 2, 2), (0, 2, 2), (8, 0, 4)])


@pytest.mark.parametrize(("spare_m", "passes"), [(0.4, False), (0.6, True)])
def test_a_quarter_of_the_room_is_kept_by_every_search(spare_m, passes):
    """Lanes that much further apart than the reach; whoever changes the lane needs 0.35 m of it.

    A quarter of 0.8 m leaves 0.2 and 0.4 m.
    """
    radius = np.full(3, (CELL - spare_m - CONFIG.margin_m) / 2, np.float32)
    config = replace(CONFIG, room_m=0.8)
    found = plans(stack([two_lanes()]), SEEDS[:1], slots=1, config=config, radius=radius)
    np.testing.assert_array_equal(found.found[0], [passes, passes, True])


def test_a_world_is_planned_alike_whatever_lies_beside_it(found):
    alone = plans(jax.tree.map(lambda leaf: leaf[:1], WORLDS), SEEDS[:1], slots=1)
    for leaf, other in zip(jax.tree.leaves(alone), jax.tree.leaves(found), strict=True):
        np.testing.assert_array_equal(leaf[0], other[0])


@pytest.mark.parametrize(("count", "slots"), [(1, 4), (7, 1), (7, 3), (7, 7)])
def test_the_queue_steps_each_task_to_its_own_end(count, slots):
    """Collatz sequences, whose lengths differ much; against a loop in Python."""
    starts = np.array([27, 1, 6, 97, 2, 11, 3])[:count]

    def length(n):
        steps = 1
        n = n // 2 if n % 2 == 0 else 3 * n + 1
        while n != 1:
            n, steps = (n // 2 if n % 2 == 0 else 3 * n + 1), steps + 1
        return steps

    found = run_slots(
        jnp.asarray(starts),
        count,
        slots,
        begin=lambda n: (n, jnp.int32(0)),
        step=lambda _, at: (jnp.where(at[0] % 2 == 0, at[0] // 2, 3 * at[0] + 1), at[1] + 1),
        ended=lambda at: at[0] == 1,
        result=lambda at: at[1],
    )
    np.testing.assert_array_equal(found, [length(int(n)) for n in starts])


def test_layers_let_a_robot_search_as_fast_as_it_is():
    # 180 s at 0.5 m/s are 60 cells of 1.5 m: 120 half steps, and a sixth more for diagonals.
    assert required_layers(180.0, 0.5, 1.5) == 140
    assert required_layers(10.0, 0.5, 1.5) == PathSearchConfig().n_layer
    assert required_layers(86400.0, 3.0, 0.1) == MAX_LAYERS


def test_settings_out_of_bounds_are_refused_by_name():
    with pytest.raises(ConfigError, match=r"planner\.priority.*budget = 0: must be 1 to 10000"):
        load_scenario("reef_fleet", planner={"name": "priority", "priority": {"budget": 0}})
    with pytest.raises(
        ConfigError, match=r"information\.current = \"truth\": the planner priority"
    ):
        Simulator(
            load_scenario(
                "reef_fleet", planner={"name": "priority", "information": {"current": "truth"}}
            )
        )
