"""Fits of power laws against known exponents and SciPy; ladders and tables of made-up rows."""

import json

import numpy as np
import pytest
from scipy import stats

from angler_experiments.scalability import arrivals, cost, ladders, plot
from angler_experiments.scalability.fits import fit_linear, fit_power_law
from angler_mjx.errors import ConfigError
from angler_mjx.studies.speed import rows as speed


def test_a_power_law_is_found_again():
    x = np.array([1, 4, 16, 64])
    found = fit_power_law(x, 3.0 * x**1.5)
    assert (found.exponent, found.factor, found.last) == pytest.approx((1.5, 3.0, 1.5))
    assert found.high - found.low < 1e-6


def test_exponent_and_interval_are_scipys_regression():
    random = np.random.default_rng(2)
    x = 2.0 ** np.arange(9)
    y = 0.1 * x**0.8 * np.exp(random.normal(0.0, 0.2, 9))
    want = stats.linregress(np.log(x), np.log(y))
    half = stats.t.ppf(0.975, 7) * want.stderr
    found = fit_power_law(x[::-1], y[::-1])
    assert found.exponent == pytest.approx(want.slope)
    assert found.factor == pytest.approx(np.exp(want.intercept))
    assert (found.low, found.high) == pytest.approx(
        (want.slope - half, want.slope + half), rel=5e-3
    )


def test_two_sizes_have_no_interval_and_one_no_exponent():
    found = fit_power_law([1, 10], [2.0, 20.0])
    assert found.exponent == pytest.approx(1.0)
    assert np.isnan(found.low)
    assert fit_power_law([4], [1.0]) is None
    assert fit_power_law([4, 4], [1.0, 2.0]) is None


def test_what_more_costs_where_there_are_many_is_the_last_step():
    """A fixed cost hides the law of small sizes; the last step is nearer to it."""
    x = np.array([1.0, 10.0, 100.0, 1000.0])
    found = fit_power_law(x, 5.0 + x)
    assert found.exponent < found.last < 1.0
    assert found.last == pytest.approx(np.log10(1005 / 105))


def test_a_fixed_cost_and_one_of_each_are_found_again():
    x = [1, 10, 100, 10_000]
    found = fit_linear(x, [5.0 + 0.02 * n for n in x])
    assert (found.fixed, found.each) == pytest.approx((5.0, 0.02))
    # Neither is below 0: what gets cheaper costs nothing of each.
    falls = fit_linear(x, [4.0, 3.0, 2.9, 2.8])
    assert falls.each == 0.0
    assert 2.8 < falls.fixed < 4.0
    assert fit_linear([4], [1.0]) is None


def row(ladder, size, rate, engine="fused", worlds=8, n_byte=1000):
    return {
        "workload": f"scalability/{ladder}",
        "inside": "",
        "worlds": worlds,
        "robots": 2,
        "unit": "vehicle-steps/s",
        "median": rate,
        "low": 0.9 * rate,
        "high": 1.1 * rate,
        "repeats": 10,
        "compile_s": 1.0,
        "engine": engine,
        "kernels": "xla",
        "device": "cpu",
        "program_bytes": n_byte,
        "extra": {"size": size},
    }


@pytest.fixture
def file(tmp_path):
    """Time grows as worlds do, not with obstacles; memory as worlds do."""
    path = tmp_path / "cost.jsonl"
    made = [row("worlds", n, 1e6, worlds=n, n_byte=500 * n) for n in (4, 16, 64)]
    made += [row("obstacles", n, 2e6) for n in (4, 16, 64)]
    made += [row("worlds", n, 1e5, engine="mjx", worlds=n) for n in (4, 16)]
    made.append(row("worlds", 4, 1e6, worlds=4, n_byte=2000))  # measured again: the last counts
    made.append(row("worlds", 256, 1e6) | dict.fromkeys(("median", "low", "high")))
    path.write_text("".join(json.dumps(one) + "\n" for one in made))
    return path


def test_lines_hold_what_the_rows_say(file):
    found = {(one.ladder, one.engine): one for one in plot.read_lines(file)}
    assert list(found) == [("worlds", "fused"), ("worlds", "mjx"), ("obstacles", "fused")]
    worlds = found["worlds", "fused"]
    assert worlds.size == (4, 16, 64)
    # 100 steps of two robots in each of n worlds, at 1e6 a second.
    assert worlds.seconds == pytest.approx([2e-4 * n for n in (4, 16, 64)])
    assert worlds.low[0] == pytest.approx(worlds.seconds[0] / 1.1)
    assert worlds.time.exponent == pytest.approx(1.0)
    assert worlds.memory.exponent == pytest.approx(1.0)
    assert found["obstacles", "fused"].time.exponent == pytest.approx(0.0, abs=1e-9)


def test_table_and_figures_are_made_of_them(file, tmp_path, capsys):
    page = tmp_path / "page.md"
    page.write_text(f"before\n{plot.BEGIN}\nold\n{plot.END}\nafter\n")
    plot.main(file, figures=tmp_path / "images", page=page)
    text = page.read_text()
    assert "old" not in text
    assert text.startswith("before")
    assert (
        "| worlds, 8 robots each | fused | 4 | 64 | 0.8 to 12.8 | 1.00 (1.00 to 1.00) | 1.00 | 0 "
        "| 200 |" in text
    )
    for what in ("time", "memory"):
        assert (tmp_path / "images" / f"scalability_{what}.png").stat().st_size > 5_000
    fits = json.loads(file.with_suffix(".fits.json").read_text())
    assert [one["ladder"] for one in fits] == ["worlds", "worlds", "obstacles"]
    assert fits[1]["time"]["low"] is None


def test_rows_that_are_there_are_not_measured_again(file, monkeypatch):
    """The obstacles of this device are all there; of the worlds, the one that was refused too."""
    around = {"device": "cpu"}
    monkeypatch.setattr(cost, "describe_environment", lambda: around)
    measured = []

    def measure(ladder, engine, size, repeats, backend):
        measured.append((ladder.name, engine, size))
        return speed.SpeedRow(
            workload=f"scalability/{ladder.name}", inside="", worlds=size, robots=2,
            unit="vehicle-steps/s", median=1.0, low=1.0, high=1.0, repeats=10, compile_s=0.0,
            engine=engine, extra={"size": float(size)},
        )  # fmt: skip

    monkeypatch.setattr(cost, "measure_row", measure)
    rungs = cost.list_rungs(["worlds", "obstacles"], ["fused", "mjx"], "cpu")
    assert len(list(cost.measure_missing(rungs, file, 10, 1e9))) == len(measured)
    assert measured == [("worlds", "mjx", 64), *[("obstacles", "mjx", n) for n in (4, 16, 64)]]
    assert list(cost.measure_missing(rungs, file, 10, 1e9)) == []
    assert (
        list(cost.measure_missing([*cost.list_rungs(["cells"], ["fused"], "cpu")], file, 10, -1.0))
        == []
    )


@pytest.mark.nightly(by="test_rows_that_are_there_are_not_measured_again")
def test_the_smoke_run_writes_three_rows_and_goes_on(tmp_path, capsys):
    out = tmp_path / "rows.jsonl"
    cost.main(out=out, smoke=True)
    found = speed.read_rows(out)
    assert [row["extra"]["size"] for row in found] == list(cost.SMOKE_SIZES)
    assert all(row["median"] > 0 and row["workload"] == "scalability/dynamics" for row in found)
    (line,) = plot.read_lines(out)
    assert line.memory.exponent == pytest.approx(1.0, abs=0.2)  # bytes of arrays, no timing
    cost.main(out=out, smoke=True)
    assert len(speed.read_rows(out)) == 3


@pytest.mark.parametrize("ladder", ladders.LADDERS, ids=lambda one: one.name)
def test_every_rung_is_a_scenario_with_so_many(ladder):
    for size in {*ladder.gpu, *ladder.cpu, *ladder.mjx} if ladder.key else ():
        made = ladders.build_scenario(ladder, size, "fused")
        counts = {
            "robots": len(made.members()),
            "obstacles": made.world.obstacles.dynamic.count,
            "vortices": made.world.currents[0].count,
            "cells": int(np.prod(made.world.shape)),
            "points": made.planner.points,
        }
        assert counts[ladder.name] == ladder.count(size)
        others = {"robots": 8, "obstacles": 4, "vortices": 4, "cells": 16_384, "points": 32}
        assert {k: v for k, v in counts.items() if k != ladder.name} == {
            k: v for k, v in others.items() if k != ladder.name
        }


def test_unknown_ladders_are_refused():
    with pytest.raises(ConfigError, match="--ladders depth: there is dynamics, worlds"):
        cost.list_rungs(["depth"], ["fused"], "cpu")


@pytest.mark.parametrize(
    ("name", "cells"), [("teams", [18]), ("uncertainty", [3, 4, 8, 4]), ("smoke", [2])]
)
def test_all_cells_of_the_shipped_sweeps_can_be_flown(name, cells):
    assert [len(one.build_request().cells) for one in arrivals.STUDIES[name]] == cells


@pytest.mark.nightly(by="studies/test_sweep.py; test_all_cells_of_the_shipped_sweeps_can_be_flown")
def test_the_smoke_sweep_is_flown_drawn_and_not_flown_again(tmp_path, capsys):
    page = tmp_path / "page.md"
    page.write_text("<!-- smoke: begin -->\n<!-- smoke: end -->\n")
    arrivals.main("uncertainty", out=tmp_path / "out", page=page, smoke=True)
    found = json.loads((tmp_path / "out" / "smoke.json").read_text())
    strong, weak = (one["outcomes"]["reached"] for one in found["cells"])
    assert weak["count"] == 6
    assert 0 < strong["count"] < 6
    assert found["pairs"][0]["teams"]["only_second"] == 6 - strong["count"]
    assert "| 1.5 | 1 | 100.0" in page.read_text()
    assert (tmp_path / "out" / "scalability_smoke.png").exists()
    capsys.readouterr()
    arrivals.main("uncertainty", out=tmp_path / "out", smoke=True)
    assert "run 1 of" not in capsys.readouterr().out
