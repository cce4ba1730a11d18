"""Path integral control of one robot, flown over a model of the velocity loop."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.planning.mppi import distance_field
from angler_mjx.planning.mppi.costs import CostBodies, Weights
from angler_mjx.planning.mppi.sampling import RolloutScene, improve_mean, shift_knots
from angler_mjx.world.rock.grid import Grid

LIMIT, RADIUS, DT, STEPS, KNOTS, SAMPLES = 0.5, 0.32, 0.1, 30, 8, 128
START, GOAL = np.array([-4.0, -3.0, -4.0]), np.array([4.0, -3.0, -4.0])
FOREVER = 400.0


class Loop:
    """A lag of first order, power by the cube of the speed: of no vehicle."""

    def step(self, v, asked, flow, dt_s):
        power = (jnp.sum(asked**2, axis=0) / LIMIT**2) ** 1.5
        return asked + (v - asked) * jnp.exp(-dt_s / 0.3), power


@pytest.fixture(scope="module")
def fly():
    """A function of rock, and of a ball's place at the start and velocity: places every 0.2 s."""

    @jax.jit
    def flown(occupied, ball_m, ball_mps, key):
        origin = jnp.array([-6.0, -6.0, -7.0])
        grid = Grid(occupied=occupied, origin_m=origin, cell_m=jnp.asarray(1.5))
        h = 0.5 * grid.cell_m
        gap = distance_field.obstacle_distance(grid, origin[2])
        left = distance_field.path_length_to_goal(gap >= RADIUS + 0.1, jnp.asarray(GOAL), origin, h)
        seen = distance_field.DistanceField(
            values=jnp.stack([gap, left], -1), origin_m=origin, spacing_m=h
        )
        better = partial(improve_mean, Weights(), Loop(), samples=SAMPLES, dt_s=DT)

        def one(carry, i):
            p, v, knots = carry
            ahead_s = 0.2 * i + DT * (jnp.arange(STEPS) + 1)
            scene = RolloutScene(
                field=seen,
                bodies=CostBodies(
                    centre_m=(ball_m + ball_mps * ahead_s[:, None])[:, None],
                    reach_m=jnp.full(1, 2 * RADIUS),
                ),
                flow_mps=jnp.zeros((STEPS, 3)),
                goal_m=jnp.asarray(GOAL),
                radius_m=jnp.asarray(RADIUS),
                limit_mps=jnp.asarray(LIMIT),
            )
            knots = shift_knots(knots, 0.2, STEPS * DT)
            knots, _ = better(scene, p, v, knots, jax.random.fold_in(key, i))
            after = knots[0] + (v - knots[0]) * jnp.exp(-0.2 / 0.3)
            p = p + 0.1 * (v + after)
            return (p, after, knots), p

        begin = (jnp.asarray(START), jnp.zeros(3), jnp.zeros((KNOTS, 3)))
        return jax.lax.scan(one, begin, jnp.arange(250))[1]

    def by(occupied, ball_m=(0.0, 0.0, FOREVER), ball_mps=(0.0, 0.0, 0.0)):
        told = (jnp.asarray(occupied), jnp.asarray(ball_m), jnp.asarray(ball_mps))
        return np.asarray(flown(*told, jax.random.key(0)))

    return by


def arrival_s(way):
    there = np.linalg.norm(way - GOAL, axis=1) < 0.3
    return 0.2 * (np.argmax(there) + 1) if there.any() else np.inf


def test_in_open_water_it_arrives_nearly_as_soon_as_its_speed_allows_and_stays(fly):
    way = fly(np.zeros((8, 8, 4), bool))
    least = (np.linalg.norm(GOAL - START) - 0.3) / LIMIT
    assert least < arrival_s(way) < 1.2 * least + 1.0
    # The goal lies between nodes.
    assert np.max(np.linalg.norm(way[150:] - GOAL, axis=1)) < 0.2


def test_it_goes_round_a_wall_that_blocks_the_straight_line(fly):
    rock = np.zeros((8, 8, 4), bool)
    rock[3, :5] = True
    way = fly(rock)
    assert np.isfinite(arrival_s(way))
    low, high = np.array([-1.5, -6.0, -7.0]), np.array([0.0, 1.5, -1.0])
    off = np.maximum(np.maximum(low - way, way - high), 0.0)
    assert np.min(np.linalg.norm(off, axis=1)) > RADIUS
    assert np.max(way[:, 1]) > 1.5
    np.testing.assert_array_equal(way, fly(rock))


def test_a_ball_that_crosses_its_way_is_let_pass(fly):
    """On its straight line when it would be: 8 s from the start both are at the middle."""
    drift = np.array([0.0, 0.3, 0.0])
    ball = np.array([0.0, -3.0, -4.0]) - 8.0 * drift
    way = fly(np.zeros((8, 8, 4), bool), ball, drift)
    t = 0.2 * (np.arange(len(way)) + 1)
    apart = np.linalg.norm(way - (ball + drift * t[:, None]), axis=1)
    assert apart.min() > 2 * RADIUS
    assert apart.min() < 2.0
    assert arrival_s(way) < 25.0
    straight = fly(np.zeros((8, 8, 4), bool))
    assert np.linalg.norm(straight - (ball + drift * t[:, None]), axis=1).min() < 2 * RADIUS


def test_knots_are_shifted_along_the_lines_between_them_and_held_after_the_last():
    knots = np.random.default_rng(5).normal(size=(4, 3))
    time = np.linspace(0.0, 3.0, 4)
    for by in (0.0, 0.4, 1.7, 5.0):
        expected = np.stack([np.interp(time + by, time, knots[:, i]) for i in range(3)], axis=1)
        np.testing.assert_allclose(shift_knots(jnp.asarray(knots), by, 3.0), expected, atol=1e-5)
