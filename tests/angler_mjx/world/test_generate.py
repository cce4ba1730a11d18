"""Whole worlds: complete, the same in any batch, drawn again where they cannot hold the fleet."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from angler_mjx.errors import ConfigError
from angler_mjx.files import parse_model
from angler_mjx.world import sampling
from angler_mjx.world.config import WorldConfig, resolve_world
from angler_mjx.world.generate import generate_batch, require_valid

from ..lattice import least_costs
from .recipe import COUNT, MIN_OBSTACLES, RADIUS, RECIPE, SEED, SHAPE


def config(**data):
    return parse_model(WorldConfig, data, source="test")


def test_worlds_are_complete(worlds):
    assert worlds.grid.occupied.shape == (COUNT, *SHAPE)
    np.testing.assert_allclose(worlds.density, worlds.grid.occupied.mean(axis=(1, 2, 3)), rtol=1e-6)
    assert [type(part).__name__ for part in worlds.current] == [
        "GaussMarkov",
        "GaussMarkov",
        "Vortices",
    ]
    to_goal = worlds.goal_m - worlds.start_m
    heading = np.stack([np.cos(worlds.start_yaw_rad), np.sin(worlds.start_yaw_rad)], axis=-1)
    # float32 rounding of an angle and of a length of 20 m.
    np.testing.assert_allclose(
        np.sum(heading * to_goal[..., :2], axis=-1),
        np.linalg.norm(to_goal[..., :2], axis=-1),
        rtol=1e-5,
    )


def test_drifting_obstacles_keep_clear_of_starts_and_goals(worlds):
    drawn = slice(1, None)  # the first row is the explicit box
    assert worlds.obstacles.exists[:, drawn].any()
    centre = worlds.obstacles.p0[:, drawn]
    radius = np.where(
        worlds.obstacles.kind[:, drawn] == 0,
        worlds.obstacles.size_m[:, drawn, 0],
        np.linalg.norm(worlds.obstacles.size_m[:, drawn], axis=-1),
    )
    for places in (worlds.start_m, worlds.goal_m):
        gap = np.linalg.norm(centre[:, :, None] - places[:, None], axis=-1) - radius[..., None]
        # 0.3 m is the default clearance; float32 at 10 m.
        there = np.broadcast_to(worlds.obstacles.exists[:, drawn, None], gap.shape)
        assert np.all(gap[there] >= np.broadcast_to(RADIUS + 0.3, gap.shape)[there] - 1e-5)


def test_difficulty_is_that_of_an_independent_search(worlds):
    origin, cell = worlds.grid.origin_m[0], worlds.grid.cell_m[0]
    index = np.stack(np.meshgrid(*map(np.arange, SHAPE), indexing="ij"), axis=-1)
    centre = origin + cell * (index + 0.5)
    outside = np.maximum(np.abs(centre - [0, 0, -8]) - [1, 1, 4], 0)
    beside_box = np.linalg.norm(outside, axis=-1) < RADIUS.max()
    for world in range(4):
        passable = ~worlds.grid.occupied[world] & ~beside_box
        for robot in range(len(RADIUS)):
            cells = [
                tuple(np.floor((place[world, robot] - origin) / cell).astype(int))
                for place in (worlds.start_m, worlds.goal_m)
            ]
            assert passable[cells[0]]
            straight = np.linalg.norm(np.subtract(*cells))
            expected = max(least_costs(passable, cells[1])[cells[0]] / straight, 1.0)
            # Sums of some 20 float32 terms.
            assert worlds.path_ratio[world, robot] == pytest.approx(expected, rel=3e-6)


def test_a_world_is_the_same_wherever_its_batch_begins(worlds):
    later = generate_batch(RECIPE, RADIUS, SEED, 5, COUNT)
    for here, there in zip(jax.tree.leaves(worlds), jax.tree.leaves(later), strict=True):
        np.testing.assert_array_equal(here[5:], np.asarray(there)[: COUNT - 5])


@pytest.mark.nightly(by="test_worlds_are_complete")
def test_a_grid_of_64_cells_a_side_is_one_cavern_with_open_ways():
    big = config(preset="reef", shape=[64, 64, 64], fill=0.2)
    worlds = jax.tree.map(np.asarray, generate_batch(big, np.full(2, 0.4), 3, 0, 2))
    assert worlds.valid.all()
    for world in range(2):
        occupied = worlds.grid.occupied[world]
        assert 0.02 < occupied.mean() < 0.3
        assert ndimage.label(~occupied)[1] == 1
        cells = np.floor((worlds.start_m[world] - worlds.grid.origin_m[world]) / 1.5).astype(int)
        assert not occupied[tuple(cells.T)].any()
    # A way among the 26 neighbours is at most 1.13 times the straight line in open water; rocks
    # of a few cells lengthen a way of some 100 cells little.
    assert np.all((worlds.path_ratio >= 1) & (worlds.path_ratio < 1.3))


def test_another_seed_gives_other_worlds(worlds):
    other = generate_batch(RECIPE, RADIUS, SEED + 1, 0, COUNT)
    assert (np.asarray(other.grid.occupied) != worlds.grid.occupied).any(axis=(1, 2, 3)).all()


def test_worlds_that_cannot_hold_the_fleet_are_drawn_again_up_to_the_limit(worlds):
    count = worlds.grid.occupied.sum(axis=(1, 2, 3))
    assert 0 < worlds.valid.sum() < COUNT
    assert set(worlds.redraws) == {0, 1, 2}
    np.testing.assert_array_equal(worlds.valid, count >= MIN_OBSTACLES)
    assert np.all(worlds.redraws[~worlds.valid] == 2)


@pytest.mark.nightly(by="world/test_draws.py")
def test_a_batch_of_batches_is_the_same_too():
    walls = config(preset="corridor", shape=[5, 4, 4], rule={"type": "walls", "count": 1})
    recipe = resolve_world(walls)
    one = partial(sampling.sample_world, recipe, recipe.numbers(0.0), jnp.array([0.4]))
    keys = jax.random.split(jax.random.key(1), 12)
    flat = jax.jit(jax.vmap(one))(keys)
    square = jax.jit(jax.vmap(jax.vmap(one)))(keys.reshape(3, 4))
    assert flat.occupied.any()
    for here, there in zip(*map(jax.tree.leaves, (flat, square)), strict=True):
        np.testing.assert_array_equal(here, np.reshape(there, here.shape))


def test_a_fleet_too_large_for_the_world_is_refused():
    batch = generate_batch(RECIPE, np.full(3, 2.2), SEED, 0, COUNT)
    assert not np.asarray(batch.valid).any()
    with pytest.raises(ConfigError, match="fleet of 3 robots"):
        require_valid(batch)


@pytest.mark.parametrize("seed", [-1, 2**32])
def test_seeds_outside_32_bits_are_refused(seed):
    with pytest.raises(ConfigError, match="seed"):
        generate_batch(RECIPE, RADIUS, seed, 0, 1)
