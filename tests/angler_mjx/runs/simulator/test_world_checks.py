"""Worlds that no program was made for are refused."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.runs.simulator.world_preparation import check_worlds
from angler_mjx.sim import fleet


@pytest.fixture(scope="module")
def scene(scenes):
    """Two worlds of six robots, of all vehicles and sets, with obstacles."""
    build, _, obstacles = scenes
    return build(2, config=obstacles["all"])


def edited(worlds, path, change):
    """The worlds with one leaf changed."""
    name, _, rest = path.partition(".")
    value = getattr(worlds, name)
    return replace(worlds, **{name: edited(value, rest, change) if rest else change(value)})


@pytest.mark.parametrize("number", [-1, 4, 99])
def test_a_variant_that_its_robot_cannot_be_is_refused(scene, number):
    # Robot 0 draws one of the sets of the Heavy; 3 and 4 are those of the other vehicle.
    possible = np.isfinite(np.asarray(scene.fleet.log_weight))[0]
    assert not 0 <= number < possible.size or not possible[number]
    worlds = edited(scene.worlds, "variant", lambda leaf: leaf.at[1, 0].set(number))
    with pytest.raises(ConfigError, match=rf"world 1, robot 0 is {number}: this robot can be 0"):
        check_worlds(scene.fleet, worlds)


@pytest.mark.parametrize("robots", [1, 5, 7])
def test_variants_of_another_number_of_robots_are_refused(scene, robots):
    wrong = jnp.resize(scene.worlds.variant, (2, robots))
    worlds = replace(scene.worlds, variant=wrong)
    with pytest.raises(
        ConfigError, match=rf"World\.variant has the shape \(2, {robots}\): .* 6 robots"
    ):
        check_worlds(scene.fleet, worlds)


@pytest.mark.parametrize("name", ["kind", "motion"])
def test_an_obstacle_that_programs_are_not_made_for_is_refused(scene, name):
    worlds = edited(
        scene.worlds, f"environment.obstacles.{name}", lambda leaf: leaf.at[0, 2].set(17)
    )
    message = rf"obstacles\.{name} of world 0, obstacle 2 is 17"
    exists = np.asarray(scene.worlds.environment.obstacles.exists)
    assert exists[0, 2]
    with pytest.raises(ConfigError, match=message):
        check_worlds(scene.fleet, worlds)
    gone = edited(worlds, "environment.obstacles.exists", lambda leaf: leaf.at[0, 2].set(False))
    check_worlds(scene.fleet, gone)


def test_traced_worlds_and_arrays_of_numpy_are_taken(scene):
    jax.eval_shape(lambda worlds: check_worlds(scene.fleet, worlds), scene.worlds)
    host = jax.tree.map(np.array, scene.worlds)
    check_worlds(scene.fleet, host)
    host.variant[1, 0] = 99
    with pytest.raises(ConfigError, match="world 1, robot 0 is 99"):
        check_worlds(scene.fleet, host)


def test_a_fleet_of_one_variant_has_nothing_to_replace(scenes):
    _, one_robot, _ = scenes
    member = one_robot("bluerov2")[0]
    alone = replace(member, variants=member.variants[:1], weights=(1.0,))
    made = fleet.build_fleet([alone, alone])
    assert made.body.fields == {}
    assert jnp.all(made.engine.model.body_mass[1] == made.control.vehicle.mass_kg[0])
