"""Scenario files: what is accepted, and that every fault of a file is named at once."""

import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.scenario.scenario import Scenario, load_scenario, shipped_scenarios


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


def test_faults_and_rotors_reach_the_fleet(tmp_path):
    path = write(
        tmp_path,
        '[[fleet]]\nvehicle = "bluerov2"\n'
        "thruster_health = { thruster_5 = 0.25, thruster_1 = 0.0 }\n"
        'fault_visible = false\nrotor_response = "third_order"',
    )
    (kind,) = load_scenario(path).members()[-1].variants
    assert kind.thruster_health == (("thruster_5", 0.25), ("thruster_1", 0.0))
    assert not kind.fault_known
    assert kind.rotor_response == "third_order"
    (other,) = load_scenario("open_water_current").members()[0].variants
    assert (other.thruster_health, other.fault_known, other.rotor_response) == ((), True, None)


FAULTS = {
    "unknown thruster": (
        '[[fleet]]\nvehicle = "bluerov2"\nthruster_health = { thruster_9 = 0.0 }',
        ["fleet", "thruster_9", "thruster_1", "thruster_6"],
    ),
    "health out of range": (
        '[[fleet]]\nvehicle = "bluerov2"\nthruster_health = { thruster_3 = 1.5 }',
        ["fleet", "thruster_3", "1.5", "between 0"],
    ),
    "unknown response": (
        '[[fleet]]\nvehicle = "bluerov2"\nrotor_response = "second_order"',
        ["fleet", "rotor_response", "first_order", "third_order"],
    ),
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
        ["fleet", "parameter_mix", "greater than 0"],
    ),
    "steps that do not fit": (
        "[time]\nphysics_dt_s = 0.03\ncontrol_dt_s = 0.05",
        ["time", "control_dt_s / physics_dt_s", "whole number"],
    ),
    "unknown engine": ('engine = "warp"', ["engine", "warp", "mjx"]),
    "unknown controller": ('[controller]\nname = "lqr"', ["controller", "lqr", "cascade, pid"]),
    "unknown stage": ('[controller]\nstages = ["follow", "mpc"]', ["'mpc'", "pid_velocity"]),
    "no stage": ("[controller]\nstages = []", ["controller.stages", "at least 1"]),
    "name and stages": (
        '[controller]\nname = "pid"\nstages = ["follow", "ardusub"]',
        ["controller", "name or stages"],
    ),
    "stages that do not fit": (
        '[controller]\nstages = ["follow", "velocity", "pseudo_inverse"]',
        ["'follow' gives PoseTarget", "'velocity' below it takes BodyTwist"],
    ),
    "no signals at the end": (
        '[controller]\nstages = ["follow", "pose", "velocity"]',
        ["'velocity', gives BodyWrench", "ThrusterPwm"],
    ),
    "no path at the beginning": (
        '[controller]\nstages = ["pose", "velocity", "pseudo_inverse"]',
        ["'pose', takes PoseTarget or TrackingTarget", "begin with follow or reference or los"],
    ),
    "gains of no stage": (
        '[controller]\nname = "pid"\ngains.velocity.velocity_per_s = 1.0',
        ["gains.velocity", "pid_velocity"],
    ),
    "unknown gain": (
        "[controller.gains.velocity]\nspeed = 1.0",
        ["gains.velocity.speed = 1", "unknown gain", "velocity_per_s"],
    ),
    "gain of the wrong sign": (
        "[controller.gains.velocity]\nvelocity_per_s = -2.5",
        ["gains of velocity", "velocity_per_s = -2.5"],
    ),
    "gains in one heap": (
        "[controller.gains]\nvelocity_per_s = 2.5",
        ["gains.velocity_per_s = 2.5", "[controller.gains.velocity]"],
    ),
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
    for name in shipped_scenarios():
        assert name in str(caught.value)


def test_missing_file_and_broken_toml(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        load_scenario(tmp_path / "none.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text("name = ")
    with pytest.raises(ConfigError, match="not valid TOML"):
        load_scenario(broken)


def of_preset(tmp_path, preset, more=""):
    file = tmp_path / "one.toml"
    file.write_text(
        f'schema_version = 1\nname = "one"\n{more}\n[world]\npreset = "{preset}"\n'
        '[[fleet]]\nvehicle = "bluerov2"\n'
    )
    return load_scenario(file)


def test_a_scenario_without_a_horizon_has_that_of_its_preset(tmp_path):
    assert of_preset(tmp_path, "reef").time.horizon_s == 120.0
    long = of_preset(tmp_path, "corridor", "[time]\nrecord_hz = 1.0")
    assert (long.time.horizon_s, long.time.control_steps) == (240.0, 4800)
    assert "horizon_s" not in long.model_dump(exclude_unset=True)["time"]
    assert of_preset(tmp_path, "corridor", "[time]\nhorizon_s = 120.0").time.horizon_s == 120.0


def test_what_is_kept_of_a_scenario_is_the_same_scenario_whatever_its_preset_says_later(tmp_path):
    long = of_preset(tmp_path, "corridor")
    kept = long.model_dump(mode="json")
    assert kept["time"]["horizon_s"] == 240.0
    assert Scenario.model_validate(kept).digest() == long.digest()


def test_what_is_stored_beside_is_asked_for_by_name(scenario_file):
    asked = load_scenario(scenario_file, store={"also": ["wrench", "clearance"]})
    assert asked.sim_spec().also == ("wrench", "clearance")
    plain = load_scenario(scenario_file)
    assert plain.sim_spec().also == ()
    assert plain.digest() == asked.digest()
    for also, word in (
        (["speed"], "'wrench', 'clearance', 'acoustics' or 'grips'"),
        (["wrench"] * 2, "name it once"),
    ):
        with pytest.raises(ConfigError, match=word) as caught:
            load_scenario(scenario_file, store={"also": also})
        assert str(caught.value).count("also") == 1


def test_problems_are_called_what_they_were_called_before():
    """Manifests of data sets and benchmarks hold these: what comes later must not change them."""
    known = {"reef_fleet": "838f894a1f35e9fb", "open_water_current": "b1e50edbb82876bb"}
    assert {name: load_scenario(name).digest()[:16] for name in known} == known
