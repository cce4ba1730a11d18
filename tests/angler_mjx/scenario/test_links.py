"""Scenarios with vehicles that have arms: which fleets and engines take them."""

import copy

import pytest

from angler_mjx.errors import ConfigError, UnsupportedError
from angler_mjx.files import parse_model
from angler_mjx.robot.vehicles import library
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim import fleet
from angler_mjx.sim.engines.lanes import steps
from angler_mjx.sim.fleet import Member, Variant

ARMED = {"vehicle": "bluerov2_heavy_alpha5"}
RIGID = {"vehicle": "bluerov2_heavy"}


def scenario(*entries, **changes):
    data = {"name": "arms", "world": {"preset": "open"}, "fleet": list(entries), **changes}
    return parse_model(Scenario, data, source="some.toml")


def test_the_fused_engine_refuses_an_arm_and_names_the_other():
    with pytest.raises(ConfigError, match=r"fleet\[1\].*alpha5.*has joints.*engine = \"mjx\""):
        scenario(RIGID, ARMED, engine="fused")
    assert scenario(RIGID, ARMED).engine == "mjx"


def test_lanes_refuse_an_arm_that_comes_without_a_scenario():
    kind = Variant(vehicle="bluerov2_heavy_alpha5", parameter_set="wu2018", battery_v=16.0)
    member = Member(variants=(kind,), weights=(1.0,), cruise_speed_mps=0.5)
    built = fleet.build_fleet([member], multibody=False)
    with pytest.raises(UnsupportedError, match='engine = "mjx"'):
        steps.refuse_joints(built.control.vehicle)


def test_different_arms_in_one_fleet_are_refused_by_name(tmp_path):
    text = library.locate_vehicle("bluerov2_heavy_alpha5").read_text(encoding="utf-8")
    other = tmp_path / "short.toml"
    begin, end = text.index('[[links]]\nname = "jaws"'), text.index("[[joints]]")
    text = text[:begin] + text[end:]
    text = text[: text.index('[[joints]]\nname = "axis_a"')] + text[text.index("# A float") :]
    text = text[: text.index("[parameter_sets.hinsdale2023_identified]")]  # it names the jaws
    other.write_text(text.replace('"bluerov2_heavy_alpha5"', '"short"'), encoding="utf-8")
    with pytest.raises(
        ConfigError, match=r"fleet\[1\]: the links of 'short'.*bluerov2_heavy_alpha5"
    ):
        scenario(copy.copy(ARMED), {"vehicle": str(other)})
    members = [
        Member(
            variants=(Variant(vehicle=name, parameter_set="wu2018", battery_v=16.0),),
            weights=(1.0,),
            cruise_speed_mps=0.5,
        )
        for name in ("bluerov2_heavy_alpha5", str(other))
    ]
    with pytest.raises(ConfigError, match=r"short.*bluerov2_heavy_alpha5"):
        fleet.build_fleet(members)


def test_cells_smaller_than_an_arm_are_refused():
    world = {"preset": "open", "cell_m": 0.7}
    with pytest.raises(ConfigError, match=r"world.cell_m = 0.7: the arm of fleet\[1\].*0.739 m"):
        scenario(RIGID, ARMED, world=world)
    assert scenario(RIGID, world=world).world.cell_m == 0.7
    assert scenario(ARMED, world={"preset": "open", "cell_m": 0.75}).world.cell_m == 0.75
