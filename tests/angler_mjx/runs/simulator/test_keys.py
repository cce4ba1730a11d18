"""The keys of a run: every world, part and robot has its own, and nobody draws from a shared one.

What a world is made of is replaced by parts that give back the key they were given.
"""

import itertools
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.planning.planner import PathShape
from angler_mjx.runs.simulator import world_preparation
from angler_mjx.runs.simulator.sampling_numbers import sampling_numbers
from angler_mjx.scenario.scenario import load_scenario

SCENARIO = """
schema_version = 1
name = "keys"
worlds = 8

[world]
preset = "open"

[[fleet]]
vehicle = "bluerov2_heavy"
count = {count}
estimate = "ekf"
"""
TILE = 3


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Hull:
    radius_m: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Sea:
    key: jax.Array
    start_m: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Control:
    vehicle: Hull
    cruise_speed_mps: jax.Array


@pytest.fixture
def keys(tmp_path, monkeypatch):
    """A function (seed, first world, robots) -> keys of fleet, environment and instruments."""

    def run(seed, first, count=3):
        file = tmp_path / "keys.toml"
        file.write_text(SCENARIO.format(count=count))

        def sample(fleet, key):
            each = jnp.ones(count)
            control = Control(Hull(each), jax.random.key_data(key))
            return jnp.zeros(count, jnp.int32), control

        def generate(recipe, numbers, radius, key, *rest):
            return Sea(jax.random.key_data(key), jnp.zeros((count, 3)))

        monkeypatch.setattr(world_preparation.fleet, "sample_variants", sample)
        monkeypatch.setattr(world_preparation.fleet, "radius_bound", lambda _: jnp.ones(count))
        monkeypatch.setattr(world_preparation.generate, "generate_world", generate)
        scenario = load_scenario(file)
        make = world_preparation.build_preparer(scenario, None, TILE, shape=PathShape(points=32))
        numbers = sampling_numbers(scenario)
        worlds = make(None, numbers, jnp.uint32(seed), jnp.array([first], jnp.uint32))
        return tuple(
            map(np.asarray, (worlds.cruise_speed_mps, worlds.environment.key, worlds.sensing_key))
        )

    return run


def rows(found):
    """All keys as tuples."""
    return [tuple(map(int, key)) for part in found for key in part.reshape(-1, 2)]


def test_no_two_draws_share_a_key(keys):
    seen = [
        key
        for seed, first in itertools.product((0, 1, 2), (0, 3))
        for key in rows(keys(seed, first))
    ]
    assert len(seen) == 3 * 2 * TILE * (1 + 1 + 3)
    # What other keys are made of is drawn from by nobody.
    root = [jax.random.key(seed) for seed in (0, 1, 2)]
    worlds = [jax.random.fold_in(key, index) for key in root for index in range(2 * TILE)]
    instruments = [jax.random.fold_in(key, 2) for key in worlds]
    parents = [tuple(map(int, jax.random.key_data(key))) for key in [*root, *worlds, *instruments]]
    assert len(set(seen) | set(parents)) == len(seen) + len(parents)


def test_a_robot_more_changes_no_key(keys):
    few, many = keys(5, 0, count=2), keys(5, 0, count=4)
    for part in range(2):
        np.testing.assert_array_equal(few[part], many[part])
    np.testing.assert_array_equal(few[2], many[2][:, :2])


def test_a_world_has_the_same_keys_wherever_its_tile_begins(keys):
    early, late = keys(5, 0), keys(5, 2)
    for a, b in zip(early, late, strict=True):
        np.testing.assert_array_equal(a[2], b[0])
