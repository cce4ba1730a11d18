"""The flag --knows: what planners are told, and what is said where they are told nothing."""

import pytest

from angler_mjx.cli.main import main
from angler_mjx.cli.shared.given import knows_given, planner_given, scenario_given, unseen
from angler_mjx.errors import ConfigError


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
    blind = unseen(loaded("dense_dynamic", replan_hz=1.0))
    assert blind is not None
    assert "--knows obstacles=observed" in blind
    assert "\n" not in blind
    assert unseen(loaded("dense_dynamic")) is None
    seeing = knows_given("obstacles=observed")
    assert unseen(loaded("dense_dynamic", replan_hz=1.0, knows=seeing)) is None
    assert unseen(loaded("open_water_current", replan_hz=1.0)) is None


def test_too_many_plans_a_second_are_refused_with_those_that_are_possible():
    with pytest.raises(ConfigError, match=r"^--replan-hz = 30: .* 20 Hz at most") as told:
        loaded("dense_dynamic", replan_hz=30.0)
    assert "20, 10, 5" in str(told.value)
