"""Worlds drawn once, shared by rows, and repeated."""

from types import SimpleNamespace

import numpy as np
import pytest

from angler_mjx.errors import RunError
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.studies.speed.measured import repeated_worlds
from angler_mjx.studies.speed.workloads import SpeedRequest, build_cases


@pytest.fixture
def drawings(monkeypatch):
    """Sizes that were drawn, by a simulator that draws nothing; worlds from 900 on are unfit."""
    sizes = []

    class Nothing:
        def __init__(self, scenario, *, tile):
            self.tile = tile

        def worlds(self, first):
            sizes.append(self.tile)
            valid = np.arange(self.tile) < 900
            return SimpleNamespace(environment=SimpleNamespace(valid=valid))

    monkeypatch.setattr(repeated_worlds, "Simulator", Nothing)
    repeated_worlds._sample_cached.cache_clear()
    yield sizes
    repeated_worlds._sample_cached.cache_clear()


def test_rows_of_one_fleet_share_their_worlds(drawings):
    for _ in range(3):
        repeated_worlds.sample_worlds(load_scenario("reef_fleet"), 64)
    assert drawings == [64]
    repeated_worlds.sample_worlds(load_scenario("reef_fleet", seed=8), 64)
    assert drawings == [64, 64]


def test_no_more_are_drawn_than_said_and_unfit_ones_are_refused(drawings):
    with pytest.raises(RunError, match="cannot hold the fleet"):
        repeated_worlds.sample_worlds(load_scenario("reef_fleet"), 10**6)
    assert drawings == [repeated_worlds.MAX_DIFFERENT]


def test_the_largest_row_says_how_many_all_draw():
    chosen = build_cases(SpeedRequest(workloads=("reef_fleet",), worlds=(4, 64, 16), robots=(1, 4)))
    assert [(case.worlds, case.robots) for case in chosen] == [
        *((4, 1), (16, 1), (64, 1)),
        *((4, 4), (16, 4), (64, 4)),
    ]
    assert {case.prepared for case in chosen} == {64}


def test_worlds_are_repeated_to_fill_a_tile():
    drawn = {"a": np.arange(3), "b": np.arange(6.0).reshape(3, 2)}
    filled = repeated_worlds.repeat_worlds(drawn, 7, 1)
    np.testing.assert_array_equal(filled["a"], [0, 1, 2, 0, 1, 2, 0])
    np.testing.assert_array_equal(filled["b"][3:6], drawn["b"])
    few = repeated_worlds.repeat_worlds(drawn, 2, 1)
    np.testing.assert_array_equal(few["a"], [0, 1])


def test_a_row_says_how_many_worlds_are_different():
    drawn = SimpleNamespace(environment=SimpleNamespace(valid=np.ones(1024, bool)))
    assert repeated_worlds.describe_worlds(drawn, 65536) == "1,024 different worlds, repeated"
    assert repeated_worlds.describe_worlds(drawn, 64) == "all worlds different"
