"""The table of a task: what it is compiled from, and what is refused before anything is."""

from pathlib import Path
from typing import Any

import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.runs.session.batch_session import BatchSession
from angler_mjx.runs.simulator.scenario_policy import resolve_policy
from angler_mjx.scenario.scenario import Scenario, load_scenario

HEAD = """
schema_version = 1
name = "team"
[world]
preset = "reef"
placement = "parallel"
[[fleet]]
vehicle = "bluerov2_heavy"
count = 2
"""


def scenario(tmp_path: Path, task: str, head: str = HEAD) -> Any:
    path = tmp_path / "team.toml"
    path.write_text(head + task)
    return load_scenario(path)


def test_without_a_task_and_with_goal_nothing_is_compiled_and_problems_are_the_same(
    tmp_path: Path,
) -> None:
    plain, goal = scenario(tmp_path, ""), scenario(tmp_path, '[task]\ntype = "goal"\n')
    assert plain.sim_spec().task is None
    assert plain == goal
    assert plain.digest() == goal.digest()
    assert plain.policy.name == "none"
    tour = scenario(tmp_path, '[task]\ntype = "tour"\n')
    assert tour.digest() != plain.digest()


def test_tasks_are_flown_along_routes_unless_a_file_says_otherwise(tmp_path: Path) -> None:
    table = '[task]\ntype = "tour"\npositions = 5\nlook_s = 0.25\n'
    tour = scenario(tmp_path, table)
    spec = tour.sim_spec().task
    assert (spec.kind, spec.jobs, spec.robots, spec.period) == ("tour", 5, 2, 5)
    assert (spec.homes, spec.positions) == (5, 7)
    assert tour.policy.name == "routes"
    nobody = scenario(tmp_path, table + '[policy]\nname = "none"\n')
    with pytest.raises(ConfigError, match=r"task\.type = 'tour': plans lead to one goal"):
        resolve_policy(nobody, None)


def test_places_of_goods_count_twice(tmp_path: Path) -> None:
    spec = scenario(tmp_path, '[task]\ntype = "deliver"\ngoods = 3\n').sim_spec().task
    assert (spec.homes, spec.positions) == (6, 8)
    given = '[task]\ntype = "deliver"\nfrom_m = [[0.0, 0.0, -5.0], [1.0, 0.0, -5.0]]\n'
    two = scenario(tmp_path, given)
    assert two.sim_spec().task.jobs == 2
    assert Scenario.model_validate(two.model_dump()) == two  # as a run folder keeps it
    tour = scenario(tmp_path, '[task]\ntype = "tour"\npositions_m = [[0.0, 0.0, -5.0]]\n')
    assert Scenario.model_validate(tour.model_dump()) == tour


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ('type = "hunt"', "type"),
        ('type = "tour"\npositions = 0', "positions"),
        ('type = "tour"\npositions = 513', "positions"),
        ('type = "tour"\npositions = 100\nwithin = [[0, 0, 0], [0.2, 0.2, 0.2]]', "100 positions"),
        ('type = "tour"\nwithin = [[0.5, 0, 0], [0.2, 1, 1]]', "second corner"),
        ('type = "tour"\npositions_m = [[100.0, 0.0, -5.0]]', "outside the world"),
        ('type = "tour"\npositions = 2\npositions_m = [[1.0, 0.0, -5.0]]', "not both"),
        ('type = "tour"\nordered = true', "shared = false"),
        ('type = "tour"\nlook_s = 0.12', "look_s"),
        ('type = "tour"\nallocation = "luck"', "nearest, auction, sweep"),
        ('type = "survey"\nrange_m = 0.0', "range_m"),
        ('type = "survey"\nhalf_angle_deg = 0.0', "half_angle_deg"),
        ('type = "survey"\ncoverage = 0.0', "coverage"),
        ('type = "survey"\nrange_m = 2.0', "holds nothing"),
        ('type = "survey"\nhalf_angle_deg = 5.0', "holds nothing"),
        ('type = "survey"\naltitude_m = 30.0\nrange_m = 40.0', "altitude_m"),
        ('type = "survey"\nof = "rock"\nrange_m = 60.0', "cells at a time"),
        ('type = "deliver"\ngoods = 5000', "goods"),
        ('type = "deliver"\ngoods = 3\nto_m = [[0.0, 0.0, -5.0]]', "1 positions for 3 goods"),
        (
            'type = "deliver"\ngoods = 300\nto_within = [[0, 0, 0], [0.3, 0.3, 0.5]]',
            "300 positions",
        ),
        ('type = "tour"\n[policy]\nname = "mppi"', "one goal"),
        ('type = "tour"\n[planner]\nreplan_hz = 1.0', "replan_hz"),
    ],
)
def test_what_cannot_be_done_is_refused_in_one_message(
    tmp_path: Path, table: str, said: str
) -> None:
    with pytest.raises(ConfigError, match="1 fault") as error:
        scenario(tmp_path, f"[task]\n{table}\n")
    assert said in str(error.value)
    assert "task" in str(error.value) or "policy" in str(error.value)


def test_worlds_in_which_there_is_nothing_to_survey_are_refused(tmp_path: Path) -> None:
    table = '[task]\ntype = "survey"\nof = "{}"\n'
    opened = HEAD.replace('preset = "reef"', 'preset = "open"')
    with pytest.raises(ConfigError, match="such worlds have no rock"):
        scenario(tmp_path, table.format("rock"), opened)
    deep = HEAD.replace('preset = "reef"', 'preset = "reef"\nfloor_depth_m = 60.0')
    with pytest.raises(ConfigError, match="below the world's cells"):
        scenario(tmp_path, table.format("floor"), deep)


def test_a_session_refuses_a_task(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="a session has no tasks"):
        BatchSession(scenario(tmp_path, '[task]\ntype = "tour"\n'))
