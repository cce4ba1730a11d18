"""Paired statistics against SciPy and closed forms, on episodes that are made up."""

import math

import numpy as np
import pyarrow as pa
import pytest
from scipy import stats

from angler_mjx.runs.storage.confidence_intervals import clustered_mean
from angler_mjx.studies.measures import COSTS
from angler_mjx.studies.paired import mcnemar, newcombe, pair_runs, sign_test


def episodes(arrived, values, first_world=0, completed_s=None):
    """Rows of [w, r] robots; with a task where the times of worlds are given, None: not done."""
    worlds, robots = arrived.shape
    flat = arrived.reshape(-1)
    costs = {
        name: pa.array(
            values.reshape(-1),
            mask=~flat if name == "time_to_goal_s" else np.zeros(flat.size, bool),
        )
        for name in COSTS
    }
    return pa.table(
        {
            "world": np.repeat(np.arange(first_world, first_world + worlds), robots),
            "outcome": ["reached" if one else "timeout" for one in flat],
            **costs,
            "planned": np.ones(flat.size, bool),
            "plan_status": ["planned"] * flat.size,
            "plan_reason": pa.nulls(flat.size, pa.string()),
            "task_progress": pa.array(
                [None if completed_s is None else 0.5] * flat.size, pa.float32()
            ),
            "task_completed_s": pa.array(
                np.repeat(np.array(completed_s or [None] * worlds, object), robots), pa.float32()
            ),
        }
    )


@pytest.fixture(scope="module")
def random():
    return np.random.default_rng(5)


def test_a_mean_of_worlds_with_one_robot_has_students_interval(random):
    values = random.normal(3.0, 2.0, 40)
    found = clustered_mean(values, np.arange(40))
    low, high = stats.t.interval(0.95, 39, loc=values.mean(), scale=stats.sem(values))
    assert found.mean == pytest.approx(values.mean(), rel=1e-12)
    assert (found.low, found.high) == pytest.approx((low, high), rel=2e-3)


def test_a_mean_of_robots_that_share_worlds_is_as_sure_as_that_of_worlds(random):
    each = random.normal(0.0, 1.0, 30)
    found = clustered_mean(np.repeat(each, 8), np.repeat(np.arange(30), 8))
    alone = clustered_mean(each, np.arange(30))
    assert found.count == 240
    assert (found.mean, found.low, found.high) == pytest.approx(
        (alone.mean, alone.low, alone.high), abs=1e-12
    )


def test_the_interval_of_a_mean_over_worlds_of_uneven_size_holds_its_truth(random):
    """Of 400 samples of 25 worlds, 95 % within what chance allows (binomial, 99.9 %)."""
    held = 0
    for _ in range(400):
        sizes = random.integers(1, 6, 25)
        world = np.repeat(np.arange(25), sizes)
        values = random.normal(0, 1, 25)[world] + random.normal(0, 0.5, len(world))
        found = clustered_mean(values, world)
        held += found.low <= 0.0 <= found.high
    assert stats.binomtest(held, 400, 0.95).pvalue > 1e-3


def test_nothing_and_one_world_have_no_interval():
    none = clustered_mean(np.array([np.nan]), np.array([0]))
    assert none.count == 0
    assert np.isnan(none.mean)
    one = clustered_mean(np.array([1.0, 3.0]), np.array([4, 4]))
    assert one.mean == 2.0
    assert np.isnan(one.low)


@pytest.mark.parametrize(("up", "down"), [(0, 0), (1, 0), (5, 1), (7, 7), (30, 12)])
def test_the_sign_test_is_scipys(up, down):
    differences = np.r_[np.full(up, 0.25), np.full(down, -0.5), np.zeros(9)]
    want = stats.binomtest(up, up + down).pvalue if up + down else 1.0
    assert sign_test(differences) == pytest.approx(want, rel=1e-12)


def test_who_arrived_where_is_counted_robot_by_robot_and_team_by_team():
    first = np.array([[1, 1], [1, 0], [0, 0], [1, 1], [0, 1]], bool)
    second = np.array([[1, 1], [1, 1], [0, 1], [0, 1], [1, 0]], bool)
    found = pair_runs(episodes(first, first * 1.0), episodes(second, second * 1.0))
    robots, teams = found["robots"], found["teams"]
    assert (robots["both"], robots["only_first"], robots["only_second"], robots["neither"]) == (
        4,
        2,
        3,
        1,
    )
    assert (teams["both"], teams["only_first"], teams["only_second"], teams["neither"]) == (
        1,
        1,
        1,
        2,
    )
    assert found["share"]["difference"] == pytest.approx(0.1)
    assert robots["difference"] == pytest.approx(0.1)
    # Worlds 1 and 2 gained, world 3 lost, 4 exchanged one robot for another.
    assert found["share_p"] == pytest.approx(stats.binomtest(2, 3).pvalue)
    change = second.mean(axis=1) - first.mean(axis=1)
    low, high = stats.t.interval(0.95, 4, loc=change.mean(), scale=stats.sem(change))
    assert (found["share"]["low"], found["share"]["high"]) == pytest.approx((low, high), rel=2e-3)


def test_costs_are_of_robots_that_arrived_both_times_and_clearance_of_all():
    first = np.array([[1, 1], [1, 0], [1, 1]], bool)
    second = np.array([[1, 0], [1, 1], [1, 1]], bool)
    before = np.array([[10.0, 20.0], [30.0, 99.0], [50.0, 60.0]])
    after = before + np.array([[1.0, 77.0], [2.0, 88.0], [3.0, 6.0]])
    found = pair_runs(episodes(first, before), episodes(second, after))
    time, clearance = found["costs"]["time_to_goal_s"], found["costs"]["min_clearance_m"]
    assert (time["pairs"], time["first"], time["second"]) == (4, 37.5, 40.5)
    assert time["difference"] == pytest.approx(3.0)
    # Energy and way have a value of every robot, and count where both runs arrived all the same.
    for name in ("energy_j", "path_length_m"):
        one = found["costs"][name]
        assert (one["pairs"], one["first"], one["second"]) == (4, 37.5, 40.5)
    assert clearance["pairs"] == 6
    assert clearance["difference"] == pytest.approx((1 + 77 + 2 + 88 + 3 + 6) / 6)


def test_the_interval_of_paired_rates_is_newcombes_with_its_sign():
    """Newcombe 1998 (Statistics in Medicine 17, 2635), table II, method 10: 36, 12, 2, 0."""
    pairs = [(1, 1)] * 36 + [(0, 1)] * 12 + [(1, 0)] * 2
    first, second = np.array(pairs, bool)[:, :, None].transpose(1, 0, 2)
    found = pair_runs(episodes(first, first * 1.0), episodes(second, second * 1.0))["teams"]
    assert (found["both"], found["only_second"], found["only_first"], found["neither"]) == (
        36,
        12,
        2,
        0,
    )
    assert found["difference"] == pytest.approx(0.2)
    assert (found["low"], found["high"]) == pytest.approx((0.0569, 0.3404), abs=5e-5)
    assert found["p"] == pytest.approx(stats.binomtest(12, 14).pvalue, rel=1e-12)
    done = [[10.0 if one else None for one in column.reshape(-1)] for column in (first, second)]
    tables = [episodes(first, first * 1.0, completed_s=times) for times in done]
    tasks = pair_runs(*tables)["tasks"]
    assert (tasks["low"], tasks["high"]) == pytest.approx((0.0569, 0.3404), abs=5e-5)


@pytest.mark.parametrize("change", [-1.0, 0.4])
def test_the_interval_of_a_cost_is_that_of_a_bootstrap_over_worlds(random, change):
    """Robots of a world share its luck: worlds are drawn whole (SciPy, percentiles)."""
    worlds, robots = 150, 3
    each = random.normal(change, 1.0, (worlds, 1)) + random.normal(0.0, 0.3, (worlds, robots))
    all_ = np.ones((worlds, robots), bool)
    before = random.normal(50.0, 5.0, (worlds, robots))
    found = pair_runs(episodes(all_, before), episodes(all_, before + each))["costs"]["energy_j"]
    end = stats.bootstrap(
        (each.mean(axis=1),), np.mean, n_resamples=5000, rng=random, method="percentile"
    ).confidence_interval
    assert found["difference"] == pytest.approx(each.mean(), rel=1e-9)
    assert (found["low"], found["high"]) == pytest.approx((end.low, end.high), abs=0.03)
    assert found["low"] < found["difference"] < found["high"]


def test_tasks_are_paired_by_world_whoever_arrived():
    """Robots of a survey can all have done their part without its being completed."""
    both = np.ones((5, 3), bool)
    first, second = [10.0, 20.0, None, None, 50.0], [13.0, 21.0, 30.0, None, None]
    a, b = (episodes(both, both * 1.0, completed_s=times) for times in (first, second))
    found = pair_runs(a, b)
    assert (found["teams"]["both"], found["teams"]["only_first"]) == (5, 0)
    tasks = found["tasks"]
    assert (tasks["both"], tasks["only_first"], tasks["only_second"], tasks["neither"]) == (
        2,
        1,
        1,
        1,
    )
    assert tasks["p"] == stats.binomtest(1, 2).pvalue
    assert (found["task_s"]["pairs"], found["task_s"]["difference"]) == (2, pytest.approx(2.0))
    low, high = stats.t.interval(0.95, 1, loc=2.0, scale=stats.sem([3.0, 1.0]))
    assert (found["task_s"]["low"], found["task_s"]["high"]) == pytest.approx((low, high), rel=2e-3)
    for one, other in ((a, episodes(both, both * 1.0)), (episodes(both, both * 1.0), a)):
        assert (pair_runs(one, other)["tasks"], pair_runs(one, other)["task_s"]) == (None, None)


def test_the_change_of_a_share_is_a_change_of_a_share():
    """Student's interval of 4 worlds of which 3 changed by all would end beyond 1."""
    first = np.zeros((4, 1), bool)
    second = np.array([[True], [True], [True], [False]])
    found = pair_runs(episodes(first, first * 1.0), episodes(second, first * 1.0))
    assert found["share"]["high"] == 1.0
    assert found["share"]["low"] == pytest.approx(
        stats.t.interval(0.95, 3, 0.75, 0.25)[0], abs=2e-3
    )


def test_the_order_of_the_runs_is_a_sign(random):
    first, second = (random.random((12, 3)) < 0.6 for _ in range(2))
    values = random.normal(size=(2, 12, 3))
    ab = pair_runs(episodes(first, values[0]), episodes(second, values[1]))
    ba = pair_runs(episodes(second, values[1]), episodes(first, values[0]))
    for one, other in ((ab["teams"], ba["teams"]), (ab["share"], ba["share"])):
        assert (one["difference"], one["low"], one["high"]) == pytest.approx(
            (-other["difference"], -other["high"], -other["low"]), abs=1e-12
        )
    assert ab["share_p"] == ba["share_p"]


def test_where_nothing_changed_the_interval_is_not_a_point():
    """None of m worlds changed: with 95 %, at most the share that Wilson's interval ends at."""
    both = np.ones((20, 2), bool)
    found = pair_runs(episodes(both, both * 1.0), episodes(both, both * 1.0))
    most = stats.binomtest(0, 20).proportion_ci(0.95, method="wilson").high
    assert (found["share"]["low"], found["share"]["high"]) == pytest.approx((-most, most))
    assert found["share_p"] == 1.0


def test_fleets_of_different_sizes_are_paired_by_their_worlds():
    first, second = np.array([[1], [0], [1]], bool), np.array([[1, 1], [1, 0], [0, 1]], bool)
    found = pair_runs(episodes(first, first * 1.0), episodes(second, second * 1.0))
    assert found["robots"] is None
    assert found["costs"] == {}
    assert found["share"]["difference"] == pytest.approx(0.0)
    assert found["teams"]["only_first"] == 1


def test_only_worlds_of_both_runs_are_pairs():
    all_ = np.ones((4, 1), bool)
    found = pair_runs(episodes(all_, all_ * 2.0), episodes(all_, all_ * 5.0, first_world=3))
    assert found["worlds"] == 1
    assert found["costs"]["energy_j"]["difference"] == 3.0


def test_newcombe_gives_the_published_interval():
    # Newcombe 1998, table II, method 10: 36, 12, 2, 0 and 53, 0, 1, 0 (by symmetry of 0, 1).
    np.testing.assert_allclose(newcombe(36, 12, 2, 0), (0.0569, 0.3404), atol=5e-5)


def test_newcombe_without_correlation_joins_two_wilson_intervals():
    # ad - bc < n / 2, so the corrected correlation is 0 and the plain square-and-add holds.
    low, high = newcombe(10, 10, 10, 10)
    interval = stats.binomtest(20, 40).proportion_ci(method="wilson")
    half = math.hypot(0.5 - interval.low, interval.high - 0.5)
    assert (low, high) == pytest.approx((-half, half))


def test_newcombe_turns_round_with_the_planners():
    for table in ((7, 3, 1, 9), (0, 5, 0, 5), (4, 0, 0, 4), (0, 6, 6, 0), (1, 0, 0, 0)):
        low, high = newcombe(*table)
        turned = newcombe(table[0], table[2], table[1], table[3])
        assert (low, high) == pytest.approx((-turned[1], -turned[0]))
        assert -1 <= low <= (table[1] - table[2]) / sum(table) <= high <= 1


def test_newcombe_covers_the_truth_about_as_often_as_it_says():
    random = np.random.default_rng(3)
    chance = (0.5, 0.25, 0.1, 0.15)
    tables = random.multinomial(60, chance, 1500)
    hit = [low <= 0.15 <= high for low, high in (newcombe(*map(int, t)) for t in tables)]
    assert 0.93 < np.mean(hit) < 0.98


@pytest.mark.parametrize(("first", "second"), [(0, 0), (1, 0), (12, 2), (7, 7), (600, 560)])
def test_mcnemar_is_the_exact_binomial_test(first, second):
    wanted = stats.binomtest(first, first + second).pvalue if first + second else 1.0
    assert mcnemar(first, second) == pytest.approx(wanted)
