"""Vehicle files: the shipped ones, and what is refused with which words."""

import copy
import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

import angler_mjx.robot.vehicles
from angler_mjx.errors import ConfigError
from angler_mjx.files import parse_model
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.library import list_vehicles, load_thruster, load_vehicle
from angler_mjx.robot.vehicles.thruster_config import ThrusterTable

DATA = Path(angler_mjx.robot.vehicles.__file__).parent / "data"
HEAVY = tomllib.loads((DATA / "bluerov2_heavy.toml").read_text())
T200 = tomllib.loads((DATA / "thrusters" / "t200.toml").read_text())


def changed(path, value, base=HEAVY):
    data = copy.deepcopy(base)
    table = data
    for key in path[:-1]:
        table = table[key]
    table[path[-1]] = value
    return data


def complaint(data, model=VehicleConfig):
    with pytest.raises(ConfigError) as caught:
        parse_model(model, data, source="some.toml")
    return str(caught.value)


def test_shipped_vehicles_and_sets():
    assert list_vehicles() == [
        "bluerov2",
        "bluerov2_heavy",
        "bluerov2_heavy_alpha5",
        "otter",
        "remus100",
        "rexrov",
        "seawing",
    ]
    assert set(load_vehicle("bluerov2_heavy").parameter_sets) == {
        "wu2018",
        "von_benzon2022",
        "blue_gazebo",
        "hinsdale2023_identified",
    }
    assert load_vehicle("bluerov2_heavy").published_sets == (
        "blue_gazebo",
        "von_benzon2022",
        "wu2018",
    )
    assert set(load_vehicle("bluerov2").parameter_sets) == {"blue_gazebo", "blue_ismc"}


@pytest.mark.parametrize(("name", "box_m"), [("bluerov2_heavy", 0.575), ("bluerov2", 0.338)])
def test_hull_has_the_outer_box_of_its_source(name, box_m):
    hull = load_vehicle(name).hull
    ends = np.array([(c.from_m, c.to_m) for c in hull.capsules])
    radius = np.array([c.radius_m for c in hull.capsules])[:, None]
    size = (ends.max(1) + radius).max(0) - (ends.min(1) - radius).min(0)
    # Half a millimetre: the source gives millimetres.
    np.testing.assert_allclose(size, [0.457, box_m, hull.height_m], atol=5e-4)


def test_diagonals_and_full_matrices_mean_the_same():
    body = ("parameter_sets", "wu2018", "rigid_body", "inertia_kgm2")
    full = changed(body, [[0.16, 0, 0], [0, 0.16, 0], [0, 0, 0.16]])
    assert parse_model(VehicleConfig, full, source="a") == parse_model(
        VehicleConfig, HEAVY, source="a"
    )


SET = ("parameter_sets", "wu2018")
INERTIA = (*SET, "rigid_body", "inertia_kgm2")
ADDED = (*SET, "added_mass", "coefficients")


@pytest.mark.parametrize(
    ("path", "value", "message_part"),
    [
        ((*SET, "rigid_body", "mass_kg"), -11.5, "greater than 0"),
        ((*SET, "rigid_body", "mass_kg"), math.nan, "finite"),
        (INERTIA, [0.1, 0.1, 0.3], "no rigid body has principal moments"),
        (INERTIA, [0.1, 0.1, -0.1], "positive definite"),
        (INERTIA, [0.1, math.nan, 0.1], "finite"),
        (INERTIA, [[0.16, 0.01, 0], [0, 0.16, 0], [0, 0, 0.16]], "symmetric"),
        (INERTIA, [0.1, 0.1], "3 diagonal values"),
        (INERTIA, "heavy", "3 diagonal values"),
        (ADDED, [5.5, 12.7, 14.57, 0.12, 0.12, -0.12], "must not be negative"),
        (ADDED, (np.eye(6) + np.eye(6, k=1)).tolist(), "symmetric"),
        ((*SET, "damping", "quadratic"), [-1, 1, 1, 1, 1, 1], "none of them negative"),
        ((*SET, "damping", "linear"), [1, 1, 1], "give six values"),
        ((*SET, "buoyancy", "volume_m3"), 0.0, "greater than 0"),
        (("thrusters", "layout", 0, "direction"), [1.0, 1.0, 0.0], "unit vector"),
        (("thrusters", "layout", 0, "name"), "thruster_2", "must differ"),
        (("visual", "shapes", 0, "name"), "dome", "must differ"),
        (("thrusters", "layout", 0, "spin"), 2, "1"),
        (("default_set",), "wu2019", "wu2019"),
        (("rotor", "lag", "time_constant_s"), 0.0, "greater than 0"),
        (("hull", "capsules", 0, "radius_m"), -0.1, "greater than 0"),
        (("hull", "capsules", 0, "to_m"), HEAVY["hull"]["capsules"][0]["from_m"], "1 mm apart"),
        (("hull", "height"), 0.254, "unknown key"),
    ],
)
def test_a_wrong_value_is_named(path, value, message_part):
    message = complaint(changed(path, value))
    assert "some.toml: 1 fault" in message
    assert message_part in message
    if path != ("default_set",):  # checked against the whole file, so named in the text
        assert str(path[-1]) in message or f"{path[0]}.{path[1]} =" in message


def test_a_set_without_any_damping_on_an_axis_is_refused():
    data = changed((*SET, "damping", "linear"), [0, 1, 1, 1, 1, 1])
    data["parameter_sets"]["wu2018"]["damping"]["quadratic"][0] = 0
    assert "no damping at all on axis 0" in complaint(data)


THIRD = ("rotor", "third_order")


@pytest.mark.parametrize(
    ("path", "value", "message_part"),
    [
        ((*THIRD, "denominator"), [1.0, 1.0, 9258.0, 108700.0], "would swing for ever"),
        ((*THIRD, "denominator"), [1.0, -89.0, 9258.0, 108700.0], "greater than 0"),
        ((*THIRD, "denominator"), [1.0, 89.0, 9258.0], "missing"),
        ((*THIRD, "numerator"), [0.0, 6136.0, 100000.0], "must be equal"),
        (("rotor", "response"), "second_order", "third_order"),
    ],
)
def test_a_wrong_rotor_is_refused(path, value, message_part):
    message = complaint(changed(path, value))
    assert "rotor" in message
    assert message_part in message


def test_third_order_needs_its_numbers():
    data = changed(("rotor", "response"), "third_order")
    assert parse_model(VehicleConfig, data, source="a").rotor.response == "third_order"
    del data["rotor"]["third_order"]
    assert "needs a table [rotor.third_order]" in complaint(data)


def test_health_is_by_name_in_the_order_of_the_file():
    config = load_vehicle("bluerov2")
    assert config.find_health({"thruster_5": 0.5, "thruster_1": 0}) == (0, 1, 1, 1, 0.5, 1)
    with pytest.raises(ConfigError, match=r"no thruster 'thruster_7'; it has thruster_1, .*_6"):
        config.find_health({"thruster_7": 0.0})
    for share in (-0.1, 1.01, math.nan):
        with pytest.raises(ConfigError, match=f"'thruster_2'.*health {share} is not between"):
            config.find_health({"thruster_2": share})


def test_every_group_needs_its_source():
    data = copy.deepcopy(HEAVY)
    del data["parameter_sets"]["wu2018"]["damping"]["source"]
    del data["hull"]["source"]
    message = complaint(data)
    assert "2 faults" in message
    assert "parameter_sets.wu2018.damping.source: missing" in message
    assert "hull.source: missing" in message


def test_unknown_names_list_what_there_is():
    with pytest.raises(ConfigError, match=r"unknown vehicle 'rov'.*bluerov2, bluerov2_heavy"):
        load_vehicle("rov")
    with pytest.raises(ConfigError, match=r"no parameter set 'wu'.*wu2018"):
        load_vehicle("bluerov2_heavy").find_set("wu")
    with pytest.raises(ConfigError, match=r"unknown thruster 't500'.*t200"):
        load_thruster("t500")
    with pytest.raises(ConfigError, match="cannot be read"):
        load_vehicle("no/such/file.toml")


def test_a_thruster_path_is_relative_to_the_vehicle_file(tmp_path):
    text = (DATA / "bluerov2.toml").read_text().replace('"t200"', '"mine.toml"')
    (tmp_path / "rov.toml").write_text(text)
    (tmp_path / "mine.toml").write_text((DATA / "thrusters" / "t200.toml").read_text())
    assert load_thruster(load_vehicle(str(tmp_path / "rov.toml")).rotor.model) == load_thruster(
        "t200"
    )


@pytest.mark.parametrize(
    ("path", "value", "message_part"),
    [
        (("voltage_v",), [10, 12, 14, 16, 20, 18], "must increase"),
        (("thrust_n", 0), [1.0, 2.0], "rows of 6 values"),
        (("thrust_n", 0, 3), 5.0, "must not fall"),
        (("power_w", 0, 3), -5.0, "must not be negative"),
    ],
)
def test_a_wrong_thruster_table_is_refused(path, value, message_part):
    assert message_part in complaint(changed(path, value, T200), ThrusterTable)
