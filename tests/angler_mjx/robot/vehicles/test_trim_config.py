"""Tanks and moving masses of vehicle files: what is refused, padding, signals, power, inertia."""

import copy

import jax.numpy as jnp
import numpy as np
import pytest
from pydantic import ValidationError

from angler_mjx.robot.vehicles import glide, library, params, trim
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


@pytest.mark.parametrize(("left_kg", "floats"), [(0.5, True), (-0.5, False)])
def test_a_tank_may_take_all_but_the_last_of_the_mass(left_kg, floats):
    """At its centre of mass a tank changes no inertia; empty, it leaves so much of the mass."""
    center = GLIDER["base"]["center_of_mass_m"]
    data = changed(("ballast", "layout", 0, "position_m"), center)
    data["ballast"]["layout"][0]["limit_m3"] = (65.28 - left_kg) / 1025.0
    # Batteries that hardly move.
    for mass in data["moving_masses"]["layout"]:
        mass["limit_m"] = 1e-4
    if floats:
        VehicleConfig.model_validate(data)
    else:
        with pytest.raises(ValidationError, match="no inertia about some axis"):
            VehicleConfig.model_validate(data)


@pytest.mark.parametrize(("more_kgm2", "holds"), [(0.05, True), (-0.05, False)])
def test_a_mass_may_move_as_far_as_the_inertia_lasts(more_kgm2, holds):
    """20 kg that move from 0.2 m to the centre of mass take their inertia, and shift the centre."""
    center_m = GLIDER["base"]["center_of_mass_m"]
    mass = GLIDER["moving_masses"]["layout"][0] | {
        "mass_kg": 20.0,
        "axis": [0.0, 1.0, 0.0],
        "position_m": [0.0, 0.2, center_m[2]],
        "limit_m": 0.2,
    }
    data = changed(("moving_masses", "layout"), [mass])
    taken = 20.0 * 0.2**2 + (20.0 * 0.2) ** 2 / 65.28
    inertia = data["parameter_sets"]["zhang2013"]["rigid_body"]
    inertia["inertia_kgm2"] = [taken + more_kgm2, 17.0, 17.0]
    if holds:
        VehicleConfig.model_validate(data)
    else:
        with pytest.raises(ValidationError, match="no inertia about some axis"):
            VehicleConfig.model_validate(data)


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


@pytest.fixture(scope="module")
def rows():
    """A tank of 0.5 l, and a battery that moves 50 mm along x and 14 mm along y."""
    return trim.build_trim(library.load_vehicle("seawing"))


def test_signals_settle_at_their_part_of_the_limit_and_back(rows):
    limits = np.array([5e-4, 0.05, 0.014])
    for pwm_us, part in ((900, -1), (1100, -1), (1400, -0.25), (1500, 0), (1700, 0.5), (2000, 1)):
        settled = trim.settled_trim(rows, jnp.full(3, float(pwm_us)))
        np.testing.assert_allclose(settled, limits * part, rtol=1e-6)
        signals = trim.trim_signals(rows, settled)
        np.testing.assert_allclose(signals, min(max(pwm_us, 1100), 1900), rtol=1e-6)
    np.testing.assert_allclose(trim.trim_signals(rows, 3.0 * limits), 1900.0)
    np.testing.assert_allclose(trim.trim_signals(rows, -3.0 * limits), 1100.0)


@pytest.mark.parametrize("orders", [1, 3])
def test_power_is_in_proportion_to_the_speed_up_to_the_fastest(rows, orders):
    def power_w(*away):
        """Power where each is so many times its fastest step away from its command."""
        steps = np.array([1.0 * 4e-5, 0.5 * 0.004, 0.5 * 0.002])
        states = np.array([1e-4, 0.01, -0.003])
        settled = jnp.asarray(states + steps * np.array(away))
        if orders == 3:
            states = np.stack([states, np.full(3, 7.0), np.full(3, -7.0)])
        return float(trim.trim_power_w(rows, jnp.asarray(states), settled))

    assert power_w(0, 0, 0) == 0.0
    assert power_w(0.5, 0, 0) == pytest.approx(20.0, rel=1e-5)
    assert power_w(0, -0.25, 0) == pytest.approx(1.0, rel=1e-4)
    assert power_w(3, -2, 1.5) == pytest.approx(40.0 + 4.0 + 2.0, rel=1e-5)


def test_what_moves_changes_weight_and_inertia_as_points_do(rows):
    values = np.array([2e-4, 0.03, -0.01])
    # Other orders of the states of rotors do not count.
    states = jnp.asarray(np.stack([values, np.full(3, 7.0), np.full(3, -7.0)]))
    made = trim.trim_change(
        rows, states, jnp.array([1.0, 0.0, 0.0, 0.0]), jnp.zeros(6), 1025.0, 9.81
    )
    water_kg = 0.205
    middle = np.array([0.401672, 0.0, -0.014 + 0.00502])
    tank = np.array([0.0, 0.0, 0.00502])
    first = water_kg * tank + 11.0 * np.array([0.03, -0.01, 0.0])
    np.testing.assert_allclose(np.diag(made.M)[:3], water_kg, rtol=1e-5)
    weight = np.array([0.0, 0.0, -9.81 * water_kg])
    moment = np.cross(first, [0.0, 0.0, -9.81])
    np.testing.assert_allclose(made.wrench, [*weight, *moment], rtol=1e-4, atol=1e-5)

    def about_z(points):
        return sum(mass * (at[0] ** 2 + at[1] ** 2) for mass, at in points)

    moved = [
        (11.0, np.add(middle, [0.03, 0.0, 0.0])),
        (11.0, np.add(middle, [0.0, -0.01, 0.0])),
        (-22.0, middle),
        (water_kg, tank),
    ]
    assert float(made.M[5, 5]) == pytest.approx(about_z(moved), rel=1e-3)


def test_a_glider_without_way_for_its_glide_is_none():
    data = changed(("moving_masses", "layout", 0, "limit_m"), 0.001)
    config = VehicleConfig.model_validate(data)
    assert glide.best_glide(config, config.find_set(None)) is None
    down, up = glide.best_glide(*(lambda c: (c, c.find_set(None)))(library.load_vehicle("seawing")))
    assert down.vertical_mps < 0 < up.vertical_mps
    assert min(down.horizontal_mps, up.horizontal_mps) > 0.4
