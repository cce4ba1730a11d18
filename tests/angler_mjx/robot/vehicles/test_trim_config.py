"""Tanks and moving masses of vehicle files: what is refused, and what padding leaves."""

import copy

import numpy as np
import pytest
from pydantic import ValidationError

from angler_mjx.robot.vehicles import glide, library, params
from angler_mjx.robot.vehicles.config import VehicleConfig

INERTIA = ("parameter_sets", "zhang2013", "rigid_body", "inertia_kgm2")
GLIDER = library.load_vehicle("seawing").model_dump(mode="json")


def changed(path, value):
    """The glider's file with another value at a path of keys."""
    data = copy.deepcopy(GLIDER)
    inner = data
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    return data


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("parameter_sets", "zhang2013", "rigid_body", "mass_kg"), 20.0, r"22 kg move of 20 kg"),
        (INERTIA, [0.3, 0.3, 0.3], "no inertia about some axis"),
        (("ballast", "layout", 0, "limit_m3"), 0.1, "no inertia about some axis"),
        (("moving_masses", "layout", 0, "axis"), [1.0, 1.0, 0.0], "unit"),
        (("moving_masses", "layout", 0, "name"), "tank", "tank"),
        (("ballast", "layout", 0, "rate_m3ps"), 0.0, "greater than 0"),
        (("ballast", "layout", 0, "power_w"), -1.0, "greater than or equal to 0"),
        (("planar",), True, "ballast or moving masses"),
        (
            ("rotor",),
            library.load_vehicle("remus100").rotor.model_dump(mode="json"),
            "no thrusters",
        ),
    ],
)
def test_impossible_tanks_and_masses_are_refused(path, value, words):
    with pytest.raises(ValidationError, match=words):
        VehicleConfig.model_validate(changed(path, value))


def test_a_vehicle_has_some_actuator_and_thrusters_a_rotor():
    still = {**GLIDER, "ballast": None, "moving_masses": None}
    with pytest.raises(ValidationError, match="no other actuator"):
        VehicleConfig.model_validate(still)
    torpedo = library.load_vehicle("remus100").model_dump(mode="json")
    with pytest.raises(ValidationError, match=r"need the table \[rotor\]"):
        VehicleConfig.model_validate({**torpedo, "rotor": None})


def test_rows_of_a_fleet_are_those_of_its_largest_vehicle():
    made = [
        params.build_vehicle(library.load_vehicle(name), None, 16.0)
        for name in ("seawing", "remus100", "bluerov2_heavy")
    ]
    fleet = params.stack_vehicles(made)
    is_trim, is_fin = np.asarray(fleet.trim.is_trim), np.asarray(fleet.fins.is_fin)
    np.testing.assert_array_equal(np.flatnonzero(is_trim[0]), [0, 1, 2])
    np.testing.assert_array_equal(np.flatnonzero(is_fin[1]), [1, 2])
    assert not is_trim[1:].any()
    assert not is_fin[[0, 2]].any()
    assert not np.asarray(fleet.B)[0].any()
    assert not np.asarray(fleet.thruster_exists)[0].any()
    np.testing.assert_array_equal(np.asarray(fleet.trim.mass_kg)[0, :4], [0.0, 11.0, 11.0, 0.0])
    # Vehicles without have no such part.
    assert made[1].trim is None


def test_a_glider_without_way_for_its_glide_is_none():
    data = changed(("moving_masses", "layout", 0, "limit_m"), 0.001)
    config = VehicleConfig.model_validate(data)
    assert glide.best_glide(config, config.find_set(None)) is None
    down, up = glide.best_glide(*(lambda c: (c, c.find_set(None)))(library.load_vehicle("seawing")))
    assert down.vertical_mps < 0 < up.vertical_mps
    assert min(down.horizontal_mps, up.horizontal_mps) > 0.4
