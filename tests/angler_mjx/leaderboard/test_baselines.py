"""Baselines made part by part, interrupted and continued; films of their flights."""

import json
import os
from importlib import resources
from pathlib import Path

import pytest

from angler_mjx.cli import leaderboard as commands
from angler_mjx.cli.main import main
from angler_mjx.errors import ConfigError
from angler_mjx.leaderboard import (
    baselines,
    checking,
    entering,
    films,
    problem_files,
    problem_sets,
    set_scenarios,
)
from angler_mjx.planning import register
from angler_mjx.progress import Progress
from angler_mjx.runs import device_processes

from .test_scores import result, row


def test_every_planner_for_teams_is_a_baseline():
    names = [baseline.name for baseline in baselines.BASELINES]
    assert len(set(names)) == len(names) == 18
    # What robots carry together and checkpoints are not asked for here.
    installed = set(register.planner_names())
    assert set(names) - {"mppi"} == installed - {"carry", "carry_ompl", "learned"}


def test_planners_enter_with_the_settings_of_their_baseline(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(
        entering, "plan_submission", lambda out, table, *_, **__: asked.append(table)
    )
    for name in ("current", "grid", "mine.py:Mine"):
        main(["leaderboard", "plan", "--planner", name, "--out", str(tmp_path)])
    monkeypatch.setattr(checking, "check_submission", lambda *_, **__: False)
    making = baselines.make_baselines(
        baselines.select_baselines(["current"]),
        tmp_path / "made",
        tmp_path / "store",
        Progress(),
        sets=("open-ocean-known-01",),
    )
    with pytest.raises(KeyboardInterrupt):
        next(making)
    assert asked.pop() == asked[0]
    assert asked == [
        {"name": "current", "current": {"limit_ground_speed": True}},
        {"name": "grid"},
        {"name": "mine.py:Mine"},
    ]
    benchmark, manifest = problem_sets.load_benchmark(), problem_files.public_manifest()
    (ocean,) = problem_sets.select_problem_sets(benchmark, ("open-ocean-known-01",))
    attempt = manifest.find(ocean.name).attempt
    scenario = problem_files.build_set_scenario(benchmark, ocean, attempt, problem_sets.PUBLIC)
    planned = set_scenarios.build_planned_scenario(scenario, asked[0], "baselines")
    assert planned.planner.planner_spec().settings == {"limit_ground_speed": True}


def test_an_unknown_baseline_is_refused():
    with pytest.raises(ConfigError, match="--only 'nobody': no such baseline; there is priority"):
        baselines.select_baselines(["nobody"])


def test_sets_that_a_planner_does_not_take_are_named_with_the_reason(tmp_path):
    said = []
    progress = Progress()
    progress.report = said.append
    nobody = [baselines.Baseline(name="nobody")]
    made = baselines.make_baselines(
        nobody, tmp_path, tmp_path / "store", progress, sets=("open-still-known-01",)
    )
    assert list(made) == []
    (line,) = said
    assert line.startswith("nobody does not enter 1 of 1 sets: open-still-known-01: ")
    assert "'nobody'" in line


def test_planners_of_the_composite_space_enter_for_teams_of_up_to_eight(tmp_path):
    said = []
    progress = Progress()
    progress.report = said.append
    (chosen,) = baselines.select_baselines(["RRTstar"])
    made = baselines.make_baselines(
        [chosen], tmp_path, tmp_path / "store", progress, sets=("reef-still-known-16",)
    )
    assert list(made) == []
    assert said == [
        "RRTstar does not enter 1 of 1 sets: reef-still-known-16: it enters for teams of up to 8 "
        "robots"
    ]
    benchmark, manifest = problem_sets.load_benchmark(), problem_files.public_manifest()
    (largest,) = problem_sets.select_problem_sets(benchmark, ("reef-still-known-08",))
    assert baselines._find_refusal(chosen, benchmark, largest, manifest) == ""


def test_stored_results_are_of_the_frozen_problems_and_as_the_page_says(manifest, sets):
    folder = resources.files("angler_mjx.leaderboard.data") / "baselines"
    stored = {path.name: json.loads(path.read_text()) for path in folder.iterdir()}
    page = Path("docs/reference/angler_1.md").read_text()
    assert "priority.json" in stored
    for name, table in stored.items():
        assert table["problems_sha256"] == manifest.sha256()
        problems = [
            f"{entry}/{i}" for entry in table["entered"] for i in range(sets[entry].problems)
        ]
        assert sorted(row["problem"] for row in table["scores"]) == sorted(problems)
        solved = [row for row in table["scores"] if row["solved"]]
        assert all(row["arrived"] == row["robots"] for row in solved)
        planner = name.removesuffix(".json")
        rates = " | ".join(solved_percent(table, robots) for robots in (1, 2, 4, 8, 16, 32, 64))
        assert f"| `{planner}` | {len(solved)} of {len(problems)} | {rates} |" in page


def solved_percent(table, robots):
    """Return the solved problems of teams of one size in percent; a dash if there are none."""
    solved = [row["solved"] for row in table["scores"] if row["robots"] == robots]
    return f"{100 * sum(solved) / len(solved):.0f}" if solved else "&ndash;"


def part(name, *sets, **more):
    rows = [row(entry, int(entry[-2:])) for entry in sets]
    table = result(name, rows=rows, planned_on={"machine": "A Core", "factor": 1.0})
    return table | {"entered": list(sets)} | more


def test_parts_are_merged_in_their_order():
    parts = [
        part("a", "open-still-known-01", "reef-still-known-01"),
        part("a", "open-still-known-02", planned_on={"machine": "A Core", "factor": 1.2}),
        part("a", "open-still-known-04", planned_on={"machine": "A Card", "factor": 1.0}),
    ]
    parts[2]["card"] = {**parts[2]["card"], "machine": "A Card"}
    parts[1]["judged_on"] = "A Card"
    merged = baselines.merge_results(parts, "a")
    every = [
        "open-still-known-01",
        "reef-still-known-01",
        "open-still-known-02",
        "open-still-known-04",
    ]
    assert merged["entered"] == merged["card"]["sets"] == every
    assert [score["set"] for score in merged["scores"]] == every
    # Board and card name every machine once.
    assert merged["planned_on"] == {"machine": "A Core; A Card", "factor": 1.2}
    assert merged["card"]["machine_factor"] == 1.2
    assert merged["judged_on"] == f"{parts[0]['judged_on']}; A Card"
    assert merged["card"]["machine"] == "A Card"


def test_parts_of_different_physics_are_not_merged():
    parts = [
        part("a", "open-still-known-01"),
        part("a", "open-still-known-02", physics={"angler-mjx": "0.3.0", "commit": None}),
    ]
    with pytest.raises(ConfigError, match="a: its parts have different physics"):
        baselines.merge_results(parts, "a")


@pytest.fixture
def judged(monkeypatch):
    """Planning and checking that take no time; the second check is interrupted once."""
    calls = []

    def plan_submission(out, planner, progress, *, manifest, name, sets, workers, processes):
        assert processes == (2 if out.parent.name == "all" else 1)
        calls.append(("plan", name, sets))

    def check_submission(source, out, progress, *, manifest, resume, keep_flights, processes):
        assert processes == (2 if out.parent.name == "all" else 1)
        calls.append(("check", out.parent.name, resume))
        if calls.count(("check", "02", False)) == 1 and not resume and out.parent.name == "02":
            (out.parent / f".{out.name}.partial").mkdir(parents=True)
            return False
        robots = out.parent.name
        out.mkdir(parents=True)
        sizes = ("01", "02") if robots == "all" else (robots,)
        names = [f"open-still-known-{size}" for size in sizes]
        (out / "result.json").write_text(json.dumps(part(out.parent.parent.name, *names)))
        return True

    monkeypatch.setattr(entering, "plan_submission", plan_submission)
    monkeypatch.setattr(checking, "check_submission", check_submission)
    return calls


def test_an_interrupted_baseline_goes_on_where_it_was(judged, tmp_path):
    chosen = baselines.select_baselines(["priority"])
    arguments = (chosen, tmp_path / "work", tmp_path / "store", Progress())
    sets = ("open-still-01", "open-still-02")
    making = baselines.make_baselines(*arguments, sets=sets)
    path = next(making)
    assert path == tmp_path / "store/priority.json"
    assert json.loads(path.read_text())["entered"] == ["open-still-known-01"]
    with pytest.raises(KeyboardInterrupt):
        next(making)
    judged.clear()
    for _ in baselines.make_baselines(*arguments, sets=sets):
        pass
    assert judged == [("plan", "priority", ("open-still-known-02",)), ("check", "02", True)]
    entered = json.loads(path.read_text())["entered"]
    assert entered == ["open-still-known-01", "open-still-known-02"]


def test_several_processes_make_all_teams_at_once(judged, tmp_path):
    chosen = baselines.select_baselines(["priority"])
    arguments = (chosen, tmp_path / "work", tmp_path / "store", Progress())
    sets = ("open-still-01", "open-still-02")
    (path,) = baselines.make_baselines(*arguments, sets=sets, processes=2)
    names = ("open-still-known-01", "open-still-known-02")
    assert judged == [("plan", "priority", names), ("check", "all", False)]
    assert json.loads(path.read_text())["entered"] == list(names)
    with pytest.raises(ConfigError, match="open-still-known-01 was judged in two parts"):
        list(baselines.make_baselines(*arguments, sets=sets[:1]))


def test_a_policy_enters_by_a_card_in_flight(judged, tmp_path):
    chosen = baselines.select_baselines(["mppi"])
    list(
        baselines.make_baselines(
            chosen, tmp_path / "work", tmp_path / "store", Progress(), sets=("open-still-01",)
        )
    )
    card = baselines.submission.read_card(tmp_path / "work/mppi/01/submission")
    assert (card.kind, card.in_flight.policy) == ("in_flight", {"name": "mppi"})
    assert judged == [("check", "01", False)]
    benchmark = problem_sets.load_benchmark()
    assert card.benchmark == benchmark.title


def test_films_show_the_best_of_the_largest_team_and_the_worst():
    lost = {"solved": False, "makespan_s": None, "arrived": 0}
    late = row("dense-ocean-known-01", 1, reason="planned for 1.13 s, at most 1 s", **lost)
    rows = [
        row("open-still-known-01", 1, makespan_s=51.0),
        row("open-still-known-08", 8, makespan_s=70.0),
        row("reef-still-known-08", 8, makespan_s=60.0),
        row("dense-still-known-08", 8, reason="robot 1: timeout", **lost | {"arrived": 7}),
        row("dense-still-known-04", 4, reason="robot 3: timeout", **lost | {"arrived": 1}),
    ]
    chosen = films.choose_flights(rows)
    assert {label: found["set"] for label, found in chosen.items()} == {
        "best": "reef-still-known-08",
        "worst": "dense-still-known-04",
    }
    # Robots of late plans may all have arrived.
    assert films.choose_flights([*rows, late]) == chosen
    assert films.choose_flights([*rows[:3], late])["worst"] == late
    chosen = films.choose_flights(rows[:3])
    assert chosen["worst"]["set"] == "open-still-known-08"
    assert set(films.choose_flights(rows[:1])) == {"best"}
    assert set(films.choose_flights(rows[4:])) == {"worst"}


def test_a_check_without_flights_cannot_be_filmed(tmp_path, capsys):
    (tmp_path / "result.json").write_text(json.dumps(part("a", "open-still-known-01")))
    with pytest.raises(SystemExit):
        main(["leaderboard", "films", str(tmp_path), "--out", str(tmp_path / "films")])
    assert "--keep-flights keeps them" in capsys.readouterr().err


def test_no_process_takes_the_memory_of_the_others(monkeypatch):
    """To look for a GPU starts it: how much memory it takes must be decided by then."""
    seen = []
    monkeypatch.delenv(device_processes.PREALLOCATION, raising=False)
    monkeypatch.setattr(
        commands,
        "choose_device",
        lambda device: seen.append((device, os.environ.get(device_processes.PREALLOCATION))),
    )
    assert commands._begin_processes("gpu", 3) == 3
    assert seen == [("gpu", "false")]
    with pytest.raises(ConfigError, match="--processes 0: must be at least 1"):
        commands._begin_processes(None, 0)
