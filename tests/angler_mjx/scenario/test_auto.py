"""Planner and order of passing by auto: by the number of robots, in the run's lines and folder."""

import tomllib

import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.files import validate_model
from angler_mjx.planning import register
from angler_mjx.planning.mppi.policy import Mppi
from angler_mjx.planning.online.policy import Online
from angler_mjx.planning.planner_choice import LARGE_TEAM
from angler_mjx.runs.simulator.scenario_policy import resolve_policy
from angler_mjx.scenario import notices
from angler_mjx.scenario.editing import scenario_table
from angler_mjx.scenario.scenario import Scenario, find_scenario, load_scenario
from angler_mjx.studies import sweep_axes
from angler_mjx.studies.sweep import build_cells


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
        assert scenario.planner.planner_spec().reference.name == name
        team = "1 robot" if robots == 1 else f"{robots} robots"
        kept = [f"order: kept (auto: {team})"] if name == "priority" else []
        assert scenario.online == bool(kept)
        assert notices.run_notices(scenario) == [f"planner: {name} (auto: {team})", *kept]
        assert notices.run_notices(scenario, uses_planner=False) == kept
        assert notices.run_notices(scenario, uses_planner=False, is_commanded=True) == []


def test_files_that_name_a_planner_are_as_they_were():
    for name in ("grid", "priority", "current"):
        for robots in (1, 64):
            scenario = load(robots, name=name)
            assert (scenario.planner.name, scenario.planner.requested) == (name, None)
            assert (scenario.execution.order, scenario.online) == ("free", False)
            assert notices.run_notices(scenario) == []


STILL = {"currents": [], "obstacles": {"dynamic": {"count": 0}}}
DRIFTING = {"currents": [], "obstacles": {"dynamic": {"count": 1}}}
REQUESTED = {"name": "auto", "replan_hz": 1.0}


@pytest.mark.parametrize(
    ("changes", "order"),
    [
        ({}, "kept"),
        ({"world": DRIFTING}, "kept"),
        ({"world": STILL}, "free"),
        ({"controller": {"name": "los"}}, "free"),
        ({"policy": {"name": "mppi"}}, "free"),
        ({"planner": REQUESTED}, "free"),
        ({"acoustics": {"model": "range", "range_m": 50.0}}, "free"),
        ({"execution": {"order": "free"}}, "free"),
        ({"execution": {"order": "auto"}}, "kept"),
    ],
)
def test_large_teams_keep_the_order_of_passing_where_the_sea_carries_them(changes, order):
    scenario = load_scenario("reef_fleet", fleet=fleet_of(12), **changes)
    assert scenario.execution.order == order
    again = validate_model(Scenario, scenario.model_dump(mode="json"))
    assert again == scenario
    # A table made anew from the file's keys is resolved by its own team.
    small = {**scenario_table(scenario), "fleet": fleet_of(2)}
    assert validate_model(Scenario, small).execution.order == "free"


def test_a_policy_of_the_callers_takes_the_place_of_an_order_by_auto():
    given = Mppi()
    scenario = load_scenario("reef_fleet", fleet=fleet_of(12))
    assert isinstance(resolve_policy(scenario, None), Online)
    assert resolve_policy(scenario, given) is given
    stored = validate_model(Scenario, scenario.model_dump(mode="json"))
    assert resolve_policy(stored, given) is given
    requested = load_scenario("reef_fleet", fleet=fleet_of(12), execution={"order": "kept"})
    with pytest.raises(ConfigError, match=r"policy Mppi: the scenario's execution\.order"):
        resolve_policy(requested, given)


def test_a_stored_scenario_keeps_what_auto_resolved_to_then(monkeypatch):
    scenario = load(64)
    stored = scenario.model_dump(mode="json")
    assert (stored["planner"]["name"], stored["planner"]["requested"]) == ("priority", "auto")
    monkeypatch.setattr("angler_mjx.planning.planner_choice.LARGE_TEAM", 65)
    assert load(64).planner.name == "grid"
    again = validate_model(Scenario, stored)
    assert again == scenario
    assert again.planner.name == "priority"


def test_cells_of_a_sweep_are_resolved_each_by_its_own_team():
    table = scenario_table(load_scenario("reef_fleet", planner={"margin_m": 0.2}))
    axes = sweep_axes.parse_axes(["fleet.0.count=1,30"])
    found = [cell.scenario.planner for cell in build_cells(table, axes, "reef_fleet")]
    assert [one.name for one in found] == ["grid", "priority"]
    assert [one.margin_m for one in found] == [0.2, 0.2]
    axes = sweep_axes.parse_axes(["fleet.0.count=30", "planner.name=grid,auto"])
    named = [cell.scenario.planner.name for cell in build_cells(table, axes, "reef_fleet")]
    assert named == ["grid", "priority"]


def test_settings_of_either_planner_may_stand_beside_auto():
    both = {"grid": {"start_hold_s": 2.0}, "priority": {"budget": 4}}
    assert load(2, **both).planner.planner_spec().settings == {"start_hold_s": 2.0}
    assert load(64, **both).planner.planner_spec().settings == {"budget": 4}
    for robots in (2, 64):  # also of the one that is not chosen
        with pytest.raises(ConfigError, match=r"\[planner\.priority\] 'budge'"):
            load(robots, priority={"budge": 4})
        with pytest.raises(ConfigError, match=r"\[planner\.current\]"):
            load(robots, current={"budget": 4})


def test_a_name_that_code_puts_in_place_of_the_resolved_one_holds():
    scenario = load(64)
    planner = scenario.planner.model_copy(update={"name": "current"})
    other = scenario.model_copy(update={"planner": planner})
    again = validate_model(Scenario, other.model_dump(mode="json"))
    assert again == other
    assert again.planner.planner_spec().reference.name == "current"
    assert notices.run_notices(again) == ["order: kept (auto: 64 robots)"]


def test_where_no_team_is_known_the_name_is_refused():
    with pytest.raises(ConfigError, match=r"'auto': is chosen in a scenario.*grid or priority"):
        register.find("auto")


def test_no_shipped_scenario_of_a_crossing_names_a_planner():
    for name in ("reef_fleet", "dense_dynamic", "heterogeneous", "open_water_current"):
        assert "planner" not in tomllib.loads(find_scenario(name).read_text(encoding="utf-8"))
        assert load_scenario(name).planner.requested == "auto"
