"""Against the remission times of Freireich et al. (Blood 21, 1963), worked out in textbooks."""

import numpy as np
import pytest

from angler_mjx.studies.fleet_size import survival

WEEKS = [6, 6, 6, 6, 7, 9, 10, 10, 11, 13, 16, 17, 19, 20, 22, 23, 25, 32, 32, 34, 35]
RELAPSED = [1, 1, 1, 0, 1, 0, 1, 0, 0, 1, 1, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0]

# Klein and Moeschberger, Survival Analysis (2003), table 4.1A: week, share left, standard error.
TABLE = [
    (6, 0.857, 0.076),
    (7, 0.807, 0.087),
    (10, 0.753, 0.096),
    (13, 0.690, 0.107),
    (16, 0.628, 0.114),
    (22, 0.538, 0.128),
    (23, 0.448, 0.135),
]


@pytest.fixture(scope="module")
def curve():
    return survival.estimate_curve(np.array(WEEKS, float), np.array(RELAPSED, bool))


def test_curve_is_the_published_one(curve):
    weeks, left, error = (np.array(column) for column in zip(*TABLE, strict=True))
    assert curve.time_s.tolist() == weeks.tolist()
    np.testing.assert_allclose(curve.left, left, atol=6e-4)
    np.testing.assert_allclose(np.sqrt(curve.variance), error, atol=6e-4)


def test_restricted_mean_is_the_area(curve):
    # 6 weeks of all, then each step by its height, to week 20.
    area = 6 + 0.857143 + 3 * 0.806723 + 3 * 0.752941 + 3 * 0.690196 + 4 * 0.627451
    assert survival.restricted_mean(curve, 20.0)[0] == pytest.approx(area, abs=1e-4)


def test_restricted_mean_of_all_that_were_watched_is_the_mean():
    rng = np.random.default_rng(3)
    times, until = rng.exponential(30.0, 400), 50.0
    ended = np.minimum(times, until)
    mean, low, high = survival.restricted_mean(survival.estimate_curve(ended, times < until), until)
    assert mean == pytest.approx(ended.mean())
    # Without losses before the end Greenwood's sum is the variance of the sample.
    half = 1.959964 * ended.std() / np.sqrt(len(ended))
    assert (low, high) == pytest.approx((mean - half, mean + half), rel=1e-6)


def test_nothing_done():
    found = survival.estimate_curve(np.full(5, 60.0), np.zeros(5, bool))
    assert survival.restricted_mean(found, 60.0) == (60.0, 60.0, 60.0)


def test_the_interval_of_a_mean_stays_within_the_observation():
    """Two worlds, done after 1 s and 99 s of 100 s: the normal interval would be -18 to 118 s."""
    found = survival.restricted_mean(
        survival.estimate_curve(np.array([1.0, 99.0]), np.ones(2, bool)), 100.0
    )
    assert found == (50.0, 0.0, 100.0)
