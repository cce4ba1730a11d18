import functools
import math

import numpy as np
import pytest
from scipy import integrate, stats

from angler_mjx.runs.storage.confidence_intervals import wilson_interval
from angler_mjx.studies.fleet_size import bernoulli

LOOKS = range(20, 1001, 20)


@pytest.mark.parametrize(("hits", "total"), [(0, 3), (5, 5), (17, 20), (190, 200)])
@pytest.mark.parametrize("p", [0.5, 0.93])
def test_ratio_is_the_likelihood_averaged_over_the_prior(hits, total, p):
    prior = stats.beta(bernoulli.PRIOR_WORLDS * 0.9, bernoulli.PRIOR_WORLDS * 0.1)
    likelihood = stats.binom.pmf
    averaged = integrate.quad(
        lambda q: prior.pdf(q) * likelihood(hits, total, q), 0.0, 1.0, points=[hits / total]
    )[0]
    found = bernoulli.log_ratio(p, hits, total, 0.9)
    assert found == pytest.approx(math.log(averaged / likelihood(hits, total, p)), abs=1e-6)


def test_ends_are_where_the_ratio_reaches_its_bound():
    for hits, total in ((3, 40), (380, 400), (39, 40)):
        for end in (bernoulli.lower_bound, bernoulli.upper_bound):
            p = end(hits, total, 0.02, 0.95)
            assert bernoulli.log_ratio(p, hits, total, 0.95) == pytest.approx(math.log(50.0))
    assert bernoulli.lower_bound(0, 10, 0.05, 0.95) == 0.0
    assert bernoulli.upper_bound(10, 10, 0.05, 0.95) == 1.0


@pytest.mark.parametrize("p", [0.8, 0.95, 0.97])
def test_an_end_is_ever_wrong_with_its_alpha_at_most(p):
    alpha, sequences = 0.1, 1500
    rng = np.random.default_rng(5)
    hits = np.cumsum(rng.random((sequences, LOOKS[-1])) < p, axis=1)[:, np.array(LOOKS) - 1]
    low = functools.cache(lambda s, n: bernoulli.lower_bound(s, n, alpha, 0.95))
    high = functools.cache(lambda s, n: bernoulli.upper_bound(s, n, alpha, 0.95))
    fixed = functools.cache(wilson_interval)
    looks = [list(zip(row.tolist(), LOOKS, strict=True)) for row in hits]
    above = np.mean([any(low(s, n) > p for s, n in row) for row in looks])
    below = np.mean([any(high(s, n) < p for s, n in row) for row in looks])
    assert above <= alpha
    assert below <= alpha
    # An interval that is made for one look misses far more often when it is looked at 50 times.
    missed = np.mean([any(not a <= p <= b for a, b in (fixed(*x) for x in row)) for row in looks])
    assert missed > 0.15


def test_intervals_are_not_wide():
    low, high = (
        end(1940, 2000, 0.025, 0.95) for end in (bernoulli.lower_bound, bernoulli.upper_bound)
    )
    exact = stats.binomtest(1940, 2000).proportion_ci(0.95, "exact")
    assert high - low < 2.0 * (exact.high - exact.low)
    assert low < exact.low < 0.97 < exact.high < high


def test_quantile_holds_whatever_is_looked_at():
    share, alpha, sequences = 0.5, 0.1, 300
    truth = math.log(2.0)
    rng = np.random.default_rng(11)
    missed = 0
    for _ in range(sequences):
        times = rng.exponential(size=300)
        for n in range(20, 301, 40):
            estimate, low, high = bernoulli.estimate_quantile(times[:n], share, alpha)
            assert low <= estimate <= high
            if not low <= truth <= high:
                missed += 1
                break
    assert missed / sequences <= alpha
    _, low, high = bernoulli.estimate_quantile(
        np.random.default_rng(0).exponential(size=3000), share, alpha
    )
    assert 0.87 * truth < low < high < 1.15 * truth


def test_quantile_of_times_that_never_came():
    times = [10.0] * 60 + [math.inf] * 40
    assert bernoulli.estimate_quantile(times, 0.5, 0.05)[0] == 10.0
    assert bernoulli.estimate_quantile(times, 0.9, 0.05) == (math.inf, math.inf, math.inf)
    assert bernoulli.estimate_quantile(times, 0.6, 0.05)[1:] == (10.0, math.inf)
    assert bernoulli.estimate_quantile([], 0.5, 0.05) == (math.inf, 0.0, math.inf)


@pytest.mark.parametrize("total", [1, 2, 10, 57, 400])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.95])
def test_quantile_is_between_all_counts_that_may_be(total, share):
    wall = math.log(20.0)
    may = [k for k in range(total + 1) if bernoulli.log_ratio(share, k, total, share) < wall]
    times = np.arange(1.0, total + 1.0)
    low = float(may[0])  # the k-th time is k
    high = math.inf if may[-1] == total else may[-1] + 1.0
    assert bernoulli.estimate_quantile(times, share, 0.05)[1:] == (low, high)
