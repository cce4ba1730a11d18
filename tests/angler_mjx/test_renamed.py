"""Keys, flags and attributes by their names before 0.2: read, with a message that names today's."""

import contextlib
import importlib
import pkgutil
import warnings
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import angler_mjx
from angler_mjx.cli.main import main
from angler_mjx.errors import ConfigError, UnsupportedError
from angler_mjx.files import FileModel, RenamedKeyWarning, parse_model
from angler_mjx.robot.control.commands import BodyTwist
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.fleet_entry import FleetEntry
from angler_mjx.scenario.randomise_table import RandomiseConfig
from angler_mjx.scenario.scenario import find_scenario, load_scenario
from angler_mjx.scenario.tables import PlannerConfig
from angler_mjx.scenario.task_table import TourTask
from angler_mjx.sim.information import Information
from angler_mjx.sim.policy import Policy, PolicyInput
from angler_mjx.world.acoustics.channel import HeardRobots


def models():
    """Every model of a file that has renamed keys."""
    for module in pkgutil.walk_packages(angler_mjx.__path__, "angler_mjx."):
        with contextlib.suppress(UnsupportedError):  # of optional packages that are not installed
            importlib.import_module(module.name)
    pending, seen = [FileModel], set()
    while pending:
        for kind in pending.pop().__subclasses__():
            if kind not in seen:
                seen.add(kind)
                pending.append(kind)
    return [kind for kind in seen if "renamed_keys" in kind.__dict__]


def test_every_renamed_key_leads_to_a_field():
    found = models()
    assert len(found) > 5
    for kind in found:
        for old, new in kind.renamed_keys.items():
            assert new in kind.model_fields, (kind, new)
            assert old not in kind.model_fields, (kind, old)


def test_an_old_key_is_read_and_named():
    with pytest.warns(RenamedKeyWarning, match=r"a\.toml: key knows is information since 0\.2"):
        planner = parse_model(PlannerConfig, {"knows": {"obstacles": "truth"}}, source="a.toml")
    assert planner.information.obstacles == "truth"
    with pytest.warns(RenamedKeyWarning, match=r"PlannerConfig\.knows is information"):
        assert planner.knows == planner.information
    with pytest.raises(AttributeError):
        _ = planner.knowledge


def test_what_a_program_wrote_is_read_without_a_word():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        planner = parse_model(
            PlannerConfig, {"knows": {"obstacles": "truth"}}, source="config.json"
        )
    assert planner.information.obstacles == "truth"


@pytest.mark.parametrize(
    ("model", "table", "old", "new", "value"),
    [
        (
            FleetEntry,
            {"vehicle": "bluerov2", "fault_known": False},
            "fault_known",
            "fault_visible",
            False,
        ),
        (RandomiseConfig, {"known": True}, "known", "visible", True),
        (TourTask, {"type": "tour", "places": 5}, "places", "positions", 5),
        (
            TourTask,
            {"type": "tour", "places_m": [[0.0, 1.0, -5.0]]},
            "places_m",
            "positions_m",
            ((0.0, 1.0, -5.0),),
        ),
    ],
)
def test_keys_of_scenarios_are_read_by_their_old_names(model, table, old, new, value):
    with pytest.warns(RenamedKeyWarning, match=rf"a\.toml: key {old} is {new} since 0\.2"):
        entry = parse_model(model, table, source="a.toml")
    assert getattr(entry, new) == value


def test_old_and_new_keys_pose_the_same_problems():
    tour = {"type": "tour", "within": [[0.0, 0.0, 0.0], [1.0, 1.0, 0.5]]}
    by_new = load_scenario("reef_fleet", task={**tour, "positions": 3}, randomise={"visible": True})
    with pytest.warns(RenamedKeyWarning):
        by_old = load_scenario("reef_fleet", task={**tour, "places": 3}, randomise={"known": True})
    assert by_old.digest() == by_new.digest()


def test_a_key_by_both_names_is_refused():
    table = {"knows": {}, "information": {}}
    with pytest.raises(ConfigError, match=r"knows is information since 0\.2; give information"):
        parse_model(PlannerConfig, table, source="a.toml")


def test_flags_win_over_an_old_key_of_the_file(tmp_path):
    file = tmp_path / "own.toml"
    text = (load_text("dense_dynamic")) + '[planner]\nknows = { obstacles = "truth" }\n'
    file.write_text(text)
    with pytest.warns(RenamedKeyWarning, match="knows"):
        scenario = load_scenario(file, planner={"information": {"obstacles": "observed"}})
    assert scenario.planner.information.obstacles == "observed"


def load_text(name):
    """Text of a shipped scenario without its planner."""
    text = find_scenario(name).read_text()
    assert "[planner]" not in text
    return text


def test_an_old_flag_is_read_and_named(tmp_path, capsys):
    with pytest.raises(SystemExit) as end:
        main(["plan", "dense_dynamic", "--knows", "obstacles=some", "--out", str(tmp_path / "p")])
    assert end.value.code == 2
    said = capsys.readouterr().err
    assert "--knows is --information since 0.2" in said
    assert "--information 'obstacles=some'" in said


def test_seeds_of_controllers_are_read_by_the_old_flags(capsys):
    with pytest.raises(SystemExit):
        main(["control", "--controller", "cascade", "--draws", "-1"])
    said = capsys.readouterr().err
    assert "--draws is --samples since 0.2" in said
    assert "--samples, --sample: give 0 or more" in said


def test_a_policy_with_the_attributes_of_before_works_and_is_named():
    with pytest.warns(DeprecationWarning, match="policy Drift: ") as caught:

        @jax.tree_util.register_dataclass
        @dataclass(frozen=True)
        class Drift(Policy):
            """As docs/reference/policies.md printed it for 0.1."""

            knows: Information = field(
                default=Information(obstacles="observed"), metadata={"static": True}
            )
            looks: int = field(default=2, metadata={"static": True})

            def says(self, carry):
                return carry

            def act(self, carry, known, key, step):
                return carry, BodyTwist(jnp.zeros((known.goal_m.shape[0], 6)))

    messages = [str(one.message) for one in caught]
    for old, new in {
        "knows": "information",
        "looks": "observation_period",
        "says": "payload",
    }.items():
        assert any(f"policy Drift: {old} is {new} since 0.2" in text for text in messages)
    policy = Drift()
    assert (policy.information.obstacles, policy.observation_period) == ("observed", 2)
    assert policy.payload(3) == 3
    simulator = Simulator(load_scenario("dense_dynamic", worlds=1), policy=policy)
    assert simulator.scenario.name == "dense_dynamic"


def test_inputs_of_policies_answer_to_their_names_of_before():
    inputs = PolicyInput(
        belief=None, time_s=None, goal_m=None, path=None, params=None, goal_index=4
    )
    with pytest.warns(DeprecationWarning, match=r"PolicyInput\.place is goal_index"):
        assert inputs.place == 4
    with pytest.raises(AttributeError, match="no attribute 'places'"):
        _ = inputs.places


def test_received_positions_are_extrapolated_by_their_name_of_before():
    heard = HeardRobots(
        p_m=np.zeros((2, 2, 3)),
        v_mps=np.ones((2, 2, 3)),
        time_s=np.zeros((2, 2)),
        is_heard=np.ones((2, 2), bool),
    )
    with pytest.warns(DeprecationWarning, match="place_m is extrapolate_m since 0.2"):
        assert np.array_equal(heard.place_m(2.0), heard.extrapolate_m(2.0))
