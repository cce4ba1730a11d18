"""The fields that a robot flies by, against distances worked out by other means."""

import heapq
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.planning.mppi import distance_field
from angler_mjx.world.rock.grid import Grid

CELL, ORIGIN, SHAPE = 1.5, np.array([-6.0, -6.0, -7.0]), (8, 8, 4)
FLOOR = -6.8
GOAL = np.array([4.6, 4.4, -4.0])
RADIUS = 0.4


@pytest.fixture(scope="module")
def rock():
    """A wall across the cube, with a door of one cell at one side of it, and some rock."""
    occupied = np.zeros(SHAPE, bool)
    occupied[4] = True
    occupied[4, 1, 1] = False
    occupied[1, 5, 2] = True
    return occupied


@pytest.fixture(scope="module")
def fields(rock):
    grid = Grid(occupied=jnp.asarray(rock), origin_m=jnp.asarray(ORIGIN), cell_m=jnp.asarray(CELL))

    @jax.jit
    def both(goal):
        gap = distance_field.obstacle_distance(grid, jnp.asarray(FLOOR))
        left = distance_field.path_length_to_goal(
            gap >= RADIUS, goal, grid.origin_m, 0.5 * grid.cell_m
        )
        return gap, left

    return [np.asarray(x) for x in both(jnp.asarray(GOAL))]


def places():
    axes = [ORIGIN[i] + 0.5 * CELL * np.arange(2 * n + 1) for i, n in enumerate(SHAPE)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def test_the_gap_is_the_distance_to_the_nearest_box_face_or_floor(rock, fields):
    gap, node = fields[0], places()
    low = ORIGIN + CELL * np.argwhere(rock)
    off = np.maximum(np.maximum(low - node[..., None, :], node[..., None, :] - low - CELL), 0.0)
    to_rock = np.min(np.linalg.norm(off, axis=-1), axis=-1)
    upper = ORIGIN + CELL * np.array(SHAPE)
    to_face = np.min(np.minimum(node - ORIGIN, upper - node), axis=-1)
    expected = np.minimum(np.minimum(to_rock, to_face), node[..., 2] - FLOOR)
    outside = (to_rock > 0.0) & (expected > 0.0)
    assert np.count_nonzero(outside) > 500
    np.testing.assert_allclose(gap[outside], expected[outside], atol=1e-5)
    # The middle of a rock cell that stands alone is half a cell inside.
    assert gap[3, 11, 5] == pytest.approx(-0.5 * CELL, abs=1e-5)


def test_the_way_left_goes_through_the_door(fields):
    """Between the straight line, or that by the door, and the shortest way along 26 neighbours."""
    gap, left = fields
    free, node = gap >= RADIUS, places()
    by_steps = shortest(free, node)
    behind = free & np.isfinite(by_steps) & (node[..., 0] < 0.0)
    door = ORIGIN + CELL * np.array([4.5, 1.5, 1.5])
    # Nothing that has the robot's radius passes the door elsewhere than within this of its middle.
    slack = CELL
    through = np.linalg.norm(node - door, axis=-1) + np.linalg.norm(GOAL - door) - 2.0 * slack
    assert np.count_nonzero(behind) > 50
    assert np.all(left[behind] > through[behind])
    # Both are of first order: from above by the directions of steps, and by the upwind scheme.
    assert np.all(left[behind] < 1.15 * by_steps[behind] + 0.5 * CELL)
    corner = tuple(np.argwhere(behind)[0])
    assert left[corner] > 1.2 * np.linalg.norm(node[corner] - GOAL)


def shortest(free, node):
    """Dijkstra from the nodes near the goal."""
    found = np.full(free.shape, math.inf)
    heap = []
    for index in map(tuple, np.argwhere(free)):
        away = float(np.linalg.norm(node[index] - GOAL))
        if away < CELL:
            found[index] = away
            heapq.heappush(heap, (away, index))
    steps = [s for s in itertools.product((-1, 0, 1), repeat=3) if any(s)]
    while heap:
        way, at = heapq.heappop(heap)
        if way > found[at]:
            continue
        for step in steps:
            to = tuple(i + s for i, s in zip(at, step, strict=True))
            if any(not 0 <= i < n for i, n in zip(to, free.shape, strict=True)) or not free[to]:
                continue
            longer = way + 0.5 * CELL * math.sqrt(sum(s * s for s in step))
            if longer < found[to] - 1e-12:
                found[to] = longer
                heapq.heappush(heap, (longer, to))
    return found


def test_what_is_linear_is_read_exactly():
    node = places()
    slope, other = np.array([0.3, -1.2, 2.0]), np.array([1.0, 0.5, -0.25])
    values = np.stack([node @ slope, node @ other], axis=-1)
    read = distance_field.DistanceField(
        values=jnp.asarray(values), origin_m=jnp.asarray(ORIGIN), spacing_m=jnp.asarray(CELL / 2)
    )
    upper = ORIGIN + CELL * np.array(SHAPE)
    p = np.random.default_rng(1).uniform(ORIGIN, upper, (50, 3))
    one, two = distance_field.interpolate(read, tuple(jnp.asarray(p[:, i]) for i in range(3)))
    np.testing.assert_allclose(one, p @ slope, atol=1e-4)
    np.testing.assert_allclose(two, p @ other, atol=1e-4)
