"""The flag --information: its levels, and the notice of planners without any."""

import pytest

from angler_mjx.cli.main import main
from angler_mjx.cli.shared.inputs import (
    build_planner_table,
    build_policy_table,
    build_scenario,
    parse_information,
)
from angler_mjx.errors import ConfigError
from angler_mjx.files import validate_model
from angler_mjx.scenario.editing import scenario_table
from angler_mjx.scenario.notices import missing_information_notice
from angler_mjx.scenario.scenario import Scenario, find_scenario
from angler_mjx.sim.information import Information


def loaded(name, **keys):
    return build_scenario(name, planner=build_planner_table(None, **keys))


def test_levels_of_the_flag_stand_in_the_scenario():
    both = loaded(
        "dense_dynamic", information=parse_information("obstacles=predicted, current=truth")
    )
    assert (both.planner.information.obstacles, both.planner.information.current) == (
        "predicted",
        "truth",
    )
    one = loaded("dense_dynamic", information=parse_information("obstacles=observed"))
    assert (one.planner.information.obstacles, one.planner.information.current) == (
        "observed",
        "nothing",
    )
    assert parse_information(None) is None


@pytest.mark.parametrize(
    "text",
    ["obstacles=all", "rocks=truth", "truth", "", "obstacles=truth,obstacles=truth", "current="],
)
def test_what_is_no_level_is_named_with_those_there_are(text):
    with pytest.raises(ConfigError, match="nothing, observed, predicted, truth") as told:
        parse_information(text)
    assert f"--information {text.rpartition(',')[2]!r}" in str(told.value)


def test_a_command_names_the_flag(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["rollout", "dense_dynamic", "--information", "obstacles=all"])
    assert ended.value.code == 2
    assert "--information 'obstacles=all'" in capsys.readouterr().err


def test_only_those_who_plan_anew_unaware_of_what_moves_are_told():
    line = missing_information_notice(loaded("dense_dynamic", replan_hz=1.0))
    assert line is not None
    assert "--information obstacles=observed" in line
    assert "\n" not in line
    assert missing_information_notice(loaded("dense_dynamic")) is None
    seeing = parse_information("obstacles=observed")
    assert (
        missing_information_notice(loaded("dense_dynamic", replan_hz=1.0, information=seeing))
        is None
    )
    assert missing_information_notice(loaded("open_water_current", replan_hz=1.0)) is None


@pytest.mark.parametrize("name", ["mppi", "routes"])
def test_a_policy_observes_unless_a_level_is_given(name):
    def policy(planner=None, **policy):
        changes = {"policy": {"name": name, **policy}, "planner": planner}
        return build_scenario("dense_dynamic", **changes)

    seeing = policy()
    assert (seeing.policy.information.obstacles, seeing.policy.information.current) == (
        "observed",
        "nothing",
    )
    assert missing_information_notice(seeing) is None
    # The run folder stores the level; a table of the file's own keys leaves it open.
    stored = validate_model(Scenario, seeing.model_dump(mode="json"))
    assert stored == seeing
    assert "information" not in scenario_table(seeing)["policy"]
    flag = policy(planner={"information": parse_information("obstacles=predicted")})
    assert flag.policy.information.obstacles == "predicted"
    for unaware in (
        policy(planner={"information": parse_information("obstacles=nothing")}),
        policy(planner={"information": parse_information("current=truth")}),
        policy(information={"obstacles": "nothing"}),
    ):
        assert unaware.policy.information.obstacles == "nothing"
        line = missing_information_notice(unaware)
        assert f"policy {name} flies blind" in line
        assert "--information obstacles=observed" in line
        assert "\n" not in line
    still = {"obstacles": {"dynamic": {"count": 0}, "explicit": []}}
    assert (
        missing_information_notice(
            build_scenario("dense_dynamic", policy={"name": name}, world=still)
        )
        is None
    )


def test_the_flag_holds_for_a_policy_whose_file_gives_another_level(tmp_path):
    text = (
        find_scenario("dense_dynamic").read_text() + '[policy.information]\nobstacles = "truth"\n'
    )
    (tmp_path / "own.toml").write_text(text)
    given = build_policy_table("mppi", parse_information("obstacles=observed"))
    found = build_scenario(str(tmp_path / "own.toml"), policy=given)
    assert found.policy.information.to_information() == Information(obstacles="observed")
    assert build_policy_table(None, None) is None


def test_run_folders_of_older_versions_keep_the_level_that_was_flown():
    for name, level in (("mppi", "nothing"), ("routes", "observed")):
        stored = build_scenario("dense_dynamic", policy={"name": name}).model_dump(mode="json")
        stored["policy"]["information"] = None
        assert validate_model(Scenario, stored).policy.information.obstacles == level


def test_too_many_plans_a_second_are_refused_with_those_that_are_possible():
    with pytest.raises(ConfigError, match=r"^--replan-hz = 30: .* 20 Hz at most") as told:
        loaded("dense_dynamic", replan_hz=30.0)
    assert "20, 10, 5" in str(told.value)
