import pytest

from angler_mjx.cli import main as cli
from angler_mjx.errors import ConfigError
from angler_mjx.scenario.editing import first_changed_key
from angler_mjx.studies.fleet_size import conditions, running

FILE = """
name = "crossing"
scenario = "reef_fleet"
sizes = {sizes}
deadline_s = 100.0
{more}
[set]
fleet = [{{ vehicle = "bluerov2_heavy" }}]
"""


def read(tmp_path, sizes="[1, 2, 4]", more="", **given):
    path = tmp_path / "study.toml"
    path.write_text(FILE.format(sizes=sizes, more=more))
    return conditions.read_study(path, **given)


def test_conditions_are_all_combinations(tmp_path):
    study = read(
        tmp_path,
        more="""
condition = [{ name = "a" }, { name = "b", set = { planner = { margin_m = 0.4 } } }]
[axis.water]
still = { randomise = { current = [0.0, 0.0] } }
moving = {}
""",
    )
    names = [one.name for one in study.conditions]
    assert names == ["a, still", "a, moving", "b, still", "b, moving"]
    last = study.scenario(study.conditions[2], 4)
    assert last.planner.margin_m == 0.4
    assert last.randomise.current == (0.0, 0.0)
    assert [entry.count for entry in last.fleet] == [4]
    assert study.conditions[1].values == {"condition": "a", "water": "moving"}
    assert study.scenario(study.conditions[3], 4).randomise.current == (1.0, 1.0)


def test_a_span_begins_with_powers_of_two(tmp_path):
    study = read(tmp_path, sizes="{ from = 3, to = 20 }")
    assert study.sizes == tuple(range(3, 21))
    assert study.config.first_sizes() == (3, 4, 8, 16, 20)


def test_a_smoke_run_is_of_four_worlds_and_two_sizes(tmp_path):
    study = read(tmp_path, sizes="{ from = 3, to = 20 }", smoke=True)
    assert study.sizes == (3, 8)
    assert (study.config.budget.batch, study.config.budget.max_worlds) == (4, 4)
    with pytest.raises(ConfigError, match=r"--smoke: .*leave out --batch, --max-worlds"):
        read(tmp_path, smoke=True, batch=8, max_worlds=16, max_minutes=None)


def test_the_command_asks_what_it_was_told(tmp_path, monkeypatch):
    """Each flag of the command reaches the study; a smoke run has a folder of its own."""
    asked = []

    def run(study, source, out, **how):
        asked.append((study, out, how))
        raise ConfigError("far enough")

    monkeypatch.setattr(running, "run_study", run)
    read(tmp_path, more="condition = [{ name = 'a' }, { name = 'b' }]")
    line = ["study", "fleet_size", str(tmp_path / "study.toml")]
    for more in (["--smoke"], ["--batch", "8", "--only", "b", "--devices", "1", "--resume"]):
        with pytest.raises(SystemExit):
            cli.main([*line, *more])
    (smoke, its_place, _), (plain, place, how) = asked
    assert (smoke.sizes, smoke.config.budget.batch) == ((1, 2), 4)
    assert plain.sizes == (1, 2, 4)
    assert plain.config.budget.batch == 8
    assert [one.name for one in plain.conditions] == ["b"]
    assert (how["devices"], how["resume"]) == (1, True)
    assert str(place) == "runs/crossing"
    assert its_place != place


def test_only_some_conditions(tmp_path):
    more = "condition = [{ name = 'a' }, { name = 'b' }]"
    assert [one.name for one in read(tmp_path, more=more, only=["b"]).conditions] == ["b"]
    with pytest.raises(ConfigError, match=r"--only 'c': .*has 'a', 'b'"):
        read(tmp_path, more=more, only=["c"])


@pytest.mark.parametrize(
    ("sizes", "more", "says"),
    [
        ("[1, 4, 2]", "", "sizes.*must increase, and 2 does not"),
        ("[2, 2]", "", "must increase, and 2 does not"),
        ("[]", "", "there is none"),
        ("{ from = 4, to = 4 }", "", "to = 4: must be above from = 4"),
        ("[1]", "axis.water.fast.world.curents = []", "world.curents.*unknown key"),
        ("[1]", "set2 = {}", "set2.*unknown key"),
        ("[1]", "axis.water = {}", "axis.water: has no values"),
        ("[1]", "condition = [{ name = 'a' }, { name = 'a' }]", "'a' is there twice"),
        ("[1]", "condition = [{ name = 'a', set = { seed = 1 } }]", "set.seed: give seed instead"),
        ("[1]", "fraction = 0.5\narrivals = 1", "fraction and arrivals"),
        ("[1]", "arrivals = 2", "arrivals = 2: no team"),
        ("[1]", "size.key = 'fleet.3.count'", "size.key: .*there is no 3"),
        ("[1]", "budget = { batch = 8, max_worlds = 4 }", "must hold one batch of 8"),
        ("[1]", "probability = 1.0", "probability"),
        ("[1]", "axis.a.b.time.horizon_s = 90.0", "deadline_s = 100: worlds end after .*90"),
        ("[1]", "axis.a.b.time.horizon_s = 5.0", "deadline_s = 100: worlds end"),
        ("[1, 900]", "axis.a.b.world = { preset = 'open', shape = [8, 8, 8] }", "do not fit shape"),
    ],
)
def test_what_cannot_be_asked_is_refused(tmp_path, sizes, more, says):
    with pytest.raises(ConfigError, match=says) as caught:
        read(tmp_path, sizes=sizes, more=more)
    assert "study.toml" in str(caught.value)


def test_a_task_is_done_or_not(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(
        "name = 's'\nscenario = 'reef_survey'\nsizes = [1]\ndeadline_s = 9.0\nshare = 0.5\n"
    )
    with pytest.raises(ConfigError, match=r"fraction = 0\.5: the scenario has a task"):
        conditions.read_study(path)


def test_the_same_study_is_known_again(tmp_path):
    one = read(tmp_path).resolved()
    assert first_changed_key(one, read(tmp_path, max_minutes=3.0).resolved()) is None
    assert first_changed_key(read(tmp_path, sizes="[1, 2]").resolved(), one) == "study.sizes"
    assert first_changed_key(read(tmp_path, batch=8).resolved(), one) == "study.budget.batch"
    other = read(tmp_path, more="axis.a.b.world.density = 0.1")
    assert first_changed_key(other.resolved(), one) == "study.axis.a"
