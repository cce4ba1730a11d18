"""A horizon in which no robot can be at its goal is refused by all commands before they compute."""

import pytest

from angler_mjx.cli.main import main
from angler_mjx.errors import ConfigError
from angler_mjx.scenario.horizon_check import check_reachable, minimum_time_s
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.studies.benchmark import problem_settings

FILE = """
schema_version = 1
name = "near"
[time]
horizon_s = {horizon_s}
[world]
preset = "open"
{world}
[[fleet]]
vehicle = "bluerov2"
[[fleet]]
vehicle = "bluerov2"
cruise_speed_mps = 0.25
"""


def write(tmp_path, horizon_s, world=""):
    file = tmp_path / "near.toml"
    file.write_text(FILE.format(horizon_s=horizon_s, world=world))
    return file


def test_the_least_time_is_half_the_longest_edge_at_the_fastest_cruise_speed(tmp_path):
    drawn = load_scenario(write(tmp_path, 24.0))
    assert minimum_time_s(drawn) == pytest.approx((12.0 - 0.3) / 0.5)
    check_reachable(drawn)


def test_of_given_places_each_robot_has_its_own_speed(tmp_path):
    places = (
        'placement = "given"\nstart_m = [[0.0, 0.0, -9.0], [0.0, 5.0, -9.0]]\n'
        "goal_m = [[10.0, 0.0, -9.0], [3.0, 9.0, -9.0]]"
    )
    given = load_scenario(write(tmp_path, 18.0, places))
    assert minimum_time_s(given) == pytest.approx((5.0 - 0.3) / 0.25)
    with pytest.raises(ConfigError, match=r"time.horizon_s = 18: no robot .* takes 18.8 s"):
        check_reachable(given)


@pytest.mark.parametrize(
    "command",
    [["rollout"], ["plan"], ["fly", "--replan-hz", "1"]],
    ids=lambda words: words[0],
)
def test_commands_refuse_it_and_name_what_is_possible(command, tmp_path, capsys):
    file = write(tmp_path, 20.0)
    with pytest.raises(SystemExit) as ended:
        main([command[0], str(file), *command[1:], "--out", str(tmp_path / "out")])
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert f"{file}: time.horizon_s = 20: no robot can be at its goal" in said
    assert "23.4 s" in said
    assert not (tmp_path / "out").exists()


def test_a_benchmark_refuses_it_too(tmp_path):
    file = tmp_path / "b.toml"
    file.write_text(
        'name = "b"\nscenario = "reef_fleet"\nset.time.horizon_s = 20.0\n[[planner]]\nname = "grid"'
    )
    with pytest.raises(ConfigError, match=r"b.toml.*set.time.horizon_s = 20: no robot.* 23.4 s"):
        problem_settings.read_benchmark(file)


def test_more_robots_than_cells_are_refused_when_the_file_is_read(tmp_path):
    file = write(tmp_path, 120.0, "shape = [2, 2, 2]")
    assert len(load_scenario(file).members()) == 2
    file.write_text(file.read_text().replace('"bluerov2"', '"bluerov2"\ncount = 5'))
    with pytest.raises(ConfigError, match=r"10 robots \(fleet.count\) .*\(2, 2, 2\).* 8 robots"):
        load_scenario(file)
