"""Robots that break down: what the scenario may say, and what is drawn of it."""

import jax
import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.runs.simulator import world_preparation
from angler_mjx.runs.simulator.sampling_numbers import breakdown_numbers
from angler_mjx.scenario.scenario import load_scenario

WORLDS = 4000


def reef(**table):
    return load_scenario("reef_fleet", time={"horizon_s": 100.0}, breakdowns=table)


def drawn(scenario, robots):
    """[world, robot] s."""
    keys = jax.random.split(jax.random.key(4), WORLDS)
    numbers = breakdown_numbers(scenario)
    return np.asarray(
        jax.vmap(lambda key: world_preparation.sample_breakdowns(numbers, key, robots))(keys)
    )


def test_each_robot_breaks_down_by_itself_and_at_any_time_of_the_span():
    at_s = drawn(reef(fraction=0.2, earliest_s=20.0, latest_s=60.0), 4)
    breaks = np.isfinite(at_s)
    # Four standard deviations of 16,000 draws, and of 4,000 worlds with each number of robots.
    np.testing.assert_allclose(breaks.mean(), 0.2, atol=4 * np.sqrt(0.16 / breaks.size))
    of_world = np.bincount(breaks.sum(axis=1), minlength=5) / WORLDS
    binomial = np.array([0.4096, 0.4096, 0.1536, 0.0256, 0.0016])
    assert (abs(of_world - binomial) < 4 * np.sqrt(binomial * (1 - binomial) / WORLDS)).all()
    times = at_s[breaks]
    assert 20.0 <= times.min() < 20.1
    assert 59.9 < times.max() <= 60.0
    np.testing.assert_allclose(times.mean(), 40.0, atol=4 * 40.0 / np.sqrt(12 * times.size))


def test_a_robot_more_changes_nothing_for_those_before_it():
    scenario = reef(fraction=0.5)
    np.testing.assert_array_equal(drawn(scenario, 3), drawn(scenario, 5)[:, :3])


def test_none_breaks_down_unless_asked():
    assert breakdown_numbers(load_scenario("reef_fleet")) is None
    assert world_preparation.sample_breakdowns(None, jax.random.key(0), 4) is None
    assert (drawn(reef(fraction=1.0), 2) <= 100.0).all()


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"fraction": 1.5}, ["breakdowns.fraction", "1"]),
        ({"earliest_s": 5.0}, ["breakdowns", "earliest_s", "no robot breaks down", "fraction"]),
        (
            {"fraction": 0.2, "latest_s": 120.0},
            ["breakdowns.latest_s", "= 120:", "time.horizon_s", "= 100;"],
        ),
        (
            {"fraction": 0.2, "earliest_s": 9.0, "latest_s": 8.0},
            ["breakdowns.earliest_s", "= 9:", "later", "latest_s", "= 8;"],
        ),
        (
            {"fraction": 0.2, "earliest_s": 101.0},
            ["earliest_s", "= 101:", "time.horizon_s", "= 100;"],
        ),
        ({"fraction": 0.2, "mean_s": 1.0}, ["breakdowns.mean_s", "unknown key"]),
    ],
)
def test_what_cannot_be_is_refused(table, said):
    with pytest.raises(ConfigError) as error:
        reef(**table)
    for words in said:
        assert words in str(error.value)
