"""A sweep from its command to its tables, broken off and taken up again, and two runs of it."""

import json
import re
import shutil
import statistics

import pyarrow.parquet as pq
import pytest
from scipy import stats

from angler_mjx.cli.main import main
from angler_mjx.errors import ConfigError, RunError
from angler_mjx.progress import Progress
from angler_mjx.runs import multi_run, rollout
from angler_mjx.runs.storage.folder import Run
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.studies import chart, compare, comparison_report, sweep, tables
from angler_mjx.studies.sweep_axes import parse_axes

SCENARIO = """
schema_version = 1
name = "short"
engine = "fused"
worlds = 6
seed = 3
tile = 6

[time]
horizon_s = 12.0
record_hz = 0.0

[world]
preset = "open"
placement = "given"
start_m = [[0.0, 0.0, -5.0]]
goal_m = [[4.0, 0.0, -5.0]]

[[fleet]]
vehicle = "bluerov2_heavy"

[[world.currents]]
type = "gauss_markov"
max_speed_mps = 1.5
"""
KEY = "world.currents.0.max_speed_mps"
SET = [f"{KEY}=1.5,0.5"]


class Broken(Progress):
    """Someone who presses Ctrl-C when a certain run begins."""

    def __init__(self, at):
        self.at, self.parts = at, []

    def report(self, text):
        if not (begun := re.fullmatch(r"run (\d+) of (\d+): (.*)", text)):
            return
        number = int(begun[1]) - 1
        self.parts.append((number, int(begun[2]), begun[3]))
        if number == self.at:
            raise KeyboardInterrupt


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("sweep") / "short.toml"
    path.write_text(SCENARIO)
    return path


@pytest.fixture(scope="module")
def asked(file):
    return sweep.build_request(load_scenario(file), parse_axes(SET), "short")


@pytest.fixture(scope="module")
def halves(file, asked):
    """What was said after the interruption, and the folder as it is when all is done."""
    out = file.parent / "made"
    broken = sweep.run_sweep(asked, out, progress=Broken(1), processes=None)
    page = (out / sweep.PAGE).read_text()
    line = ["sweep", str(file), "--set", *SET, "--out", str(out), "--resume"]
    main(line)
    return broken, page, out


@pytest.fixture(scope="module")
def made(halves):
    return halves[2]


def rows_of(out, number):
    found = sweep.read_sweep(out)
    return Run(out / found["cells"][number]["run"]).episodes.to_pylist()


def test_an_interrupted_sweep_holds_what_was_finished_and_goes_on(halves):
    broken, page, made = halves
    assert broken["complete"] is False
    assert [row["cell"] for row in broken["cells"]] == [0]
    assert broken["pairs"] == []
    assert "Interrupted" in page
    whole = sweep.read_sweep(made)
    assert whole["complete"] is True
    assert [row["cell"] for row in whole["cells"]] == [0, 1]
    assert whole["cells"][0] == broken["cells"][0]


def test_a_whole_sweep_is_not_taken_up_again(file, asked, made, capsys):
    with pytest.raises(ConfigError, match="this sweep is complete"):
        sweep.run_sweep(asked, made, progress=Broken(None), resume=True)
    other = sweep.build_request(load_scenario(file), parse_axes([f"{KEY}=1.5"]), "short")
    with pytest.raises(ConfigError, match="exists; give another folder"):
        sweep.run_sweep(other, made, progress=Broken(None))
    with pytest.raises(SystemExit) as ended:
        main(["sweep", str(file), "--set", f"{KEY}=0.3,-1", "--out", str(made)])
    assert ended.value.code == 2
    assert "max_speed_mps = -1" in capsys.readouterr().err


def test_a_sweep_of_other_settings_is_not_gone_on_with(file, asked, tmp_path):
    declared = multi_run.declare_folder(
        "sweep", asked.resolved(), models={}, is_complete=sweep.is_complete
    )
    declared.acquire(tmp_path / "out", resume=False)[0].release()
    other = sweep.build_request(load_scenario(file), parse_axes([f"{KEY}=1.5,0.4"]), "short")
    with pytest.raises(ConfigError, match=rf"begun with another set\.{KEY} \(see .*making\.json"):
        sweep.run_sweep(other, tmp_path / "out", progress=Broken(None), resume=True)


def test_an_interruption_before_anything_was_finished_is_one(file, asked):
    with pytest.raises(KeyboardInterrupt):
        sweep.run_sweep(asked, file.parent / "nothing", progress=Broken(0))


def test_a_cell_that_cannot_be_flown_after_all_costs_no_other(file, asked, made, monkeypatch):
    out, first = file.parent / "failed", made / sweep.read_sweep(made)["cells"][0]["run"]

    def fly(scenario, *, out, **how):
        if scenario == asked.cells[1].scenario:
            raise RunError("a world cannot hold the fleet")
        shutil.copytree(first, out)
        return Run(out)

    monkeypatch.setattr(rollout, "rollout", fly)
    with pytest.raises(RunError, match="a world cannot hold the fleet"):
        sweep.run_sweep(asked, out, progress=Broken(None))
    found = sweep.read_sweep(out)
    assert found["complete"] is False
    assert found["cells"] == sweep.read_sweep(made)["cells"][:1]
    assert (out / sweep.PAGE).exists()


def test_the_table_is_what_the_episodes_say(made):
    table = pq.read_table(made / sweep.TABLE).to_pylist()
    assert [row[KEY] for row in table] == [1.5, 0.5]
    for number, row in enumerate(table):
        episodes = rows_of(made, number)
        times = [one["time_to_goal_s"] for one in episodes if one["outcome"] == "reached"]
        assert row["worlds"] == 6
        assert row["reached_rate"] == pytest.approx(len(times) / 6)
        assert row["time_to_goal_s_mean"] == pytest.approx(statistics.mean(times))
        low, high = stats.binomtest(len(times), 6).proportion_ci(0.95, method="wilson")
        assert (row["team_low"], row["team_high"]) == pytest.approx((low, high))


def test_cells_fly_the_same_worlds_so_that_differences_are_paired(made):
    """Who arrives against a strong current does in a weak one, and what is paired says so."""
    strong, weak = rows_of(made, 0), rows_of(made, 1)
    assert [row["world"] for row in strong] == [row["world"] for row in weak] == list(range(6))
    changes = [
        b["time_to_goal_s"] - a["time_to_goal_s"]
        for a, b in zip(strong, weak, strict=True)
        if a["outcome"] == b["outcome"] == "reached"
    ]
    (pair,) = sweep.read_sweep(made)["pairs"]
    assert pair["costs"]["time_to_goal_s"]["pairs"] == len(changes)
    assert pair["costs"]["time_to_goal_s"]["difference"] == pytest.approx(statistics.mean(changes))
    won = sum(a["outcome"] != "reached" == b["outcome"] for a, b in zip(strong, weak, strict=True))
    assert won > len(changes) > 0
    assert pair["teams"]["only_second"] == won
    assert pair["teams"]["only_first"] == 0
    assert pair["share_p"] == pytest.approx(stats.binomtest(won, won).pvalue)


def test_the_table_for_people_says_what_the_episodes_say(made):
    """Numbers as they are printed, against means of rows, in the units of the head."""
    head, rows = tables.cells_table(sweep.read_sweep(made))
    columns = {"time to goal, s": ("time_to_goal_s", 1.0), "energy, kJ": ("energy_j", 1e-3)}
    columns["clearance, m"] = ("min_clearance_m", 1.0)
    for number, row in enumerate(rows):
        episodes = rows_of(made, number)
        for name, (column, scale) in columns.items():
            every = name == "clearance, m"
            values = [x[column] for x in episodes if every or x["outcome"] == "reached"]
            text = row[head.index(name)]
            assert float(text.split()[0]) == pytest.approx(
                scale * statistics.mean(values), rel=1e-3
            )


def test_page_and_figure_are_there(made):
    page = (made / sweep.PAGE).read_text()
    assert f"| {KEY} | robots | planned, % | arrived, % |" in page
    assert f"| {KEY} \\* | 1.5 | 0.5 | - |" in page
    assert (made / sweep.FIGURE).stat().st_size > 10_000


def test_of_scenarios_with_a_task_the_tables_tell_of_it(made):
    """Numbers of two cells, one of which is without; rows say which."""
    found = sweep.read_sweep(made)
    task = {
        "completed": {"count": 3, "rate": 0.5, "low": 0.2, "high": 0.8},
        "completed_s": {"count": 3, "mean": 7.0, "low": None, "high": None},
    }
    first, second = found["cells"]
    mixed = {**found, "cells": [{**first, "task": task}, second]}
    head, rows = tables.cells_table(mixed)
    at = head.index("tasks completed, %")
    assert [row[at : at + 2] for row in rows] == [["50.0 (20.0 to 80.0)", "7"], ["-", "-"]]
    written = tables.build_table(mixed).to_pylist()
    assert [row["task_completed_rate"] for row in written] == [0.5, None]
    assert "tasks completed" not in "".join(tables.cells_table(found)[0])
    both = {**found, "cells": [{**cell, "task": task} for cell in found["cells"]]}
    head = tables.cells_table(both)[0]
    assert head.index("completed after, s") < head.index("time of their part, s")
    assert not [name for name in head if "goal" in name or "arrived" in name]
    head = tables.pairs_table({**both, "pairs": []})[0]
    assert head.index("completed after, s") < head.index("time of their part, s")
    titles = [axes.get_title("left") for axes in chart.plot_sweep(both).axes]
    assert titles[0] == "worlds that completed their task, %"
    assert chart.plot_sweep(mixed).axes[0].get_title("left") == "robots that arrived, %"


@pytest.mark.parametrize("width", [20, 60, 80, 120])
def test_a_table_too_wide_for_the_terminal_lies_on_its_side(width):
    head = ["fleet.0.count", "arrived, %", "time, s"]
    rows = [[str(n), f"{n}0.0 (10.0 to 99.9)", f"{n}.1"] for n in range(8)]
    parts = tables.fit_to_width((head, rows), width)
    if width >= 52:
        assert parts == [(head, rows)]
        return
    lines = [[top, *rest] for top, rest in parts]
    assert all([line[0] for line in part] == head for part in lines)
    assert [[line[k] for line in part] for part in lines for k in range(1, len(part[0]))] == rows
    assert all(len(part[0]) == 2 for part in lines)


def test_two_runs_are_compared_world_by_world(made, capsys, tmp_path):
    paths = [str(made / row["run"]) for row in sweep.read_sweep(made)["cells"]]
    main(["compare", *paths, "--json", "--figure", str(tmp_path / "c.png")])
    found = json.loads(capsys.readouterr().out)
    assert found["config"] == [{"key": KEY, "first": 1.5, "second": 0.5}]
    strong, weak = rows_of(made, 0), rows_of(made, 1)
    ended = [(a["outcome"], b["outcome"]) for a, b in zip(strong, weak, strict=True)]
    assert {(x["first"], x["second"]): x["robots"] for x in found["outcomes"]} == {
        pair: ended.count(pair) for pair in ended
    }
    changed = [x["world"] for x in found["changed"]]
    assert sorted(changed) == [
        i for i in range(6) if strong[i]["time_to_goal_s"] != weak[i]["time_to_goal_s"]
    ]
    others = [i for i in range(6) if ended[i][0] != ended[i][1]]
    assert set(changed[: len(others)]) == set(others)
    assert (tmp_path / "c.png").stat().st_size > 5_000
    text = comparison_report.format_comparison(found)
    assert f"{KEY}: 1.5 -> 0.5" in text
    assert f"world {changed[0]}: 0 -> 1 arrived; robot 0: timeout -> reached" in text


def test_a_run_against_itself_changed_nothing(made):
    run = Run(made / sweep.read_sweep(made)["cells"][1]["run"])
    found = compare.compare_runs(run, run)
    assert found["config"] == []
    assert found["changed"] == []
    assert found["same_problems"]
    assert found["teams"]["p"] == 1.0
    assert "the scenarios are the same" in comparison_report.format_comparison(found)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"seed": 4}, "seed = 3 and 4"),
        ({"worlds": 7}, "worlds = 6 and 7"),
        ({"fleet": [{"vehicle": "bluerov2"}]}, "fleet[0].vehicle = 'bluerov2_heavy' and"),
    ],
)
def test_runs_that_are_no_pairs_are_refused_by_the_key(made, tmp_path, change, said):
    place = made / sweep.read_sweep(made)["cells"][0]["run"]
    other = tmp_path / "other"
    other.mkdir()
    for path in place.iterdir():
        if path.is_file():
            (other / path.name).write_bytes(path.read_bytes())
    config = json.loads((place / "config.json").read_text())
    (other / "config.json").write_text(json.dumps(config | change))
    with pytest.raises(ConfigError) as caught:
        compare.compare_runs(Run(place), Run(other))
    assert said in str(caught.value)


def test_differences_name_the_innermost_key():
    first = {"a": 1, "b": {"c": [1, 2], "d": 0}, "e": [{"f": 1}, {"f": 2}]}
    second = {"a": 1, "b": {"c": [1, 3], "d": 0}, "e": [{"f": 1}, {"f": 4, "g": 5}]}
    assert compare.find_differences(first, second) == {
        "b.c": ([1, 2], [1, 3]),
        "e.1.f": (2, 4),
        "e.1.g": (None, 5),
    }
    assert compare.find_differences(first, first) == {}
