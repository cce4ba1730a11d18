"""The door for planners: names, settings, what is asked, and what the docs promise."""

import pickle
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

import angler_mjx as angler
from angler_mjx.errors import ConfigError, UnsupportedError
from angler_mjx.planning import register
from angler_mjx.planning.planner import PathShape
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.testing import NonConformanceError, check_planner

DOCS = Path(__file__).parents[3] / "docs" / "tutorials" / "own_planner.md"
SNIPPETS = re.findall(r"```python\n(.*?)```", DOCS.read_text(), re.S)


@pytest.fixture
def straight(tmp_path):
    """The planner of ten lines, as the docs have it, in a file."""
    file = tmp_path / "straight.py"
    file.write_text(SNIPPETS[0])
    return file


@pytest.fixture(scope="module")
def planned_simulator(scenario):
    return angler.Simulator(scenario, tile=2, paths=PathShape(points=2))


@pytest.fixture(scope="module")
def problems(planned_simulator):
    """Two worlds, with time enough to cross them."""
    return [replace(one, horizon_s=60.0) for one in planned_simulator.problems(0, 2)]


def written(tmp_path, text):
    file = tmp_path / "scenario.toml"
    file.write_text(
        'name = "x"\n[world]\npreset = "open"\n[[fleet]]\nvehicle = "bluerov2"\n' + text
    )
    return file


def test_a_file_is_found_from_the_scenarios_folder(tmp_path, straight):
    file = written(tmp_path, '[planner]\nname = "./straight.py:Straight"\n')
    spec = load_scenario(file).planner.planner_spec()
    assert spec.reference.file == straight
    assert type(spec.make()).__name__ == "Straight"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("gird", "unknown planner 'gird'; there is grid"),
        ("./none.py:Straight", r"none\.py cannot be read"),
        ("./straight.py:Bent", "holds no 'Bent'; classes there: Straight"),
    ],
)
def test_what_is_no_planner_is_named(tmp_path, straight, name, said):
    with pytest.raises(ConfigError, match=said):
        load_scenario(written(tmp_path, f'[planner]\nname = "{name}"\n'))


def test_a_missing_library_is_named(monkeypatch):
    monkeypatch.setattr(
        register, "_installed_planners", lambda: {"Odd": "angler_mjx_no_such_thing:Odd"}
    )
    with pytest.raises(UnsupportedError, match="needs angler_mjx_no_such_thing"):
        register.find("Odd").load()


SETTINGS = """
from dataclasses import dataclass


class Careful:
    @dataclass(frozen=True)
    class Settings:
        gap_m: float = 0.5

    def __init__(self, settings):
        self.gap_m = settings.gap_m
"""


def test_settings_stand_in_the_table_of_the_planners_name(tmp_path):
    (tmp_path / "careful.py").write_text(SETTINGS)
    table = '[planner]\nname = "careful.py:Careful"\n[planner.Careful]\n'
    spec = load_scenario(written(tmp_path, table + "gap_m = 0.75\n")).planner.planner_spec()
    assert spec.make().gap_m == 0.75
    for text, said in (
        ("gap = 1.0\n", r"\[planner\.Careful\] 'gap': no setting of this planner; there is gap_m"),
        ('gap_m = "wide"\n', r"\[planner\.Careful\] gap_m = 'wide'"),
        ('gap_m = "0.75"\n', r"\[planner\.Careful\] gap_m = '0.75'"),
        ("gap_m = nan\n", r"\[planner\.Careful\] gap_m = nan"),
        ("[planner.grid]\nstart_hold_s = 1.0\n", r"\[planner\.grid\]: the planner is .*Careful"),
    ):
        with pytest.raises(ConfigError, match=said):
            load_scenario(written(tmp_path, table + text))


LOADED = """
import pickle, sys
kind = pickle.load(sys.stdin.buffer).load()
print(kind.__name__, callable(kind.plan))
"""


def test_a_file_that_is_edited_is_another_planner(straight):
    before = register.find(f"{straight}:Straight")
    kind = before.load()
    straight.write_text("edited: no Python\n")
    with pytest.raises(ConfigError, match=r"straight\.py: cannot be run \(SyntaxError: .*py:1\)"):
        register.find(f"{straight}:Straight").load()
    # What was chosen before the edit is made of the text of that time, in any process.
    there = pickle.dumps(before)
    made = subprocess.run(
        [sys.executable, "-c", LOADED], input=there, capture_output=True, check=False
    )
    assert made.stdout.decode() == "Straight True\n", made.stderr.decode()
    straight.write_text(SNIPPETS[0] + "\n# edited\n")
    assert register.find(f"{straight}:Straight").load() is not kind


def test_settings_or_class_say_that_paths_have_headings(tmp_path):
    pytest.importorskip("ompl", reason="needs the extra plan: OMPL")
    for heading in ("true", "false"):
        table = f'[planner]\nname = "RRTConnect"\n[planner.RRTConnect]\nheading = {heading}\n'
        spec = load_scenario(written(tmp_path, table)).planner.planner_spec()
        assert register.plans_joints(spec) is (heading == "true")
    (tmp_path / "turning.py").write_text("class Turning:\n    joints = True\n")
    spec = load_scenario(written(tmp_path, '[planner]\nname = "turning.py:Turning"\n'))
    assert register.plans_joints(spec.planner.planner_spec())


def test_the_grid_planner_refuses_what_it_cannot_use(tmp_path):
    file = written(tmp_path, '[planner.information]\nobstacles = "truth"\ncurrent = "truth"\n')
    with pytest.raises(
        ConfigError, match=r'planner\.information\.current = "truth": the planner grid'
    ):
        angler.Simulator(load_scenario(file, worlds=1))


def test_the_digest_is_of_what_draws_problems():
    base = load_scenario("reef_fleet")
    same = load_scenario("reef_fleet", worlds=9, engine="fused", controller={"name": "tracking"})
    other = load_scenario("reef_fleet", world={"placement": "parallel"})
    assert base.digest() == same.digest()
    assert base.digest() != other.digest()


def straight_class():
    space = {}
    exec(SNIPPETS[0], space)
    return space["Straight"]


def test_the_planner_of_the_docs_conforms(problems):
    check_planner(straight_class(), problems)


def test_what_no_planner_may_do_is_seen(problems):
    kind = straight_class()

    class Drifting(kind):
        calls = 0

        def plan(self, problem):
            self.calls += 1
            paths = super().plan(problem)
            return [replace(path, time_s=path.time_s * (1 + 0.01 * self.calls)) for path in paths]

    class Spoiling(kind):
        def plan(self, problem):
            paths = super().plan(problem)
            problem.team.goal_m[:] = 0.0
            return paths

    class Hasty(kind):
        def plan(self, problem):
            return [replace(path, time_s=path.time_s * 0.5) for path in super().plan(problem)]

    own = [jax.tree.map(np.array, problem) for problem in problems]
    for bad, said in (
        (Drifting, "gives another plan after"),
        (Spoiling, "changed the problem's arrays"),
        (Hasty, "its cruise speed"),
    ):
        with pytest.raises(NonConformanceError, match=said):
            check_planner(bad, own)


def test_what_is_asked_is_the_world(problems, planned_simulator):
    worlds = planned_simulator.worlds(0)
    for i, problem in enumerate(problems):
        np.testing.assert_array_equal(problem.team.goal_m, worlds.environment.goal_m[i])
        np.testing.assert_array_equal(problem.grid.occupied, worlds.environment.grid.occupied[i])
        assert problem.name.world == i
    assert len({int(problem.seed) for problem in problems}) == len(problems)


SWINGING = """
[time]
horizon_s = 10.0
[[world.obstacles.explicit]]
type = "sphere"
position_m = [0.0, 0.0, -8.0]
radius_m = 0.4
motion = { type = "sine", amplitude_m = [1.0, 0.0, 0.5], period_s = 9.0 }
[planner.information]
obstacles = "%s"
"""


def test_a_script_that_nobody_knows_is_predicted_straight_on(tmp_path):
    told = {}
    for level in ("predicted", "truth"):
        scenario = load_scenario(written(tmp_path, SWINGING % level), worlds=1)
        simulator = angler.Simulator(scenario, paths=PathShape(points=2))
        told[level] = simulator.problems(0, 1)[0].obstacles
    predicted, truth = told["predicted"], told["truth"]
    # A sine from its middle begins with 2 pi / 9 s times its amplitude.
    velocity = 2 * np.pi / 9.0 * np.array([1.0, 0.0, 0.5])
    np.testing.assert_allclose(predicted.velocity_mps[0], velocity, atol=1e-5)
    straight = np.array([0.0, 0.0, -8.0]) + predicted.time_s[:, None] * velocity
    np.testing.assert_allclose(predicted.p_m[0], straight, atol=1e-4)
    swing = np.sin(2 * np.pi / 9.0 * truth.time_s)[:, None] * np.array([1.0, 0.0, 0.5])
    np.testing.assert_allclose(truth.p_m[0], np.array([0.0, 0.0, -8.0]) + swing, atol=1e-4)
