"""The planner auto: resolved by the number of robots, said in a line, stored with its result."""

import tomllib

import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.files import check
from angler_mjx.planning import register
from angler_mjx.planning.automatic import LARGE_TEAM
from angler_mjx.scenario import notices
from angler_mjx.scenario.editing import table_of
from angler_mjx.scenario.scenario import Scenario, find, load_scenario
from angler_mjx.studies import settings
from angler_mjx.studies.cells import cells


def fleet_of(robots):
    """The fleet of reef_fleet with one entry of ``robots``."""
    return [{"vehicle": "bluerov2", "parameter_set": "blue_gazebo", "count": robots}]


def load(robots, **planner):
    return load_scenario("reef_fleet", fleet=fleet_of(robots), planner=planner)


@pytest.mark.parametrize(
    ("robots", "name"),
    [(1, "grid"), (LARGE_TEAM - 1, "grid"), (LARGE_TEAM, "priority"), (64, "priority")],
)
def test_the_size_of_the_team_chooses_and_a_line_says_so(robots, name):
    for scenario in (load(robots), load(robots, name="auto")):
        assert scenario.planner.chosen().reference.name == name
        team = "1 robot" if robots == 1 else f"{robots} robots"
        assert notices.lines(scenario) == [f"planner: {name} (auto: {team})"]
    assert notices.lines(scenario, planned=False) == []


def test_files_that_name_a_planner_are_as_they_were():
    for name in ("grid", "priority", "current"):
        for robots in (1, 64):
            scenario = load(robots, name=name)
            assert (scenario.planner.name, scenario.planner.requested) == (name, None)
            assert notices.lines(scenario) == []


def test_a_stored_scenario_keeps_what_auto_resolved_to_then(monkeypatch):
    scenario = load(64)
    stored = scenario.model_dump(mode="json")
    assert (stored["planner"]["name"], stored["planner"]["requested"]) == ("priority", "auto")
    monkeypatch.setattr("angler_mjx.planning.automatic.LARGE_TEAM", 65)
    assert load(64).planner.name == "grid"
    again = check(Scenario, stored)
    assert again == scenario
    assert again.planner.name == "priority"


def test_cells_of_a_sweep_are_resolved_each_by_its_own_team():
    table = table_of(load_scenario("reef_fleet", planner={"margin_m": 0.2}))
    axes = settings.axes(["fleet.0.count=1,30"])
    found = [cell.scenario.planner for cell in cells(table, axes, "reef_fleet")]
    assert [one.name for one in found] == ["grid", "priority"]
    assert [one.margin_m for one in found] == [0.2, 0.2]
    axes = settings.axes(["fleet.0.count=30", "planner.name=grid,auto"])
    named = [cell.scenario.planner.name for cell in cells(table, axes, "reef_fleet")]
    assert named == ["grid", "priority"]


def test_settings_of_either_planner_may_stand_beside_auto():
    both = {"grid": {"start_hold_s": 2.0}, "priority": {"budget": 4}}
    assert load(2, **both).planner.chosen().settings == {"start_hold_s": 2.0}
    assert load(64, **both).planner.chosen().settings == {"budget": 4}
    for robots in (2, 64):  # also of the one that is not chosen
        with pytest.raises(ConfigError, match=r"\[planner\.priority\] 'budge'"):
            load(robots, priority={"budge": 4})
        with pytest.raises(ConfigError, match=r"\[planner\.current\]"):
            load(robots, current={"budget": 4})


def test_a_name_that_code_puts_in_place_of_the_resolved_one_holds():
    scenario = load(64)
    planner = scenario.planner.model_copy(update={"name": "current"})
    other = scenario.model_copy(update={"planner": planner})
    again = check(Scenario, other.model_dump(mode="json"))
    assert again == other
    assert again.planner.chosen().reference.name == "current"
    assert notices.lines(again) == []


def test_where_no_team_is_known_the_name_is_refused():
    with pytest.raises(ConfigError, match=r"'auto': is chosen in a scenario.*grid or priority"):
        register.find("auto")


def test_no_shipped_scenario_of_a_crossing_names_a_planner():
    for name in ("reef_fleet", "dense_dynamic", "heterogeneous", "open_water_current"):
        assert "planner" not in tomllib.loads(find(name).read_text(encoding="utf-8"))
        assert load_scenario(name).planner.requested == "auto"
