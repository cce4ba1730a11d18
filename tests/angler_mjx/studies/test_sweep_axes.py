"""What a sweep varies: the syntax of its keys and values, and what is refused before any flight."""

import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.scenario.editing import scenario_table, set_value
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.studies.sweep import build_cells
from angler_mjx.studies.sweep_axes import parse_axes, parse_axis


@pytest.fixture(scope="module")
def table():
    return scenario_table(load_scenario("reef_fleet", worlds=4, time={"record_hz": 0.0}))


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("a.b=1,2,4", (1, 2, 4)),
        ("a=0.5, 1e-3", (0.5, 0.001)),
        ("a=true,false", (True, False)),
        ("a=truth,noisy,ekf", ("truth", "noisy", "ekf")),
        ('a="with, comma",plain', ("with, comma", "plain")),
        ("a=[0.9, 1.1],[0.8,1.2]", ([0.9, 1.1], [0.8, 1.2])),
        ("a=[],[{ type = 'uniform', velocity_mps = [0.2, 0, 0] }]",
         ([], [{"type": "uniform", "velocity_mps": [0.2, 0, 0]}])),
        ("a=my/planner.py:Class", ("my/planner.py:Class",)),
        ("a=1,1.0", (1, 1.0)),
    ],
)  # fmt: skip
def test_values_are_written_as_in_a_scenario_file(text, values):
    assert parse_axis(text).values == values


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["a"], "--set 'a': give KEY=VALUE"),
        (["a..b=1"], "--set 'a..b=1': give KEY=VALUE"),
        (["a=1,,2"], "--set a: a value is missing"),
        (["a=[1,2"], "']' is missing at the end"),
        (["a=1]"], "']' closes nothing"),
        (["a='x"], '"\'" is missing at the end'),
        (["a=1,1"], "--set a=1: is there twice"),
        (["a=two words"], "'two words' is no value"),
        (["a=1", "a=2"], "--set a: is there twice; give all its values in one"),
        (["fleet.0=1", "fleet.0.count=2"], "--set fleet.0.count: lies within fleet.0"),
        (["seed=1,2"], "--set seed: give --seed"),
        (["worlds=1,2"], "--set worlds: give --worlds"),
        ([], "--set: nothing is varied"),
    ],
)
def test_what_is_no_axis_is_refused_by_name(given, said):
    with pytest.raises(ConfigError) as caught:
        parse_axes(given)
    assert said in str(caught.value)


def test_all_wrong_axes_are_told_at_once():
    with pytest.raises(ConfigError) as caught:
        parse_axes(["a", "b=", "seed=1"])
    assert len(str(caught.value).splitlines()) == 3


def test_the_last_axis_changes_fastest(table):
    made = build_cells(
        table, parse_axes(["fleet.0.count=1,3", "fleet.0.estimate=truth,ekf"]), "reef_fleet"
    )
    assert [dict(cell.values) for cell in made] == [
        {"fleet.0.count": 1, "fleet.0.estimate": "truth"},
        {"fleet.0.count": 1, "fleet.0.estimate": "ekf"},
        {"fleet.0.count": 3, "fleet.0.estimate": "truth"},
        {"fleet.0.count": 3, "fleet.0.estimate": "ekf"},
    ]
    assert [len(cell.scenario.members()) for cell in made] == [3, 3, 5, 5]
    assert [cell.scenario.senses for cell in made] == [False, True, False, True]
    assert len({cell.path for cell in made}) == 4
    assert {(cell.scenario.worlds, cell.scenario.seed) for cell in made} == {(4, 7)}


def test_another_preset_brings_its_own_horizon_unless_one_is_set(table):
    own = load_scenario("reef_fleet").time.horizon_s
    alone = build_cells(table, parse_axes(["world.preset=reef,corridor"]), "reef_fleet")
    assert alone[0].scenario.time.horizon_s == own
    assert alone[1].scenario.time.horizon_s != own
    given = build_cells(
        table, parse_axes(["world.preset=reef,corridor", "time.horizon_s=90"]), "reef_fleet"
    )
    assert [cell.scenario.time.horizon_s for cell in given] == [90.0, 90.0]


def test_every_fault_of_every_cell_is_told_once_with_its_setting(table):
    given = ["fleet.0.count=1,-2", "fleet.0.estimate=truth,noise", "time.horizn_s=2"]
    with pytest.raises(ConfigError) as caught:
        build_cells(table, parse_axes(given), "reef_fleet")
    lines = str(caught.value).splitlines()
    assert lines[0] == "reef_fleet: 3 faults"
    assert "time.horizn_s = 2: unknown key; remove it or correct spelling and unit" in lines[1]
    assert "--set" not in lines[1]
    assert lines[2].endswith("(--set fleet.0.estimate=noise)")
    assert lines[3].endswith("(--set fleet.0.count=-2)")


@pytest.mark.parametrize(
    ("key", "said"),
    [
        ("fleet.2.count", "fleet is a list with entries 0 to 1; there is no 2"),
        ("fleet.x.count", "there is no x"),
        ("seed.x", "seed = 7 is no table"),
    ],
)
def test_a_key_that_leads_nowhere_is_refused(table, key, said):
    with pytest.raises(ConfigError) as caught:
        set_value(table, key, 1)
    assert said in str(caught.value)


def test_a_star_stands_for_all_entries_of_a_list(table):
    made = set_value(table, "fleet.*.estimate", "ekf")
    assert [one["estimate"] for one in made["fleet"]] == ["ekf", "ekf"]
    assert "estimate" not in table["fleet"][0]
    (cell,) = build_cells(table, parse_axes(["fleet.*.cruise_speed_mps=0.4"]), "reef_fleet")
    assert [one.cruise_speed_mps for one in cell.scenario.fleet] == [0.4, 0.4]


def test_settings_of_a_planner_stand_by_its_name_beside_those_it_has(table):
    before = set_value(table, "planner.settings", {"RRTConnect": {"range_m": 2.0}})
    made = set_value(before, "planner.RRTConnect.goal_bias", 0.1)
    assert made["planner"]["settings"] == {"RRTConnect": {"range_m": 2.0, "goal_bias": 0.1}}
    assert before["planner"]["settings"] == {"RRTConnect": {"range_m": 2.0}}


def test_what_no_robot_can_do_is_refused_before_the_flight(table):
    with pytest.raises(ConfigError, match="no robot can be at its goal by then"):
        build_cells(table, parse_axes(["time.horizon_s=120,20"]), "reef_fleet")
    with pytest.raises(ConfigError, match="the planner grid plans in still water"):
        build_cells(table, parse_axes(["planner.information.current=nothing,truth"]), "reef_fleet")
    with pytest.raises(ConfigError, match="unknown planner 'nobody'"):
        build_cells(table, parse_axes(["planner.name=grid,nobody"]), "reef_fleet")
    many = ",".join(str(i) for i in range(1, 1001))
    with pytest.raises(ConfigError, match="1,000,000 cells; 10,000 are the most"):
        build_cells(table, parse_axes([f"fleet.0.count={many}", f"tile={many}"]), "reef_fleet")
