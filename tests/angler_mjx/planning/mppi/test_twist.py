"""Path integral control by velocities, flown over its own model of the velocity loop."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.planning.mppi import field, twist
from angler_mjx.world.grid import Grid

LIMIT, RADIUS, DT, STEPS, KNOTS, SAMPLES = 0.5, 0.32, 0.1, 30, 8, 128
START, GOAL = np.array([-4.0, -3.0, -4.0]), np.array([4.0, -3.0, -4.0])


@pytest.fixture(scope="module")
def fly():
    """A function of rock: places [n, 3] every 0.2 s, flown to the goal."""
    weights = twist.Weights()

    @jax.jit
    def flown(occupied, key):
        origin = jnp.array([-6.0, -6.0, -7.0])
        grid = Grid(occupied=occupied, origin_m=origin, cell_m=jnp.asarray(1.5))
        h = 0.5 * grid.cell_m
        gap = field.gap(grid, origin[2], None)
        left = field.way_left(gap >= RADIUS + 0.1, jnp.asarray(GOAL), origin, h)
        seen = field.Field(values=jnp.stack([gap, left], -1), origin_m=origin, spacing_m=h)
        nobody = twist.Bodies(centre_m=jnp.zeros((STEPS, 1, 3)), reach_m=jnp.full(1, -1e3))
        better = partial(twist.improve, weights, seen, nobody, samples=SAMPLES, dt_s=DT)

        def one(carry, i):
            p, v, knots = carry
            knots = twist.shifted(knots, 0.2, STEPS * DT)
            of_call = jax.random.fold_in(key, i)
            knots, _ = better(p, v, knots, RADIUS, jnp.asarray(LIMIT), of_call)
            after = knots[0] + (v - knots[0]) * jnp.exp(-0.2 / 0.3)
            p = p + 0.1 * (v + after)
            return (p, after, knots), p

        begin = (jnp.asarray(START), jnp.zeros(3), jnp.zeros((KNOTS, 3)))
        return jax.lax.scan(one, begin, jnp.arange(250))[1]

    return lambda occupied, seed=0: np.asarray(flown(jnp.asarray(occupied), jax.random.key(seed)))


def arrival_s(way):
    there = np.linalg.norm(way - GOAL, axis=1) < 0.3
    return 0.2 * (np.argmax(there) + 1) if there.any() else np.inf


def test_in_open_water_it_arrives_nearly_as_soon_as_its_speed_allows(fly):
    way = fly(np.zeros((8, 8, 4), bool))
    least = (np.linalg.norm(GOAL - START) - 0.3) / LIMIT
    assert least < arrival_s(way) < 1.2 * least + 1.0


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
