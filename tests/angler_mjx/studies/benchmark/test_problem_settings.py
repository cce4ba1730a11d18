"""What a benchmark file may say, and the problems that come of it."""

import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from angler_mjx.errors import ConfigError
from angler_mjx.scenario.editing import merge_tables
from angler_mjx.scenario.scenario import shipped_scenarios
from angler_mjx.sim.information import Information
from angler_mjx.studies.benchmark import problem_settings

FILE = """
name = "x"
scenario = "reef_fleet"
problems = 2
{more}

[[planner]]
name = "grid"
"""


def read(tmp_path, more="", planner=""):
    file = tmp_path / "x.toml"
    file.write_text(FILE.format(more=more) + planner)
    return problem_settings.read_benchmark(file)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("teams = [0]", r"teams\[0\] = 0"),
        ("teams = [2, 2]", "teams: 2 is there twice"),
        ('presets = ["reaf"]', "'reaf' is no preset; there are angler2024"),
        ("nonsense = 1", "nonsense = 1: unknown key"),
        ("close_after = -1", "close_after = -1"),
        ("set.worlds = 5", "set.worlds: give problems instead"),
        ('set.policy.name = "mppi"', r"set.policy.name: give policy in \[\[planner\]\] instead"),
        ("set.planner.replan_hz = 1.0", r"set.planner.replan_hz: give replan_hz in "),
        (
            '[[scene]]\nname = "a"\nset.planner.information.obstacles = "truth"',
            r"set.planner.information: give \[\[information\]\] instead",
        ),
        ("set.world.density = 3.0", r"x.toml \(as it is\).*world.density = 3.0"),
        ('information = [{obstacles = "all"}]', r"information\[0\].obstacles = 'all'"),
        ('information = [{current = "truth"}]', "planner 'grid'.*plans in still water"),
        (
            "set.world = {cell_m = 0.1, obstacles = {dynamic = {count = 0}}}\nteams = [3]",
            r"x.toml \(as it is\).*world, for the fleet: robot radius",
        ),
        ('[[scene]]\nname = "a"\n[[scene]]\nname = "a"', "scene.name: 'a' is there twice"),
    ],
)
def test_a_wrong_file_is_one_message_that_names_file_key_and_value(tmp_path, more, said):
    with pytest.raises(ConfigError, match=re.compile(said, re.S)) as told:
        read(tmp_path, more)
    assert "x.toml" in str(told.value)


@pytest.mark.parametrize(
    ("planner", "said"),
    [
        ('[[planner]]\nname = "gird"', "unknown planner 'gird'; there is grid"),
        ('[[planner]]\nname = "grid"', "planner.label: 'grid' is there twice"),
        ('[[planner]]\nname = "grid"\nlabel = "b"\nsettings.x = 1', "no setting of this planner"),
        ('[[planner]]\nname = "no.py:Such"', "no.py cannot be read"),
        (
            '[[planner]]\nname = "RRTConnect"\nreplan_hz = 1.0',
            "planner 'RRTConnect, 1 Hz': planner.replan_hz = 1: .*plans on the host.*take grid, ",
        ),
        (
            '[[planner]]\nname = "grid"\nreplan_hz = 3.0',
            r"planner 'grid, 3 Hz'.*\n.*planner.replan_hz = 3: .*must be a whole number",
        ),
        (
            '[[planner]]\nname = "grid"\ndelay_s = 1.0',
            "delay_s = 1: there is no replanning",
        ),
        ('[[planner]]\nname = "grid"\norder = "keep"', r"planner\[1\].order = 'keep'"),
        ('[[planner]]\npolicy = "mpi"', r"policy = 'mpi': no such policy; give none, mppi"),
        ('[[planner]]\npolicy = "none"', r"policy = 'none': nobody flies by it"),
        ('[[planner]]\nname = "mppi"', r"name = 'mppi': is a policy; give policy = 'mppi'"),
        ('[[planner]]\nlabel = "x"', r"planner\[1\]: name is missing"),
        (
            '[[planner]]\npolicy = "mppi"\nsettings = { smples = 3 }',
            "policy.mppi.smples = 3: unknown key",
        ),
        (
            '[[planner]]\npolicy = "mppi"\nreplan_hz = 1.0',
            "replan_hz = 1.0: policy = 'mppi' flies without plans; leave out replan_hz",
        ),
        ('[[planner]]\nname = "priority"\npresets = ["reaf"]', "'reaf' is no preset"),
    ],
)
def test_a_wrong_planner_is_told_before_anything_is_computed(tmp_path, planner, said):
    with pytest.raises(ConfigError, match=said) as told:
        read(tmp_path, planner=planner)
    assert "x.toml" in str(told.value)


def test_settings_are_all_presets_scenes_teams_seeds_and_knowledge(tmp_path):
    made = read(
        tmp_path,
        'presets = ["open", "reef"]\nteams = [1, 3]\nseeds = [4, 5]\n'
        '[[scene]]\nname = "still"\nset.world.currents = []\n[[scene]]\nname = "tide"\n',
        '[[planner]]\nname = "grid"\nlabel = "told"\nknows = {obstacles = "nothing"}\n',
    )
    assert len(made.settings) == 2 * 2 * 2 * 2
    assert [s.scene for s in made.settings[:4]] == ["open still"] * 4
    assert [s.robots for s in made.settings[:4]] == [1, 1, 3, 3]
    assert [s.seed for s in made.settings[:4]] == [4, 5, 4, 5]
    still, tide = made.settings[0].scenario, made.settings[4].scenario
    assert still.world.currents == ()
    assert len(tide.world.currents) == 2
    assert still.world.obstacles == tide.world.obstacles
    assert {s.information for s in made.settings} == {Information()}
    assert all(len(made.select_planners(s)) == 2 for s in made.settings)
    # the fleet is two Heavies and two of the smaller kind: of three, two and one
    kinds = [entry.vehicle for entry in made.settings[2].scenario.fleet for _ in range(entry.count)]
    assert kinds == ["bluerov2_heavy", "bluerov2_heavy", "bluerov2"]


@settings(max_examples=200, deadline=None)
@given(st.lists(st.integers(1, 9), min_size=1, max_size=5), st.integers(1, 40))
def test_a_team_of_another_size_is_as_near_to_its_shares_as_whole_robots_can_be(counts, robots):
    entries = [{"vehicle": str(i), "count": count} for i, count in enumerate(counts)]
    made = {
        entry["vehicle"]: entry["count"] for entry in problem_settings._scale_fleet(entries, robots)
    }
    assert sum(made.values()) == robots
    for i, count in enumerate(counts):
        assert abs(made.get(str(i), 0) - count * robots / sum(counts)) < 1.0
    assert 0 not in made.values()


def test_tables_are_merged_and_all_else_is_replaced():
    before = {"a": 1, "b": {"c": [1, 2], "d": {"e": 1}}}
    assert merge_tables(before, {"b": {"c": [], "d": {"f": 2}}, "g": {}}) == {
        "a": 1,
        "b": {"c": [], "d": {"e": 1, "f": 2}},
        "g": {},
    }
    assert before["b"]["c"] == [1, 2]


def test_a_planner_that_says_what_it_is_told_is_asked_that_alone(tmp_path):
    made = read(
        tmp_path,
        'information = [{obstacles = "truth"}]',
        'information = {obstacles = "nothing"}\n[[planner]]\nname = "RRTConnect"\n'
        '[[planner]]\nname = "RRT"\nknows = {obstacles = "truth", current = "truth"}\n',
    )
    asked = {s.information: [one.label for one in made.select_planners(s)] for s in made.settings}
    assert asked == {
        Information(obstacles="truth"): ["RRTConnect"],
        Information(): ["grid"],
        Information(obstacles="truth", current="truth"): ["RRT"],
    }


ONLINE = """
[[planner]]
name = "grid"
replan_hz = 2.0
delay_s = 0.25
order = "kept"
information = { obstacles = "observed" }

[[planner]]
policy = "mppi"
settings = { samples = 64 }
information = { obstacles = "truth", current = "predicted" }
"""


def test_the_same_planner_is_told_apart_by_how_it_is_flown(tmp_path):
    made = read(tmp_path, planner=ONLINE)
    assert [one.label for one in made.planners] == [
        "grid",
        "grid, 2 Hz, 0.25 s late, order kept",
        "mppi",
    ]


def test_who_flies_otherwise_flies_the_same_problems_by_another_scenario(tmp_path):
    made = read(tmp_path, planner=ONLINE)
    (setting, plain), (observed, online), (told, mppi) = (
        (s, one) for s in made.settings for one in made.select_planners(s)
    )
    assert setting.flown(plain) is setting.scenario
    flown = observed.flown(online)
    assert flown.planner.name == "grid"
    assert (flown.planner.replan_hz, flown.planner.delay_s) == (2.0, 0.25)
    assert flown.execution.order == "kept"
    assert flown.planner.information.to_information() == Information(obstacles="observed")
    assert flown.planner.deadline_s == setting.scenario.planner.deadline_s
    flown_by_policy = told.flown(mppi)
    assert flown_by_policy.policy.name == "mppi"
    assert flown_by_policy.policy.mppi.samples == 64
    known = flown_by_policy.policy.information
    assert known is not None
    assert known.to_information() == Information(obstacles="truth", current="predicted")
    assert not flown_by_policy.online
    digests = {one.digest() for one in (setting.scenario, flown, flown_by_policy)}
    assert len(digests) == 1


def test_a_contestant_that_steers_without_what_moves_is_named(tmp_path):
    steers = '[[planner]]\npolicy = "mppi"\n'
    (line,) = read(tmp_path, "", steers).list_blind_planners()
    assert "'mppi' flies blind" in line
    seeing = 'information = { obstacles = "observed" }\n'
    assert read(tmp_path, "", steers + seeing).list_blind_planners() == []
    with pytest.raises(ConfigError, match="'auto': is chosen in a scenario"):
        read(tmp_path, "", '[[planner]]\nname = "auto"\n')


def test_the_policy_of_the_scenario_flies_nobody_else(tmp_path):
    table = (tmp_path / "own.toml").absolute()
    text = shipped_scenarios()["reef_fleet"].read_text()
    table.write_text(f'{text}\n[policy]\nname = "mppi"\nmppi = {{ samples = 32 }}\n')
    file = tmp_path / "x.toml"
    file.write_text(FILE.format(more="").replace('"reef_fleet"', '"own.toml"') + ONLINE)
    made = problem_settings.read_benchmark(file)
    (setting, plain), _, (told, mppi) = (
        (s, one) for s in made.settings for one in made.select_planners(s)
    )
    assert setting.flown(plain).policy.name == "none"
    assert told.flown(mppi).policy.mppi.samples == 64


def test_an_entry_is_asked_its_own_presets_and_teams(tmp_path):
    table = 'presets = ["open", "reef"]\nteams = [1, 3]'
    own = '[[planner]]\nname = "priority"\npresets = ["reef"]\nteams = [3]'
    made = read(tmp_path, table, own)
    asked = {
        (s.preset, s.robots): [x.label for x in made.select_planners(s)] for s in made.settings
    }
    assert asked == {
        ("open", 1): ["grid"],
        ("open", 3): ["grid"],
        ("reef", 1): ["grid"],
        ("reef", 3): ["grid", "priority"],
    }
    only = problem_settings.read_benchmark(
        tmp_path / "x.toml", teams=(3,), presets=("reef",), problems=1
    )
    assert [(str(s), s.scenario.worlds) for s in only.settings] == [("reef, 3 robots", 1)]
    with pytest.raises(ConfigError, match=r"x.toml with other teams.*\n.*teams\[0\] = 0"):
        problem_settings.read_benchmark(tmp_path / "x.toml", teams=(0,))
    nobody = 'teams = [5]\npresets = ["reef"]'
    (tmp_path / "x.toml").write_text(FILE.format(more='presets = ["open"]') + nobody)
    with pytest.raises(ConfigError, match="no planner is asked any of them"):
        problem_settings.read_benchmark(tmp_path / "x.toml")


def horizons(benchmark):
    return {one.preset: one.scenario.time.horizon_s for one in benchmark.settings}


def test_each_preset_has_its_own_horizon_unless_the_file_gives_one(tmp_path):
    both = 'presets = ["reef", "corridor"]'
    assert horizons(read(tmp_path, both)) == {"reef": 120.0, "corridor": 240.0}
    given = read(tmp_path, f"{both}\nset.time.horizon_s = 90.0")
    assert horizons(given) == {"reef": 90.0, "corridor": 90.0}
    scene = '\n[[scene]]\nname = "a"\nset.time.horizon_s = 60.0'
    assert horizons(read(tmp_path, both + scene)) == {"reef": 60.0, "corridor": 60.0}


STRAIGHT = """
from angler_mjx import way_points


class Straight:
    def plan(self, problem):
        team = problem.team
        return [way_points([0, 60], [a, b]) for a, b in zip(team.start_m, team.goal_m)]
"""


def test_planners_are_chosen_by_name_label_file_or_policy(tmp_path, monkeypatch):
    file = tmp_path / "benchmarks" / "x.toml"
    file.parent.mkdir()
    labelled = '[[planner]]\nname = "grid"\nlabel = "far"\nsettings = { points = 8 }\n'
    file.write_text(FILE.format(more="") + '[[planner]]\nname = "priority"\n')
    (tmp_path / "straight.py").write_text(STRAIGHT)
    monkeypatch.chdir(tmp_path)

    def labels(*names):
        benchmark = problem_settings.read_benchmark(file, planners=names)
        return [planner.label for planner in benchmark.planners]

    assert labels("priority") == ["priority"]
    assert labels("straight.py:Straight", "grid") == ["Straight", "grid"]
    assert labels("mppi", "priority") == ["mppi", "priority"]
    benchmark = problem_settings.read_benchmark(file, planners=["straight.py:Straight"])
    assert benchmark.planners[0].file == tmp_path / "straight.py"
    file.write_text(FILE.format(more="") + labelled.replace("settings = { points = 8 }\n", ""))
    assert labels("far") == ["far"]
    assert labels("grid") == ["grid", "far"]
    with pytest.raises(ConfigError, match=r"x.toml: unknown planner .nonsense."):
        labels("nonsense")
