"""Links and joints of vehicle files: the shipped arm, and what is refused with which words."""

import copy
import tomllib
from pathlib import Path

import numpy as np
import pytest

import angler_mjx.robot.vehicles
from angler_mjx.errors import ConfigError
from angler_mjx.files import parse_model
from angler_mjx.robot.vehicles import params
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.library import load_vehicle

DATA = Path(angler_mjx.robot.vehicles.__file__).parent / "data"
ARMED = tomllib.loads((DATA / "bluerov2_heavy_alpha5.toml").read_text())


def changed(path, value):
    data = copy.deepcopy(ARMED)
    table = data
    for key in path[:-1]:
        table = table[key]
    if value is None:
        del table[path[-1]]
    else:
        table[path[-1]] = value
    return data


def complaint(data):
    with pytest.raises(ConfigError) as caught:
        parse_model(VehicleConfig, data, source="some.toml")
    return str(caught.value)


@pytest.mark.parametrize(
    ("path", "value", "message_parts"),
    [
        (("links", 2, "rigid_body", "mass_kg"), None, ("links", "rigid_body.mass_kg", "missing")),
        (("links", 2, "rigid_body", "mass_kg"), 0.0, ("mass_kg", "greater than 0")),
        (("links", 2, "rigid_body"), None, ("rigid_body", "missing")),
        (
            ("links", 2, "rigid_body", "inertia_kgm2"),
            [1e-4, 1e-4, 3e-4],
            ("inertia_kgm2", "no rigid body has principal moments"),
        ),
        (("links", 1, "parent"), "wrist", ("links.1.parent", "loop")),
        (("links", 1, "parent"), "hand", ("links.1.parent", "no such link", "upper_arm")),
        (("links", 1, "joint"), "axis_z", ("links.1.joint", "no such joint", "axis_e")),
        (("links", 1, "joint"), "axis_d", ("joints.0.name", "joint of one link")),
        (("links", 1, "name"), "wrist", ("link names must differ", "wrist")),
        (("links", 1, "name"), "base", ("link names must differ", "base")),
        (("joints", 1, "name"), "axis_e", ("joint names must differ", "axis_e")),
        (("joints", 1, "lower"), 4.0, ("joints", "lower must be below upper")),
        (("joints", 1, "home"), 4.0, ("joints", "home = 4", "between")),
        (("joints", 1, "axis"), [1.0, 1.0, 0.0], ("axis", "unit vector")),
        (("joints", 1, "type"), "ball", ("type", "revolute")),
        (("joints", 1, "actuator", "damping"), 0.0, ("damping = 0", "swing for ever")),
        (
            ("joints", 1, "actuator"),
            ARMED["joints"][1]["actuator"] | {"stiffness": 0.5, "damping": 0.0},
            ("damping = 0", "swing for ever"),
        ),
        (("joints", 1, "actuator", "max_effort"), -9.0, ("max_effort", "greater than 0")),
        (("links", 2, "buoyancy", "volume_m3"), -1e-3, ("volume_m3", "greater than or equal")),
        (("links", 2, "water", "cylinders", 0, "to_m"), [-0.005, 0.0, 0.0], ("1 mm apart",)),
        (("links", 2, "water", "added_mass"), [1, 1, 1, 1, 1, -1], ("must not be negative",)),
        (
            ("parameter_sets", "wu2018", "links"),
            {"hand": {}},
            ("parameter_sets.wu2018.links.hand", "no such link"),
        ),
    ],
)
def test_a_wrong_value_is_named_in_one_message(path, value, message_parts):
    message = complaint(changed(path, value))
    assert "some.toml: 1 fault" in message
    for part in message_parts:
        assert part in message


def test_a_set_has_numbers_of_links_of_its_own():
    body = {**ARMED["links"][2]["rigid_body"], "mass_kg": 0.429}
    data = changed(("parameter_sets", "wu2018", "links"), {"upper_arm": {"rigid_body": body}})
    config = parse_model(VehicleConfig, data, source="some.toml")
    masses = [
        params.build_vehicle(config, name, 16.0).links.mass_kg for name in ("wu2018", "blue_gazebo")
    ]
    names = [link.name for link in config.find_links(None)]
    expected = np.where(np.array(names) == "upper_arm", 0.429 - 0.380, 0.0)
    np.testing.assert_allclose(masses[0] - masses[1], expected, atol=1e-7)


def test_the_arm_weighs_and_displaces_what_its_datasheet_says():
    links = load_vehicle("bluerov2_heavy_alpha5").find_links(None)
    arm = [link for link in links if link.name != "jaws"]
    assert sum(link.rigid_body.mass_kg for link in arm) == pytest.approx(1.272)
    assert sum(link.buoyancy.volume_m3 for link in arm) == pytest.approx(0.573e-3)


def test_the_vehicle_lies_level_with_its_arm_at_home():
    from angler_mjx.robot.vehicles.link_motion import locate_links

    config = load_vehicle("bluerov2_heavy_alpha5")
    heavy = load_vehicle("bluerov2_heavy")
    for name in config.parameter_sets:
        vehicle = params.build_vehicle(config, name, 16.0)
        links = vehicle.links
        poses = locate_links(links, links.home)
        lift = poses.origin + np.einsum("lij,lj->li", poses.rotation, links.center_of_buoyancy_m)
        moment = 1000.0 * vehicle.volume_m3 * vehicle.p_cb_m
        moment += 1000.0 * links.volume_m3 @ lift - links.mass_kg @ poses.center
        # Grams times metres: a tilt of 0.1 degrees at the least righting moment.
        np.testing.assert_allclose(moment[:2], 0.0, atol=2e-4)
        if name not in config.published_sets:  # floats as the vehicle that it was identified on
            continue
        plain = params.build_vehicle(heavy, name, 16.0)
        net = 1000.0 * (vehicle.volume_m3 + links.volume_m3.sum()) - links.mass_kg.sum()
        assert net == pytest.approx(1000.0 * float(plain.volume_m3), abs=1e-4)
