"""The numbers of the results table."""

import numpy as np
import pytest
from scipy import stats

from angler_mjx.runs.storage.confidence_intervals import (
    clustered_rates,
    student_quantile,
    wilson_interval,
)


def test_wilson_interval_against_published_values():
    # Newcombe, Statistics in Medicine 17 (1998), table I, method 3.
    assert wilson_interval(81, 263) == pytest.approx((0.2553, 0.3662), abs=5e-5)
    assert wilson_interval(15, 148) == pytest.approx((0.0624, 0.1605), abs=5e-5)
    assert wilson_interval(0, 20) == pytest.approx((0.0, 0.1611), abs=5e-5)
    assert wilson_interval(1, 29) == pytest.approx((0.0061, 0.1718), abs=5e-5)


def test_wilson_interval_of_nothing_says_nothing():
    assert wilson_interval(0, 0) == (0.0, 1.0)


def covered(rng, worlds, robots, rate, correlation, times=600):
    """How often the plain and the clustered interval hold the true rate."""
    plain = by_world = 0
    number = np.repeat(np.arange(worlds), robots)
    for _ in range(times):
        share = np.full(worlds, rate)
        if correlation:
            scale = (1 - correlation) / correlation
            share = rng.beta(rate * scale, (1 - rate) * scale, worlds)
        hit = (rng.random((worlds, robots)) < share[:, None]).ravel()
        low, high = wilson_interval(int(hit.sum()), hit.size)
        found = clustered_rates({"hit": hit, "not": ~hit}, number)["hit"]
        plain += low <= rate <= high
        by_world += found.low <= rate <= found.high
    return plain / times, by_world / times


@pytest.mark.parametrize("rate", [0.3, 0.9])
@pytest.mark.parametrize(("worlds", "robots"), [(40, 4), (200, 4), (100, 16)])
def test_intervals_cover_where_robots_share_worlds(worlds, robots, rate):
    rng = np.random.default_rng(worlds + robots)
    plain, by_world = covered(rng, worlds, robots, rate, correlation=0.4)
    assert plain < 0.87  # what is wrong without
    assert 0.925 < by_world < 0.985
    _, independent = covered(rng, worlds, robots, rate, correlation=0.0)
    assert 0.93 < independent < 0.985


def test_a_robot_alone_in_its_world_is_worth_one():
    hit = np.arange(50) < 20
    found = clustered_rates({"hit": hit, "not": ~hit}, np.arange(50))["hit"]
    assert (found.low, found.high) == pytest.approx(wilson_interval(20, 50))
    assert found.effective == 50


def test_worlds_that_end_as_one_are_worth_one_robot():
    number = np.repeat(np.arange(400), 5)
    hit = number % 4 == 0
    found = clustered_rates({"hit": hit, "not": ~hit, "never": hit & ~hit}, number)
    assert found["hit"].effective == pytest.approx(400, rel=0.01)
    assert found["never"].high == pytest.approx(wilson_interval(0, 400)[1], rel=0.02)
    assert (found["never"].count, found["never"].rate) == (0, 0.0)


@pytest.mark.parametrize("spread", ["even", "clustered"])
def test_effective_is_n_over_d_reduced_for_the_degrees_of_freedom(spread):
    """Worlds of one size k: d = k var(rates of worlds) / (p (1 - p)), 1 at least (Cochran 1977)."""
    worlds, k = 64, 4
    reached = np.full(worlds, 2) if spread == "even" else np.r_[np.full(40, 4), np.full(24, 1)]
    hit = (np.arange(k) < reached[:, None]).reshape(-1)
    found = clustered_rates({"hit": hit, "not": ~hit}, np.repeat(np.arange(worlds), k))["hit"]
    p = hit.mean()
    d = max(1.0, k * np.var(reached / k, ddof=1) / (p * (1 - p)))
    reduced = (stats.norm.ppf(0.975) / stats.t.ppf(0.975, worlds - 1)) ** 2
    assert found.effective == pytest.approx(worlds * k / d * reduced, rel=1e-3)
    if spread == "even":
        assert found.effective == pytest.approx(246.3, abs=0.1)


@pytest.mark.parametrize(("count", "total"), [(0, 20), (7, 20), (20, 20), (1, 1), (811, 1000)])
def test_wilsons_interval_is_scipys(count, total):
    want = stats.binomtest(count, total).proportion_ci(0.95, method="wilson")
    assert wilson_interval(count, total) == pytest.approx((want.low, want.high), abs=1e-12)


def test_one_world_says_next_to_nothing():
    found = clustered_rates({"hit": np.ones(4, bool)}, np.zeros(4, int))["hit"]
    assert found.high == 1.0
    assert found.low < 0.05


def test_the_quantile_without_a_degree_of_freedom_is_that_of_one():
    assert student_quantile(0) == student_quantile(1)


def test_quantiles_of_student_against_tables():
    # Abramowitz and Stegun, table 26.10.
    for freedom, value in {1: 12.706, 2: 4.303, 3: 3.182, 5: 2.571, 10: 2.228, 60: 2.0003}.items():
        assert student_quantile(freedom) == pytest.approx(value, rel=2e-4)
