"""Every shipped scenario, flown by both engines at the control rate, and judged by the referee.

Ten minutes of compiling: asked for by ``pytest -m nightly``. What is run every time are both
engines in random worlds (`engines/test_fused.py`) and everything that can end an episode
(`test_referee_judges_the_judge.py`).
"""

import pytest

from angler_experiments import referee_campaign
from angler_mjx.scenario.scenario import shipped_scenarios


@pytest.mark.nightly(by="test_referee_judges_the_judge.py")
@pytest.mark.parametrize("engine", ["mjx", "fused"])
@pytest.mark.parametrize("name", [*shipped_scenarios()])
def test_a_shipped_scenario_is_judged_the_same_way_twice(name, engine):
    (flown,) = referee_campaign.fly_and_judge((name,), (engine,), robots=16, horizon_s=30.0)
    verdict = flown.verdict
    assert [one.line() for one in verdict.differences if one.result == "disagrees"] == []
    assert verdict.robots >= 12
    assert verdict.counts["outcome"].exact == verdict.robots
