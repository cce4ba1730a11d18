"""Scenario files: what is accepted, and that every fault of a file is named at once."""

import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.runs.scenario import load_scenario, shipped


@pytest.mark.parametrize(
    "name", ["dense_dynamic", "heterogeneous", "open_water_current", "reef_fleet"]
)
def test_shipped_scenarios_load(name):
    scenario = load_scenario(name)
    assert scenario.name == name
    assert scenario.description
    assert scenario.time.horizon_s == 120.0


def test_what_the_demo_is():
    scenario = load_scenario("reef_fleet")
    assert len(scenario.members()) == 4
    assert len({entry.vehicle for entry in scenario.fleet}) == 2
    assert scenario.world.obstacles.dynamic.count == 12
    assert load_scenario("dense_dynamic").world.obstacles.dynamic.count == 48


def test_overrides_replace_keys_and_merge_tables(scenario_file):
    scenario = load_scenario(scenario_file, worlds=7, time={"record_hz": 0.0})
    assert scenario.worlds == 7
    assert scenario.time.record_hz == 0.0
    assert scenario.time.horizon_s == 20.0


FAULTS = {
    "unknown key": ('nmae = "x"', ["nmae", "unknown key"]),
    "wrong unit": (
        "[world.obstacles.dynamic]\nradius_cm = [40.0, 75.0]",
        ["radius_cm", "unknown key"],
    ),
    "zero worlds": ("worlds = 0", ["worlds", "0", "greater than or equal to 1"]),
    "NaN": ("goal_tolerance_m = nan", ["goal_tolerance_m", "nan"]),
    "unknown vehicle": ('[[fleet]]\nvehicle = "bluerov9"', ["fleet", "bluerov9", "bluerov2_heavy"]),
    "unknown set": (
        '[[fleet]]\nvehicle = "bluerov2"\nparameter_set = "wu2019"',
        ["fleet", "wu2019", "blue_gazebo"],
    ),
    "negative weight": (
        '[[fleet]]\nvehicle = "bluerov2"\nparameter_mix = { blue_gazebo = -1.0 }',
        ["fleet", "parameter_mix", "positive"],
    ),
    "steps that do not fit": (
        "[time]\nphysics_dt_s = 0.03\ncontrol_dt_s = 0.05",
        ["time", "control_dt_s / physics_dt_s", "whole number"],
    ),
    "unknown engine": ('engine = "warp"', ["engine", "warp", "mjx"]),
    "unknown gain": ("[controller]\ngains = { speed = 1.0 }", ["gains", "speed", "unknown gain"]),
}


def write(tmp_path, text, *, fleet=True):
    head = 'schema_version = 1\nname = "bad"\n'
    tables = '\n[world]\npreset = "open"\n'
    if "[[fleet]]" not in text and fleet:
        tables += '\n[[fleet]]\nvehicle = "bluerov2"\n'
    keys, _, rest = text.partition("[")
    path = tmp_path / "bad.toml"
    path.write_text(head + keys + tables + ("[" + rest if rest else ""))
    return path


@pytest.mark.parametrize("fault", FAULTS)
def test_fault_is_named_with_file_key_and_value(fault, tmp_path):
    text, words = FAULTS[fault]
    path = write(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        load_scenario(path)
    message = str(caught.value)
    assert str(path) in message
    for word in words:
        assert word in message


def test_all_faults_of_a_file_come_at_once(tmp_path):
    path = write(tmp_path, "worlds = 0\ngoal_tolerance_m = -1.0\nspeling = 1\n")
    with pytest.raises(ConfigError) as caught:
        load_scenario(path)
    message = str(caught.value)
    assert "3 faults" in message
    for key in ("worlds", "goal_tolerance_m", "speling"):
        assert key in message


def test_unknown_name_lists_what_there_is():
    with pytest.raises(ConfigError) as caught:
        load_scenario("reef_feet")
    for name in shipped():
        assert name in str(caught.value)


def test_missing_file_and_broken_toml(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        load_scenario(tmp_path / "none.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text("name = ")
    with pytest.raises(ConfigError, match="not valid TOML"):
        load_scenario(broken)
