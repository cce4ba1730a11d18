"""Scenario files beyond their faults one by one: blame, folders, voltages, what cannot be flown."""

import re

import pytest

from angler_mjx.cli.shared.inputs import build_scenario
from angler_mjx.errors import ConfigError
from angler_mjx.files import RenamedKeyWarning, parse_model
from angler_mjx.scenario.editing import scenario_table
from angler_mjx.scenario.scenario import Scenario, load_scenario

from ..robot.vehicles import made_up

HEAD = """schema_version = 1
name = "made_up"
{top}

[world]
preset = "open"
{world}

{rest}

[[fleet]]
vehicle = "{vehicle}"
{fleet}
"""


@pytest.fixture
def write(tmp_path):
    def writing(top="", world="", rest="", vehicle="bluerov2", fleet=""):
        path = tmp_path / "here" / "made_up.toml"
        path.parent.mkdir(exist_ok=True)
        path.write_text(HEAD.format(top=top, world=world, rest=rest, vehicle=vehicle, fleet=fleet))
        return path

    return writing


def test_what_an_override_brings_is_said_of_it_alone():
    """Of a check of several tables: by the keys, without what the table is called inside."""
    with pytest.raises(ConfigError) as caught:
        load_scenario("reef_survey", task={"altitude_m": 100.0})
    said = str(caught.value)
    assert said.startswith("task.altitude_m (given with the scenario) = 100: higher than")
    with pytest.raises(ConfigError) as caught:
        load_scenario("reef_fleet", controller={"name": "los"}, planner={"replan_hz": 1.0})
    assert "(whole file)" not in str(caught.value)
    tide = {"type": "tide", "constituents": []}
    with pytest.raises(ConfigError, match=r"constituents = .*: has 0 entries; give at least 1"):
        load_scenario("reef_fleet", world={"currents": [tide]})


def refused(path, **overrides):
    with pytest.raises(ConfigError) as caught:
        load_scenario(path, **overrides)
    return str(caught.value)


TYPES = {
    "worlds": {"top": "worlds = true"},
    "worlds ": {"top": 'worlds = "4"'},
    "seed": {"top": "seed = false"},
    "schema_version": {},
    "fleet[0].battery_v": {"fleet": 'battery_v = "12"'},
    "fleet[0].fault_visible": {"fleet": "fault_visible = 1"},
    "fleet[0].count": {"fleet": "count = 2.0"},
}


@pytest.mark.parametrize("key", TYPES)
def test_types_are_strict(key, write):
    path = write(**TYPES[key])
    if key == "schema_version":
        path.write_text(path.read_text().replace("schema_version = 1", "schema_version = true"))
    assert re.search(rf"1 fault\n  {re.escape(key.strip())} = ", refused(path))


FAULTS = {
    "time": {"rest": "[time]\nphysics_dt_s = 1e-320"},
    "time.record_hz": {"rest": "[time]\nrecord_hz = 1e308"},
    "1 / (record_hz control_dt_s)": {"rest": "[time]\nrecord_hz = 1e-320"},
    "max_speed_mps": {"rest": '[[world.currents]]\ntype = "gauss_markov"\nmax_speed_mps = 1e30'},
    "knot_dt_s": {
        "rest": '[[world.currents]]\ntype = "gauss_markov"\nmax_speed_mps = 1.0\nknot_dt_s = 1e-9'
    },
    "100000 are the most": {
        "rest": "[time]\nhorizon_s = 86400.0\n"
        '[[world.currents]]\ntype = "gauss_markov"\nmax_speed_mps = 1.0\nknot_dt_s = 0.02'
    },
    "redraw_limit": {"world": "redraw_limit = 100000000000"},
    "seed": {"top": "seed = 99999999999999999999"},
    "fleet[0].vehicle": {"vehicle": "x" * 5000},
    "battery_v": {"fleet": "battery_v = 21.0"},
    "places": {"world": 'placement = "given"\nstart_m = [[0.0, 0.0, -5.0]]\n'
               "goal_m = [[1.0, 0.0, -5.0]]", "fleet": "count = 2"},
    "outside": {"world": 'placement = "given"\nstart_m = [[0.0, 0.0, -500.0]]\n'
                "goal_m = [[1.0, 0.0, -5.0]]"},
    "cell_m": {"world": "cell_m = 0.1"},
    "rotor_response": {"rest": '[[fleet]]\nvehicle = "bluerov2"\nrotor_response = "third_order"'},
}  # fmt: skip


@pytest.mark.parametrize("word", FAULTS)
def test_one_fault_is_one_message_that_names_the_file(word, write):
    path = write(**FAULTS[word])
    message = refused(path)
    assert message.startswith(f"{path}: 1 fault\n")
    assert word in message
    assert len(message) < 600


def test_the_old_name_of_a_value_is_read_with_a_warning(write):
    path = write(top='engine = "fused"\nkernels = "triton"')
    with pytest.warns(RenamedKeyWarning, match=r'made_up\.toml: kernels = "triton" is "cuda"'):
        assert load_scenario(path).kernels == "cuda"


def test_programs_write_the_old_name_of_a_value_without_a_warning(recwarn):
    table = scenario_table(load_scenario("reef_fleet"))
    old = {**table, "engine": "fused", "kernels": "triton"}
    assert parse_model(Scenario, old, source="run.json").kernels == "cuda"
    assert not recwarn


def test_what_is_wrong_with_a_flag_is_said_of_the_flag(write):
    path = write()
    for flags, word in (
        ({"worlds": 0}, "--worlds = 0"),
        ({"engine": "mjx", "kernels": "cuda"}, "--engine, --kernels: "),
        ({"time": {"record_hz": -1.0}}, "--record-hz = -1.0"),
        ({"time": {"record_hz": 3.0}}, "--record-hz: time: "),
        ({"seed": 10**30}, "--seed = "),
        ({"policy": {"name": "mpc"}}, "--policy = "),
    ):
        with pytest.raises(ConfigError) as caught:
            build_scenario(str(path), **flags)
        assert str(caught.value).startswith(word)
        assert str(path) not in str(caught.value)


def test_both_the_flag_and_the_file_are_blamed_for_their_own(write):
    message = refused(write(top="tile = 0"), worlds=0)
    assert message.startswith("worlds (given with the scenario) = 0: ")
    assert "made_up.toml: 1 fault\n  tile = 0" in message


def test_a_vehicle_stands_beside_its_scenario(write, tmp_path, monkeypatch):
    path = write(vehicle="four.toml")
    made_up.write(path.parent / "four.toml", made_up.FOUR)
    monkeypatch.chdir(tmp_path)
    (kind,) = load_scenario(path.relative_to(tmp_path)).members()[0].variants
    assert kind.vehicle == str(path.parent / "four.toml")
    assert "four.toml: cannot be read" in refused(
        "here/made_up.toml", fleet=[{"vehicle": "four.toml"}]
    )


def test_a_faulty_vehicle_is_one_fault_of_the_scenario(write):
    path = write(vehicle="four.toml")
    made_up.write(path.parent / "four.toml", made_up.FOUR, mass_kg="-1.0")
    message = refused(path)
    assert message.startswith(f"{path}: 1 fault\n  fleet[0].vehicle = ")
    assert "mass_kg = -1.0" in message


def test_the_battery_goes_as_far_as_the_thruster_file(write):
    path = write(vehicle="four.toml", fleet="battery_v = 30.0")
    table = (made_up.SHIPPED.parent / "thrusters" / "t200.toml").read_text()
    volts = re.search(r"voltage_v = \[(.*)\]", table)[1].split(",")
    other = ", ".join(str(2 * float(volt)) for volt in volts)
    (path.parent / "big.toml").write_text(table.replace(", ".join(v.strip() for v in volts), other))
    made_up.write(path.parent / "four.toml", made_up.FOUR, model='"big.toml"')
    assert load_scenario(path).fleet[0].battery_v == 30.0
    assert "from 20 V to 40 V" in refused(write(vehicle="four.toml", fleet="battery_v = 16.0"))


def test_what_cannot_fly_is_refused_by_name(write):
    path = write(vehicle="torpedo.toml")
    made_up.write(path.parent / "torpedo.toml", made_up.TORPEDO, name="torpedo")
    message = refused(path)
    assert "vehicle 'torpedo' cannot fly a path" in message
    assert "no thrust in heave or yaw alone" in message


def test_ardusub_is_refused_without_sway(write):
    path = write(vehicle="four.toml", rest='[controller]\nname = "ardusub"')
    made_up.write(path.parent / "four.toml", made_up.FOUR, name="four")
    message = refused(path)
    assert "'ardusub'" in message
    assert "'four', has no sway" in message
