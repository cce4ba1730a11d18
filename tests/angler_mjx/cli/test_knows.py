"""The flag --knows: what planners are told, and what is said where they are told nothing."""

import pytest

from angler_mjx.cli.main import main
from angler_mjx.cli.shared.inputs import (
    knows_given,
    planner_given,
    policy_given,
    scenario_given,
)
from angler_mjx.errors import ConfigError
from angler_mjx.files import check
from angler_mjx.scenario.editing import table_of
from angler_mjx.scenario.notices import blind
from angler_mjx.scenario.scenario import Scenario, find
from angler_mjx.sim.information import Information


def loaded(name, **keys):
    return scenario_given(name, planner=planner_given(None, **keys))


def test_levels_of_the_flag_stand_in_the_scenario():
    both = loaded("dense_dynamic", knows=knows_given("obstacles=predicted, current=truth"))
    assert (both.planner.knows.obstacles, both.planner.knows.current) == ("predicted", "truth")
    one = loaded("dense_dynamic", knows=knows_given("obstacles=observed"))
    assert (one.planner.knows.obstacles, one.planner.knows.current) == ("observed", "nothing")
    assert knows_given(None) is None


@pytest.mark.parametrize(
    "text",
    ["obstacles=all", "rocks=truth", "truth", "", "obstacles=truth,obstacles=truth", "current="],
)
def test_what_is_no_level_is_named_with_those_there_are(text):
    with pytest.raises(ConfigError, match="nothing, observed, predicted, truth") as told:
        knows_given(text)
    assert f"--knows {text.rpartition(',')[2]!r}" in str(told.value)


def test_a_command_names_the_flag(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["rollout", "dense_dynamic", "--knows", "obstacles=all"])
    assert ended.value.code == 2
    assert "--knows 'obstacles=all'" in capsys.readouterr().err


def test_only_those_who_plan_anew_unaware_of_what_moves_are_told():
    line = blind(loaded("dense_dynamic", replan_hz=1.0))
    assert line is not None
    assert "--knows obstacles=observed" in line
    assert "\n" not in line
    assert blind(loaded("dense_dynamic")) is None
    seeing = knows_given("obstacles=observed")
    assert blind(loaded("dense_dynamic", replan_hz=1.0, knows=seeing)) is None
    assert blind(loaded("open_water_current", replan_hz=1.0)) is None


@pytest.mark.parametrize("name", ["mppi", "routes"])
def test_a_policy_observes_unless_a_level_is_given(name):
    def policy(planner=None, **policy):
        changes = {"policy": {"name": name, **policy}, "planner": planner}
        return scenario_given("dense_dynamic", **changes)

    seeing = policy()
    assert (seeing.policy.knows.obstacles, seeing.policy.knows.current) == ("observed", "nothing")
    assert blind(seeing) is None
    # The run folder stores the level; a table of the file's own keys leaves it open.
    stored = check(Scenario, seeing.model_dump(mode="json"))
    assert stored == seeing
    assert "knows" not in table_of(seeing)["policy"]
    flag = policy(planner={"knows": knows_given("obstacles=predicted")})
    assert flag.policy.knows.obstacles == "predicted"
    for unaware in (
        policy(planner={"knows": knows_given("obstacles=nothing")}),
        policy(planner={"knows": knows_given("current=truth")}),
        policy(knows={"obstacles": "nothing"}),
    ):
        assert unaware.policy.knows.obstacles == "nothing"
        line = blind(unaware)
        assert f"policy {name} flies blind" in line
        assert "--knows obstacles=observed" in line
        assert "\n" not in line
    still = {"obstacles": {"dynamic": {"count": 0}, "explicit": []}}
    assert blind(scenario_given("dense_dynamic", policy={"name": name}, world=still)) is None


def test_the_flag_holds_for_a_policy_whose_file_gives_another_level(tmp_path):
    text = find("dense_dynamic").read_text() + '[policy.knows]\nobstacles = "truth"\n'
    (tmp_path / "own.toml").write_text(text)
    given = policy_given("mppi", knows_given("obstacles=observed"))
    found = scenario_given(str(tmp_path / "own.toml"), policy=given)
    assert found.policy.knows.knows() == Information(obstacles="observed")
    assert policy_given(None, None) is None


def test_run_folders_of_older_versions_keep_the_level_that_was_flown():
    for name, level in (("mppi", "nothing"), ("routes", "observed")):
        stored = scenario_given("dense_dynamic", policy={"name": name}).model_dump(mode="json")
        stored["policy"]["knows"] = None
        assert check(Scenario, stored).policy.knows.obstacles == level


def test_too_many_plans_a_second_are_refused_with_those_that_are_possible():
    with pytest.raises(ConfigError, match=r"^--replan-hz = 30: .* 20 Hz at most") as told:
        loaded("dense_dynamic", replan_hz=30.0)
    assert "20, 10, 5" in str(told.value)
