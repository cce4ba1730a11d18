"""Which robots of a scenario are flown."""

import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.scenario.scenario import load_scenario
from angler_sitl.scene.scenario_options import select_scenario


def test_fewer_robots_take_the_first_places():
    whole, two = load_scenario("sitl_hold"), select_scenario("sitl_hold", 2)
    assert [entry.count for entry in two.fleet] == [2]
    assert two.world.start_m == whole.world.start_m[:2]
    assert two.world.goal_m == whole.world.goal_m[:2]


def test_more_robots_are_of_the_last_kind():
    whole, ten = load_scenario("reef_fleet"), select_scenario("reef_fleet", 10)
    assert [entry.count for entry in ten.fleet] == [whole.fleet[0].count, 10 - whole.fleet[0].count]
    assert ten.world == whole.world


def test_none_at_all_are_refused():
    with pytest.raises(ConfigError, match="robots = 0: give 1 or more"):
        select_scenario("reef_fleet", 0)
