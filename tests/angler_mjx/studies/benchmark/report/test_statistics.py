"""Rates, profiles and paired comparisons, against closed forms, scipy and brute force."""

import csv
import io
import itertools
import math

import numpy as np
import pytest
from scipy import stats

from angler_mjx.studies.benchmark.report import cells, paired, rates, reading
from angler_mjx.studies.benchmark.report.profiles import compute_profiles


def _problem(row):
    return row["scene"], row["robots"], row["problem_seed"], row["world"]


def _counted(rows, planner):
    """Given up on is taken to fail; a world without room is nobody's."""
    return {
        _problem(row): row
        for row in rows
        if row["planner"] == planner and row["plan_status"] != "no room"
    }


def test_rates_count_what_was_asked_and_nothing_else(rows, results):
    found = {(c.planner, c.scene, c.robots): c for c in cells.build_cells(results.runs)}
    for (planner, scene, team), cell in found.items():
        here = [
            row
            for row in rows
            if (row["planner"], row["scene"], row["robots"]) == (planner, scene, team)
        ]
        asked = [row for row in here if row["plan_status"] not in ("closed", "no room")]
        assert cell.success.requested == len(asked)
        assert cell.success.count == sum(row["success"] for row in asked)
        known = [row["energy_j"] for row in asked if row["energy_j"] is not None]
        np.testing.assert_equal(cell.medians["energy_j"], np.median(known) if known else np.nan)
        interval = stats.binomtest(cell.success.count, len(asked)).proportion_ci(method="wilson")
        np.testing.assert_allclose((cell.success.low, cell.success.high), interval, atol=1e-12)
        assert cell.success.few == (len(asked) < 10)


def test_bins_of_density_hold_every_row_between_their_edges(results):
    bins = rates.build_density_bins(results.runs, results.problem)
    density = results.runs["density"]
    assert len(bins.edges) > 3
    assert np.all((bins.edges[bins.of] <= density) & (density <= bins.edges[bins.of + 1]))
    for i, centre in enumerate(bins.centres):
        assert centre == pytest.approx(density[bins.of == i].mean())


def test_few_densities_have_a_bin_each(results):
    columns = dict(results.runs.columns)
    columns["density"] = np.array([0.0, 0.06, 0.12])[results.problem % 3]
    bins = rates.build_density_bins(reading.Runs(columns), results.problem)
    np.testing.assert_allclose(bins.centres, [0.0, 0.06, 0.12])
    np.testing.assert_array_equal(bins.of, results.problem % 3)


@pytest.mark.parametrize("cost", ["planning_s", "makespan_s", "energy_j"])
def test_profiles_are_what_one_counts_by_hand(rows, results, cost):
    planners = ("grid", "RRTConnect", "KPIECE1")
    found = compute_profiles(results, results.run_table, cost)
    shown = [name for name in planners if not (name == "grid" and cost == "planning_s")]
    assert found.left_out == tuple(set(planners) - set(shown))
    counted = {name: _counted(rows, name) for name in shown}
    common = set.intersection(*(set(held) for held in counted.values()))
    assert found.problems == len(common) < len(np.unique(results.problem))
    solved = "planned" if cost == "planning_s" else "success"

    def value(name, problem):
        row = counted[name][problem]
        return row[cost] if row[solved] else math.inf

    for tau in (1.0, 1.1, 1.7, 4.0, 1e9):
        for name in shown:
            within = [
                value(name, q) <= tau * min(value(n, q) for n in shown)
                and value(name, q) < math.inf
                for q in common
            ]
            assert found.at(name, tau) == pytest.approx(np.mean(within))


def _sample(logs, world):
    order = np.argsort(logs)
    return logs[order], np.asarray(world)[order]


def test_ratios_are_medians_with_an_interval_of_whole_worlds():
    random = np.random.default_rng(5)
    logs = random.normal(0.3, 0.5, 80)
    alone_sample = _sample(logs, np.arange(80))
    # Four copies of each world say no more than one.
    copies = _sample(np.repeat(logs, 4), np.repeat(np.arange(80), 4))
    alone, again = paired.bootstrap_ratios([alone_sample, copies])
    assert alone.median == pytest.approx(np.exp(np.median(logs)))
    found = stats.bootstrap(
        (logs,), np.median, method="percentile", n_resamples=4000, rng=np.random.default_rng(0)
    ).confidence_interval
    np.testing.assert_allclose(np.log([alone.low, alone.high]), found, atol=0.04)
    np.testing.assert_allclose((again.low, again.high), (alone.low, alone.high), rtol=0.04)
    assert paired.bootstrap_ratios([alone_sample]) == [alone]


def _resample_by_hand(logs, world):
    """Medians of resamples that are written out."""
    counts = paired._resample_worlds(int(world.max()) + 1, paired.RESAMPLES)
    medians = [np.median(np.repeat(logs, of_resample[world])) for of_resample in counts]
    low, high = np.exp(np.quantile(medians, [0.025, 0.975]))
    return np.exp(np.median(logs)), low, high, len(logs)


def test_samples_of_any_size_are_resampled_together_as_each_alone(monkeypatch):
    monkeypatch.setattr(paired, "_MAX_CHUNK", 100)
    random = np.random.default_rng(2)
    sizes = [(1, 1), (7, 7), (30, 7), (0, 0), (12, 1), (40, 40), (9, 7), (5000, 7), (33, 7)]
    samples = [
        _sample(
            random.normal(size=n), np.r_[np.arange(worlds), np.arange(n - worlds) % max(worlds, 1)]
        )
        for n, worlds in sizes
    ]
    for found, (logs, world) in zip(paired.bootstrap_ratios(samples), samples, strict=True):
        if not len(logs):
            assert (found.pairs, str(found.median)) == (0, "nan")
            continue
        values = (found.median, found.low, found.high, found.pairs)
        assert values == _resample_by_hand(logs, world)


def test_planners_are_compared_on_the_problems_of_both(rows, results):
    one = paired.compare_planners(results, "RRTConnect", "KPIECE1")
    a, b = _counted(rows, "RRTConnect"), _counted(rows, "KPIECE1")
    common = set(a) & set(b)
    won = [(a[q]["success"], b[q]["success"]) for q in common]
    assert any(b[q]["plan_status"] == "closed" for q in common)
    assert one.pairs == len(common) == len(a)
    for pair, count in (
        ((True, True), one.both),
        ((True, False), one.only_first),
        ((False, True), one.only_second),
        ((False, False), one.neither),
    ):
        assert won.count(pair) == count
    logs = [
        math.log(a[q]["planning_s"] / b[q]["planning_s"])
        for q in common
        if a[q]["planned"] and b[q]["planned"]
    ]
    assert one.ratios["planning_s"].pairs == len(logs)
    assert one.ratios["planning_s"].median == pytest.approx(math.exp(np.median(logs)))


def test_the_table_of_pairs_holds_each_once(results):
    held = list(csv.DictReader(io.StringIO(paired.format_pairs_csv(results))))
    assert [(r["first"], r["second"]) for r in held] == list(
        itertools.combinations(("grid", "RRTConnect", "KPIECE1"), 2)
    )
    assert held[0]["planning_s_pairs"] == "0"


def test_other_knowledge_is_another_problem_only_where_one_planner_had_both(results):
    columns = dict(results.runs.columns)
    told = np.where(columns["planner"] == "grid", "nothing", "observed").astype(object)
    apart = reading.Runs(columns | {"knows_obstacles": told})
    assert reading.index_problems(apart).max() == results.problem.max()
    twice = reading.Runs({n: np.concatenate([v, v]) for n, v in columns.items()})
    half = np.repeat(np.array(["nothing", "truth"], object), len(results.runs))
    twice = reading.Runs(dict(twice.columns) | {"knows_obstacles": half})
    assert reading.index_problems(twice).max() == 2 * results.problem.max() + 1
