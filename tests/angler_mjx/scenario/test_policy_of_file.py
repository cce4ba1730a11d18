"""Policies that a scenario names FILE.py:CLASS."""

import numpy as np
import pytest

import angler_mjx as angler
from angler_mjx.cli.main import main
from angler_mjx.errors import ConfigError
from angler_mjx.files import parse_model
from angler_mjx.scenario.editing import scenario_table
from angler_mjx.scenario.policy_of_file import build_policy_of_file
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.information import Information
from angler_mjx.sim.policy import describe_policy
from angler_mjx.user_classes import load_class

TEXT = """
from dataclasses import dataclass, field
from typing import Any
import jax, jax.numpy as jnp
import angler_mjx as angler
from angler_mjx.sim.information import Information

@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Straight(angler.Policy):
    speed_mps: Any = 0.4

    def act(self, carry, inputs, key, step):
        offset = inputs.goal_m - inputs.belief.p
        v = self.speed_mps * offset / jnp.linalg.norm(offset, axis=-1, keepdims=True)
        yaw = jnp.zeros(len(offset))
        return carry, angler.PoseTarget(position_m=inputs.belief.p + v, velocity_mps=v, yaw_rad=yaw)

@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Watching(Straight):
    information: Information = field(
        default=Information(obstacles="observed"), metadata={"static": True}
    )

@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Fixed(Straight):
    @property
    def information(self):
        return Information(obstacles="predicted")

class Unregistered(angler.Policy):
    def act(self, carry, inputs, key, step):
        return carry, None

class Planner:
    def plan(self, problem):
        return []
"""
SMALL = {"worlds": 2, "tile": 2, "time": {"horizon_s": 4.0, "record_hz": 2.0}}


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(TEXT)
    return path


def fly(out, table, **more):
    scenario = angler.load_scenario("open_water_current", policy=table, **SMALL)
    return angler.rollout(scenario, out=out, **more)


def ends(run):
    return np.asarray(run.trajectories["end/p_m"][:])


def test_a_policy_of_a_file_flies_as_its_object_does(tmp_path, file):
    policy = {"name": f"{file}:Straight", "Straight": {"speed_mps": 0.2}}
    named = fly(tmp_path / "named", policy)
    built = load_class(f"{file}:Straight", "policy")(speed_mps=0.2)
    given = fly(tmp_path / "given", {"name": "none"}, policy=built)
    np.testing.assert_array_equal(ends(named), ends(given))
    # Another text of the same class is another program.
    file.write_text(TEXT.replace("v = self", "v = -self"))
    edited = fly(tmp_path / "edited", policy)
    assert np.linalg.norm(ends(edited) - ends(named), axis=-1).min() > 0.5
    # Each run keeps what it flew, wherever the file went.
    file.unlink()
    kept = angler.Run(tmp_path / "named").scenario.policy
    assert kept.name.startswith(str(tmp_path / "named" / "inputs"))
    again = kept.build_of_file()
    assert describe_policy(again) == describe_policy(built)


def test_the_file_is_looked_for_beside_the_scenario(tmp_path, file, capsys, monkeypatch):
    main(["scenarios", "show", "open_water_current"])
    path = tmp_path / "sub" / "mine.toml"
    path.parent.mkdir()
    path.write_text(capsys.readouterr().out + '\n[policy]\nname = "../mine.py:Straight"\n')
    scenario = angler.load_scenario(path)
    assert scenario.policy.name.endswith("mine.py:Straight")
    assert scenario.policy.title == "Straight"
    assert scenario.policy.file is not None
    assert scenario.policy.file.resolve() == file
    assert scenario.has_user_code
    # One that a caller names stands in the working directory.
    monkeypatch.chdir(tmp_path)
    named = angler.load_scenario(path, policy={"name": "mine.py:Straight"})
    assert named.policy.name == f"{file}:Straight"


def test_tables_of_a_class_stay_where_plans_are_flown(file):
    table = {"name": "none", "Straight": {"speed_mps": 0.2}}
    policy = angler.load_scenario("open_water_current", policy=table).policy
    assert policy.file is None
    assert policy.settings == {"Straight": {"speed_mps": 0.2}}


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        ({"name": "mpi"}, r"policy.name .*= 'mpi': no such policy; give none, mppi, routes, reach"),
        ({"name": "mppi", "mpi": {}}, r"policy.mpi.*unknown key"),
        ({"name": "FILE:Nobody"}, "holds no class 'Nobody'"),
        ({"name": "FILE:Planner"}, "is no class of angler_mjx.Policy"),
        ({"name": "FILE:Unregistered"}, "is no pytree; decorate it"),
        (
            {"name": "FILE:Straight", "Straight": {"sped": 1.0}},
            r"cannot be made of \[policy.Straight\].*sped",
        ),
        (
            {"name": "FILE:Straight", "Strait": {"speed_mps": 1.0}},
            r"Strait: policy.name is .*settings stand in \[policy.Straight\]",
        ),
        (
            {"name": "FILE:Fixed", "information": {"obstacles": "observed"}},
            "asks for information.obstacles = 'predicted', and 'observed' is given",
        ),
    ],
)
def test_what_is_wrong_is_named(file, policy, message):
    policy = policy | {"name": policy["name"].replace("FILE", str(file))}
    with pytest.raises(ConfigError, match=message):
        angler.load_scenario("open_water_current", policy=policy)


def test_the_information_level_is_that_of_the_class_or_of_the_table(file):
    def level(name, **table):
        scenario = angler.load_scenario(
            "open_water_current", policy={"name": f"{file}:{name}", **table}
        )
        information = scenario.policy.information
        # A table that is made of it, as benchmarks do, has the same level.
        again = parse_model(Scenario, scenario_table(scenario), source="again")
        assert again.policy.information == information
        assert scenario.policy.build_of_file().information in (
            None,
            information.to_information(),
        )
        return information.obstacles, information.current

    assert level("Straight") == ("nothing", "nothing")
    assert level("Watching") == ("observed", "nothing")
    truth = {"obstacles": "truth", "current": "observed"}
    assert level("Watching", information=truth) == ("truth", "observed")
    assert level("Fixed") == ("predicted", "nothing")
    # What a class does not ask for it does not get, whatever the table allows.
    assert level("Straight", information=truth) == ("nothing", "nothing")
    assert level("Fixed", information=truth) == ("predicted", "nothing")
    # A class with a level of its own flies where no less is given.
    fixed = build_policy_of_file(f"{file}:Fixed", {}, Information(obstacles="truth"))
    assert fixed.information == Information(obstacles="predicted")


def test_a_raising_constructor_is_named_with_its_line(file):
    default = "    speed_mps: Any = 0.4\n"
    method = "\n    def __post_init__(self):\n        raise KeyError('weights')\n"
    file.write_text(TEXT.replace(default, default + method))
    with pytest.raises(ConfigError, match=r"KeyError: 'weights' \(mine.py:14\)"):
        build_policy_of_file(f"{file}:Straight", {}, None)
