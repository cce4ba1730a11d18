"""Starts and goals: clear of rock, of each other and of obstacles, and where they should be."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from angler_kernels.bit_grid import pack_grid, unpack_grid
from angler_mjx.errors import ConfigError
from angler_mjx.files import parse_model
from angler_mjx.world.config import WorldConfig, resolve_world
from angler_mjx.world.generate import check_fleet
from angler_mjx.world.placement import choose_positions, passable_cells

from ..compiling import quickly

SHAPE, CELL, N_WORLD = (12, 14, 10), 1.5, 24
# One robot is wider than a cell: cells beside rock are closed to it.
RADIUS = np.array([0.4, 0.3, 0.9, 0.4, 0.4])
CLEARANCE = 0.3
ROUNDING = 1e-5  # float32 at 20 m


@pytest.fixture(scope="module")
def occupied():
    """Sparse enough to leave one cavern by itself."""
    rng = np.random.default_rng(4)
    worlds = rng.random((N_WORLD, *SHAPE)) < 0.05
    assert all(ndimage.label(~world)[1] == 1 for world in worlds)
    return worlds


def crowded():
    """A cavern of three cells a side: no room for five robots that keep apart."""
    rock = np.ones(SHAPE, bool)
    rock[3:6, 3:6, 3:6] = False
    return rock[None]


@pytest.fixture(scope="module")
def fleet(occupied):
    return cache(partial(placed, occupied))


def placed(occupied, placement):
    recipe = resolve_world(WorldConfig(shape=SHAPE, fill=0.05, placement=placement))
    far = jnp.full(SHAPE, jnp.inf)

    def place_all(occupied, keys):
        free = pack_grid(~occupied)
        radius = jnp.broadcast_to(jnp.array(RADIUS)[:, None], (len(RADIUS), N_WORLD + 1))
        passable = passable_cells(free, far, CELL, radius.max(axis=0))
        return choose_positions(recipe, recipe.clearance_m, free, passable, far, radius, keys)

    keys = jax.random.split(jax.random.key(1), N_WORLD + 1)
    worlds = np.concatenate([occupied, crowded()])
    start, goal, fits = quickly(place_all)(np.moveaxis(worlds, 0, -1), keys)
    np.testing.assert_array_equal(fits, [True] * N_WORLD + [False])
    return recipe, *(np.moveaxis(np.asarray(p)[..., :-1], -1, 0) for p in (start, goal))


def gap_to_rock(recipe, occupied, points):
    """Distance of points to all occupied cells of one world."""
    low = np.array(recipe.origin_m) + CELL * np.argwhere(occupied)
    outside = np.maximum(low - points[:, None], points[:, None] - (low + CELL))
    return np.linalg.norm(np.maximum(outside, 0), axis=-1).min(axis=1)


@pytest.mark.parametrize("placement", ["cross", "parallel", "random"])
def test_places_are_clear_and_far_apart(occupied, fleet, placement):
    recipe, start, goal = fleet(placement)
    apart = RADIUS[:, None] + RADIUS + CLEARANCE
    for places in (start, goal):
        for world in range(N_WORLD):
            gap = gap_to_rock(recipe, occupied[world], places[world])
            assert np.all(gap >= RADIUS - ROUNDING)
            between = np.linalg.norm(places[world][:, None] - places[world], axis=-1)
            others = ~np.eye(len(RADIUS), dtype=bool)
            assert np.all(between[others] >= apart[others] - ROUNDING)
    way = np.linalg.norm(goal - start, axis=-1)
    assert np.all(way >= 0.5 * max(recipe.size_m) - ROUNDING)
    side = np.array(recipe.size_m)
    if placement == "cross":
        corner = side / 2 - np.abs(start - (np.array(recipe.origin_m) + side / 2))
        # Near the corner: jitter of 3 cells and a few cells of rock.
        assert np.all(np.linalg.norm(corner, axis=-1) < 6 * CELL)
        # Four robots start in four corners and go to the other four.
        octant = np.sign(
            np.concatenate([start[:, :4], goal[:, :4]], axis=1)
            - (np.array(recipe.origin_m) + side / 2)
        )
        assert all(len({tuple(o) for o in world}) == 8 for world in octant)
    if placement == "parallel":
        assert np.all(start[..., 0] < -side[0] / 4)
        assert np.all(goal[..., 0] > side[0] / 4)


def test_worlds_differ_in_where_robots_start(fleet):
    _, start, _ = fleet("cross")
    assert len({tuple(np.sign(world[0])) for world in start}) > 2


def test_cells_are_passable_where_a_sphere_about_their_centre_is_clear():
    rng = np.random.default_rng(0)
    solid, edge = rng.random((6, 5, 7)) < 0.1, 2.0
    ground = rng.uniform(0.0, 6.0, solid.shape)
    # Below, between and above the distances 1, sqrt(2), sqrt(3) and 3 m to cells around.
    radius = np.array([0.3, 0.9, 1.1, 1.3, 1.5, 1.7, 1.8, 2.9])
    free = np.broadcast_to(~solid[..., None], (*solid.shape, len(radius)))

    @quickly
    def passable(free, ground, radius):
        return unpack_grid(passable_cells(pack_grid(free), ground, edge, radius), 7)

    found = np.asarray(passable(free, ground, radius))
    around = np.argwhere(np.pad(solid, 2, constant_values=True)) - 2.0
    for index in np.ndindex(solid.shape):
        outside = np.maximum(np.abs(around - index) - 0.5, 0)
        clear = min(edge * np.linalg.norm(outside, axis=1).min(), ground[index])
        np.testing.assert_array_equal(found[index], clear >= radius)


def given(**changes):
    data = {
        "preset": "open",
        "placement": "given",
        "start_m": [[-8.0, 0.0, -10.0], [-8.0, 5.0, -10.0]],
        "goal_m": [[8.0, 0.0, -10.0], [8.0, 5.0, -10.0]],
        "obstacles": {
            "explicit": [
                {"type": "sphere", "radius_m": 1.0, "position_m": [0.0, 0.0, -10.0]},
                {
                    "type": "box",
                    "size_m": [1.0, 1.0, 1.0],
                    "position_m": [8.0, 5.0, -10.0],
                    "motion": {"type": "drift"},
                },
            ]
        },
    }
    return resolve_world(parse_model(WorldConfig, {**data, **changes}, source="test"))


def test_given_places_may_lie_where_a_drifting_obstacle_starts_only_for_goals():
    check_fleet(given(), np.array([0.4, 0.4]))


@pytest.mark.parametrize(
    ("changes", "radius", "words"),
    [
        ({"start_m": [[0.5, 0.5, -10.0], [-8, 5, -10]]}, [0.4, 0.4], ("start_m[0]", "explicit[0]")),
        ({"start_m": [[-8, 0, -10.0], [8, 5, -9.2]]}, [0.4, 0.4], ("start_m[1]", "explicit[1]")),
        ({"goal_m": [[8.0, 0, -1.0], [8, 5, -10]]}, [0.4, 0.4], ("goal_m[0]", "outside")),
        ({}, [0.4], ("2 places", "1 robots")),
        ({}, [0.4, 3.0], ("radius 3",)),
        ({}, [0.4, 0.0], ("radius",)),
    ],
)
def test_fleets_that_cannot_stand_are_refused(changes, radius, words):
    with pytest.raises(ConfigError) as caught:
        check_fleet(given(**changes), np.array(radius))
    for word in words:
        assert word in str(caught.value)
