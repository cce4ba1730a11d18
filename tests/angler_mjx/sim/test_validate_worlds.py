"""Worlds that were edited: what every engine sees, what is refused, and what costs nothing."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels.clearance import cell_neighbours
from angler_mjx.errors import ConfigError, UnsupportedError
from angler_mjx.sim import fleet
from angler_mjx.sim.engines.base import by_name
from angler_mjx.sim.physics.mjx_engine import BodyInertia
from angler_mjx.sim.validate_worlds import WorldValidator


@pytest.fixture(scope="module")
def scene(scenes):
    """Two worlds of six robots, of all vehicles and sets, with obstacles."""
    build, _, obstacles = scenes
    return build(2, config=obstacles["all"])


@pytest.fixture
def packing():
    """How a gate packs cells, and for which shapes it did."""
    seen = []

    def pack(cells):
        seen.append(cells.shape)
        return jax.vmap(cell_neighbours)(cells)

    return pack, seen


@pytest.fixture
def gate(scene, packing):
    """As for the fused engine."""
    return WorldValidator(
        scene.fleet, take=partial(fleet.select_parameters, scene.fleet), pack=packing[0]
    )


def edited(worlds, path, change):
    """The worlds with one leaf changed."""
    name, _, rest = path.partition(".")
    if isinstance(worlds, dict):
        return {
            **worlds,
            name: edited(worlds[name], rest, change) if rest else change(worlds[name]),
        }
    value = getattr(worlds, name)
    return replace(worlds, **{name: edited(value, rest, change) if rest else change(value)})


@pytest.mark.parametrize(
    "path",
    [
        "control.vehicle.mass_kg",
        "control.vehicle.inertia_kgm2",
        "control.vehicle.D_q",
        "control.vehicle.thrust_n",
        "control.vehicle.thruster_exists",
        "control.allocation.B_inverse",
        "body.fields.body_mass",
        "body.fields.body_inertia",
    ],
)
def test_parameters_edited_in_a_world_are_refused_by_name(gate, scene, path):
    def change(leaf):
        flat = leaf[1, 4].ravel()
        other = ~flat[-1] if leaf.dtype == bool else flat[-1] * 1.5 + 1.0
        return leaf.at[1, 4].set(flat.at[-1].set(other).reshape(leaf.shape[2:]))

    name = path.rpartition(".")[2]
    with pytest.raises(ConfigError, match=rf"World\..*{name}.* of world 1, robot 4 is .*adopt"):
        gate.validate_worlds(edited(scene.worlds, path, change))


def test_what_is_each_worlds_own_is_taken_as_it_is(gate, scene):
    for path in ("control.cruise_speed_mps", "environment.goal_m", "path.time_s"):
        assert gate.validate_worlds(edited(scene.worlds, path, lambda leaf: leaf + 0.1)) is not None


@pytest.mark.parametrize("number", [-1, 4, 99])
def test_a_variant_that_its_robot_cannot_be_is_refused(gate, scene, number):
    # Robot 0 draws one of the sets of the Heavy; 3 and 4 are those of the other vehicle.
    possible = np.isfinite(np.asarray(scene.fleet.log_weight))[0]
    assert not 0 <= number < possible.size or not possible[number]
    worlds = edited(scene.worlds, "variant", lambda leaf: leaf.at[1, 0].set(number))
    for enter in (gate.validate_worlds, gate.adopt):
        with pytest.raises(
            ConfigError, match=rf"world 1, robot 0 is {number}: this robot can be 0"
        ):
            enter(worlds)


@pytest.mark.parametrize("robots", [1, 5, 7])
def test_variants_of_another_number_of_robots_are_refused(gate, scene, robots):
    wrong = jnp.resize(scene.worlds.variant, (2, robots))
    worlds = replace(scene.worlds, variant=wrong)
    for enter in (gate.validate_worlds, gate.adopt):
        with pytest.raises(
            ConfigError, match=rf"World\.variant has the shape \(2, {robots}\): .* 6 robots"
        ):
            enter(worlds)


def test_another_variant_brings_its_parameters_by_adoption(gate, scene):
    other = (scene.worlds.variant[:, 0] + 1) % 3
    worlds = edited(scene.worlds, "variant", lambda leaf: leaf.at[:, 0].set(other))
    with pytest.raises(ConfigError, match="of world 0, robot 0 is"):
        gate.validate_worlds(worlds)
    adopted = gate.adopt(worlds)
    assert gate.validate_worlds(adopted).control is adopted.control
    mass = np.asarray(scene.fleet.control.vehicle.mass_kg)
    np.testing.assert_array_equal(adopted.control.vehicle.mass_kg, mass[np.asarray(worlds.variant)])
    assert adopted.control.cruise_speed_mps is worlds.control.cruise_speed_mps


@pytest.mark.parametrize("name", ["kind", "motion"])
def test_an_obstacle_that_programs_are_not_made_for_is_refused(gate, scene, name):
    worlds = edited(
        scene.worlds, f"environment.obstacles.{name}", lambda leaf: leaf.at[0, 2].set(17)
    )
    message = rf"obstacles\.{name} of world 0, obstacle 2 is 17"
    exists = np.asarray(scene.worlds.environment.obstacles.exists)
    assert exists[0, 2]
    with pytest.raises(ConfigError, match=message):
        gate.validate_worlds(worlds)
    gone = edited(worlds, "environment.obstacles.exists", lambda leaf: leaf.at[0, 2].set(False))
    assert gate.validate_worlds(gone) is not None


def test_edited_cells_are_packed_anew_and_never_twice(gate, scene, packing):
    cells = scene.worlds.environment.grid.occupied
    own = gate.accept_sampled(
        replace(scene.worlds, cell_neighbours=jax.vmap(cell_neighbours)(cells))
    )
    assert gate.validate_worlds(own) is own
    wall = edited(own, "environment.grid.occupied", lambda leaf: leaf.at[:, 5].set(True))
    packed = gate.validate_worlds(wall).cell_neighbours
    np.testing.assert_array_equal(packed, jax.vmap(cell_neighbours)(wall.environment.grid.occupied))
    assert np.any(packed != own.cell_neighbours)
    # Another path or goal is no other world of rock; nor is one that comes back.
    again = gate.validate_worlds(edited(wall, "environment.goal_m", lambda leaf: leaf + 1.0))
    assert again.cell_neighbours is packed
    assert gate.validate_worlds(own) is own
    assert len(packing[1]) == 1
    # Packed cells that are not of these cells do not get in.
    mixed = gate.validate_worlds(replace(wall, cell_neighbours=own.cell_neighbours + 1))
    np.testing.assert_array_equal(mixed.cell_neighbours, packed)


def test_an_engine_that_looks_at_cells_is_given_no_packed_ones(scene):
    gate = WorldValidator(
        scene.fleet, take=partial(fleet.select_parameters, scene.fleet), pack=None
    )
    cells = scene.worlds.environment.grid.occupied
    packed = replace(scene.worlds, cell_neighbours=jax.vmap(cell_neighbours)(cells))
    assert gate.validate_worlds(packed).cell_neighbours is None


def test_arrays_that_can_be_written_to_are_looked_at_again(gate, scene):
    host = jax.tree.map(np.array, scene.worlds)
    gate.validate_worlds(host)
    host.control.vehicle.mass_kg[0, 1] += 1.0
    with pytest.raises(ConfigError, match=r"World\.control\.vehicle\.mass_kg of world 0, robot 1"):
        gate.validate_worlds(host)


def test_nothing_is_kept_alive_and_traces_pass(gate, scene):
    cells = scene.worlds.environment.grid.occupied
    worlds = edited(scene.worlds, "environment.grid.occupied", lambda leaf: leaf | True)
    gate.validate_worlds(worlds)
    del worlds
    gate.accept_sampled(scene.worlds)
    assert len(gate._validated) == 1
    shapes = jax.eval_shape(gate.validate_worlds, scene.worlds)
    assert shapes.environment.grid.occupied.shape == cells.shape


def test_worlds_of_a_fleet_without_models_are_not_flown_by_mjx(gate, scene):
    bare = replace(scene.worlds, body=BodyInertia(fields={}))
    with pytest.raises(ConfigError, match=r"World\.body.*adopt"):
        gate.validate_worlds(bare)
    with pytest.raises(UnsupportedError, match="multibody fields"):
        by_name("mjx", "xla").reset(scene.spec, scene.fleet, bare)


def test_a_fleet_of_one_variant_has_nothing_to_replace(scenes):
    _, one_robot, _ = scenes
    member = one_robot("bluerov2")[0]
    alone = replace(member, variants=member.variants[:1], weights=(1.0,))
    made = fleet.build_fleet([alone, alone])
    assert made.body.fields == {}
    assert jnp.all(made.engine.model.body_mass[1] == made.control.vehicle.mass_kg[0])
