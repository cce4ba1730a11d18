"""A submission flown and judged: what solves a problem, and what fails it."""

import json
import os
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.leaderboard import (
    check_results,
    checking,
    entering,
    problem_files,
    problem_sets,
    program_images,
    set_scenarios,
)
from angler_mjx.leaderboard.board import BASELINES
from angler_mjx.leaderboard.submission import Card, InFlightConfig
from angler_mjx.leaderboard.submitted_plans import PlanRows, empty_rows
from angler_mjx.progress import Progress
from angler_mjx.runs.simulator.world_preparation import check_planner

from .submitting import straight_lines, write_card, write_plans

NAME, MISSING = "open-still-known-01", "open-ocean-known-01"
STORED = json.loads((problem_sets.data_folder() / BASELINES / "grid.json").read_text("utf-8"))


@pytest.fixture(scope="module")
def result(tmp_path_factory, problems, manifest):
    """One straight line, one with NaN, and a set without a file, judged in two processes."""
    folder = tmp_path_factory.mktemp("submission")
    write_card(folder, [NAME, MISSING])
    arrays, attributes = straight_lines(problems, NAME)
    arrays["position_m"][1, 0, 1, 2] = np.nan
    write_plans(folder, NAME, arrays, attributes)
    out = tmp_path_factory.mktemp("checks") / "check"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(checking, "ROBOTS_PER_PROCESS", 1)
        assert checking.check_submission(folder, out, Progress(), manifest=manifest)
    return out


def scores(result):
    return {
        row["problem"]: row for row in json.loads((result / "result.json").read_text())["scores"]
    }


def checked_set(benchmark, entry, rows, **options):
    return checking.CheckedSet(
        entry=entry,
        scenario=problem_sets.build_scenario(benchmark, entry, 1),
        rows=rows,
        bound_s=(60.0, 60.0),
        **options,
    )


def test_a_straight_line_in_open_water_is_solved(result, problems):
    row = scores(result)[f"{NAME}/0"]
    arrays, _ = straight_lines(problems, NAME)
    line_s = float(arrays["time_s"][0, 0, 1])
    assert row["solved"]
    assert (row["reason"], row["planned"], row["arrived"]) == ("", 1, 1)
    assert row["bound_s"] == pytest.approx(line_s, abs=1e-3)
    # It has arrived 0.3 m before the end of the line, and flies 0.5 m/s.
    assert line_s - 0.6 <= row["makespan_s"] < line_s + 5.0
    assert row["planning_s"] == pytest.approx(0.01)
    episodes = pq.read_table(result / "runs" / NAME / "episodes.parquet").to_pylist()
    assert row["energy_j"] == pytest.approx(episodes[0]["energy_j"])
    assert row["clearance_m"] == pytest.approx(episodes[0]["min_clearance_m"])


def test_the_straight_line_flies_as_the_stored_baseline_that_plans_it(result):
    """Whatever changes this changes the benchmark's physics, and makes a version of its own."""
    (stored,) = [row for row in STORED["scores"] if row["problem"] == f"{NAME}/0"]
    row = scores(result)[f"{NAME}/0"]
    # Flown on a GPU there: a control step, and single precision over the flight.
    assert row["makespan_s"] == pytest.approx(stored["makespan_s"], abs=0.051)
    assert row["energy_j"] == pytest.approx(stored["energy_j"], rel=1e-4)
    assert row["clearance_m"] == pytest.approx(stored["clearance_m"], abs=1e-4)


def test_nan_fails_its_problem_alone(result):
    row = scores(result)[f"{NAME}/1"]
    assert (row["solved"], row["planned"], row["arrived"], row["makespan_s"]) == (False, 0, 0, None)
    assert row["reason"] == "robot 0 has no plan: has NaN or infinite numbers"


def test_a_set_without_a_file_fails(result):
    for world in range(2):
        row = scores(result)[f"{MISSING}/{world}"]
        assert not row["solved"]
        assert row["reason"] == f"{MISSING}.zarr is missing"
    assert not (result / "runs" / MISSING).exists()


def test_a_result_says_what_was_judged_and_keeps_no_trajectories(result, manifest):
    table = check_results.read_result(result)
    assert table["problems_sha256"] == manifest.sha256()
    assert table["entered"] == [NAME, MISSING]
    assert (table["hidden"], table["card"]["name"]) == (False, "straight lines")
    assert not list(result.glob("runs/*/trajectories.zarr"))
    assert (result / "card.toml").exists()
    assert not (result / "answers").exists()


def test_processes_side_by_side_judge_the_same(result, tmp_path, problems, manifest):
    write_card(tmp_path / "s", [NAME, MISSING])
    for name in (NAME, MISSING):
        write_plans(tmp_path / "s", name, *straight_lines(problems, name))
    out = tmp_path / "check"
    assert checking.check_submission(
        tmp_path / "s", out, Progress(), manifest=manifest, processes=2
    )
    rows = scores(out)
    assert rows[f"{NAME}/0"] == scores(result)[f"{NAME}/0"]
    assert [row["planned"] for row in rows.values()] == [1, 1, 1, 1]
    assert all((out / "runs" / name / "summary.json").is_file() for name in (NAME, MISSING))


def test_runs_of_the_same_programs_are_flown_by_one_process(monkeypatch, tmp_path, benchmark, sets):
    names = ["open-still-known-01", "reef-still-known-01", "corridor-still-known-01"]
    names += ["reef-ocean-observed-01", "dense-ocean-known-01", "open-still-known-64"]
    flown = []
    monkeypatch.setattr(
        checking.multi_run, "fly_groups", lambda groups, *_: flown.extend(groups) or True
    )
    checked = [checked_set(benchmark, sets[name], None) for name in names]
    assert checking._fly_sets(checked, tmp_path, Progress(), 4)
    groups = [{path.removeprefix("runs/") for path, _ in group.parts} for group in flown]
    assert groups == [{names[5]}, set(names[:2]), {names[2]}, {names[4], names[3]}]


def test_each_world_gets_the_verdict_on_its_flights(result, monkeypatch, benchmark, sets):
    """A set that is not flown has none."""
    monkeypatch.setattr(checking, "_judge_world", lambda judged: f"{judged[0].name} {judged[1]}")
    empty = empty_rows(sets[MISSING], "missing")
    checked = [
        checked_set(benchmark, sets[name], rows) for name, rows in ((MISSING, empty), (NAME, None))
    ]
    reasons = [score.reason for score in checking._judge_sets(checked, result, Progress())]
    assert reasons == ["missing", "missing", f"{NAME} 0", f"{NAME} 1"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "angler leaderboard check makes one"),
        ('{"benchmark": "ANGLER-0 1.0"}', "is of 'ANGLER-0 1.0'"),
        ("{]", "result.json"),
    ],
)
def test_a_result_that_cannot_be_read_is_refused(tmp_path, content, message):
    if content is not None:
        (tmp_path / "result.json").write_text(content)
    with pytest.raises(ConfigError, match=message):
        check_results.read_result(tmp_path)


@pytest.mark.parametrize("kind", ["pipe", "link to a device"])
def test_a_submission_that_would_be_read_for_ever_is_refused(tmp_path, manifest, kind):
    write_card(tmp_path / "s", [NAME])
    strange = tmp_path / "s" / "notes"
    os.mkfifo(strange) if kind == "pipe" else strange.symlink_to("/dev/zero")
    with pytest.raises(ConfigError, match="s/notes: is a pipe or device"):
        checking.check_submission(tmp_path / "s", tmp_path / "o", Progress(), manifest=manifest)
    assert not (tmp_path / "o").exists()


def test_an_interrupted_check_goes_on_with_plans_and_times_of_its_programs(
    tmp_path, monkeypatch, problems, manifest, sets
):
    """Run again, they would be timed otherwise than what is flown."""
    write_card(tmp_path / "s", [NAME], kind=('kind = "plans"', 'kind = "program"'))
    with (tmp_path / "s" / "card.toml").open("a") as file:
        file.write('[program]\ncommand = ["./a"]\n')
    (tmp_path / "s" / "program").mkdir()
    arrays, _ = straight_lines(problems, NAME)
    runs, factors = iter([(1.8, 0.2), (0.1, 0.1)]), iter([2.0, 9.0])

    def plan_set(*arguments):
        return PlanRows(arrays=dict(arrays), planning_s=np.array(next(runs)), faults=["", "late"])

    del arrays["planning_s"]
    monkeypatch.setattr(checking.sandbox, "require_sandbox", lambda: "bwrap")
    monkeypatch.setattr(checking.sandbox, "plan_set", plan_set)
    monkeypatch.setattr(checking.graph_search, "measure_time_factor", lambda: next(factors))
    fly_sets, out = checking._fly_sets, tmp_path / "o"
    monkeypatch.setattr(checking, "_fly_sets", lambda *_: False)
    assert not checking.check_submission(tmp_path / "s", out, Progress(), manifest=manifest)
    monkeypatch.setattr(checking, "_fly_sets", fly_sets)
    assert checking.check_submission(
        tmp_path / "s", out, Progress(), manifest=manifest, resume=True
    )
    first, second = scores(out).values()
    assert (first["solved"], first["planning_s"], first["time_factor"]) == (True, 0.9, 2.0)
    assert (second["solved"], second["reason"], second["planning_s"]) == (False, "late", 0.1)
    assert check_results.read_result(out)["planned_on"]["factor"] == 2.0
    assert sorted(path.name for path in out.iterdir()) == ["card.toml", "result.json", "runs"]


def test_a_program_must_be_there(tmp_path, manifest):
    kind = ('kind = "plans"', 'kind = "program"')
    write_card(tmp_path / "s", [NAME], kind=kind)
    with (tmp_path / "s" / "card.toml").open("a") as file:
        file.write('[program]\ncommand = ["./a"]\n')
    (tmp_path / "s" / "program").symlink_to("/usr")
    with pytest.raises(ConfigError, match="program: must be a folder"):
        checking.check_submission(tmp_path / "s", tmp_path / "o", Progress(), manifest=manifest)


def write_image_card(folder):
    write_card(folder, [NAME], kind=('kind = "plans"', 'kind = "program"'))
    with (folder / "card.toml").open("a") as file:
        file.write('[program]\ncommand = ["./a"]\nimage = "image.tar"\n')


def test_an_image_that_is_a_link_is_refused(tmp_path, manifest):
    write_image_card(tmp_path / "s")
    (tmp_path / "image").touch()
    (tmp_path / "s" / "image.tar").symlink_to(tmp_path / "image")
    with pytest.raises(ConfigError, match=r"card.toml: program.image = 'image.tar': is a link; "):
        checking.check_submission(tmp_path / "s", tmp_path / "o", Progress(), manifest=manifest)


def test_an_image_is_unpacked_once_and_its_fault_fails_all_problems(
    tmp_path, monkeypatch, manifest
):
    """A program with an image needs no folder."""
    write_image_card(tmp_path / "s")
    monkeypatch.setattr(checking.sandbox, "require_sandbox", lambda: "bwrap")
    monkeypatch.setattr(checking.graph_search, "measure_time_factor", lambda: 1.0)
    unpacked, unpack = [], program_images._unpack
    monkeypatch.setattr(
        program_images, "_unpack", lambda *paths: unpacked.append(paths) or unpack(*paths)
    )
    out, judge_sets = tmp_path / "o", checking._judge_sets
    monkeypatch.setattr(checking, "_judge_sets", interrupt)
    with pytest.raises(KeyboardInterrupt):
        checking.check_submission(tmp_path / "s", out, Progress(), manifest=manifest)
    monkeypatch.setattr(checking, "_judge_sets", judge_sets)
    assert checking.check_submission(
        tmp_path / "s", out, Progress(), manifest=manifest, resume=True
    )
    assert [row["reason"] for row in scores(out).values()] == ["image.tar is missing"] * 2
    assert len(unpacked) == 1
    assert not unpacked[0][1].exists()


def interrupt(*_):
    raise KeyboardInterrupt


@pytest.mark.parametrize("planner", ["grid", "RRTConnect"])
def test_hidden_problems_are_planned_and_judged_without_telling_the_seed(
    tmp_path, benchmark, sets, planner
):
    name, secret = NAME, b"0123456789abcdef"
    hidden = problem_files.write_problem_files(
        benchmark, [sets[name]], tmp_path / "p", Progress(), secret=secret
    )
    entering.plan_submission(
        tmp_path / "s",
        {"name": planner},
        Progress(),
        manifest=hidden,
        name=planner,
        sets=(name,),
        secret=secret,
        workers=1,
    )
    out = tmp_path / "o"
    assert checking.check_submission(
        tmp_path / "s", out, Progress(), manifest=hidden, secret=secret
    )
    assert [row["solved"] for row in scores(out).values()] == [True, True]
    assert check_results.read_result(out)["hidden"]
    seed = problem_sets.derive_seed(benchmark, name, secret, hidden.find(name).attempt)
    published = [*(tmp_path / "s").rglob("*"), out / "result.json", *(tmp_path / "p").rglob("*")]
    assert not [p for p in published if p.is_file() and str(seed).encode() in p.read_bytes()]


def test_a_card_that_enters_none_of_the_judged_sets_is_refused(tmp_path, manifest):
    write_card(tmp_path / "s", [NAME])
    with pytest.raises(ConfigError, match="enters none of them"):
        checking.check_submission(
            tmp_path / "s", tmp_path / "o", Progress(), manifest=manifest, sets=("reef-04",)
        )


@pytest.mark.parametrize(
    ("levels", "wanted", "expected"),
    [
        (("truth", "truth"), None, ("truth", "truth")),
        (("observed", "observed"), None, ("observed", "observed")),
        (("observed", "observed"), ("truth", "predicted"), ("observed", "observed")),
        (("truth", "truth"), ("observed", "nothing"), ("observed", "nothing")),
        (("predicted", "observed"), ("truth", "nothing"), ("predicted", "nothing")),
    ],
)
def test_nobody_gets_more_information_than_the_set_has(levels, wanted, expected):
    names = ("obstacles", "current")
    table = None if wanted is None else dict(zip(names, wanted, strict=True))
    limited = set_scenarios.limit_information(dict(zip(names, levels, strict=True)), table)
    assert tuple(limited[name] for name in names) == expected


def test_a_policy_flies_with_the_information_of_the_set(benchmark, sets):
    scenario = problem_sets.build_scenario(benchmark, sets["reef-moving-observed-02"], 1)
    wanted = {"name": "mppi", "information": {"obstacles": "truth", "current": "truth"}}
    flown = set_scenarios.build_flown_scenario(scenario, InFlightConfig(policy=wanted), "card.toml")
    assert flown.policy.name == "mppi"
    assert flown.policy.information.model_dump() == {"obstacles": "observed", "current": "observed"}
    assert flown.digest() == scenario.digest()
    # The planner that a policy does not use must not refuse the problems.
    check_planner(flown)
    strange = InFlightConfig(planner={"worlds": 3, "replan_hz": 1.0})
    with pytest.raises(ConfigError, match="worlds"):
        set_scenarios.build_flown_scenario(scenario, strange, "card.toml")


def test_the_policy_that_flies_plans_is_none(benchmark, sets):
    scenario = problem_sets.build_scenario(benchmark, sets["reef-moving-known-02"], 1)
    planner = {"name": "grid", "replan_hz": 1.0}
    flown = [
        set_scenarios.build_flown_scenario(
            scenario, InFlightConfig(planner=planner, policy=policy), "card.toml"
        )
        for policy in ({}, {"name": "none"})
    ]
    assert flown[0] == flown[1]


def test_a_planner_in_flight_gets_the_highest_level_that_it_can_use(benchmark, sets):
    scenario = problem_sets.build_scenario(benchmark, sets["reef-moving-known-02"], 1)
    flown = set_scenarios.build_flown_scenario(
        scenario, InFlightConfig(planner={"name": "grid", "replan_hz": 1.0}), "card.toml"
    )
    assert flown.planner.information.model_dump() == {"obstacles": "truth", "current": "nothing"}


@pytest.mark.parametrize(
    ("seconds", "factor", "reason"),
    [
        (0.9, 1.0, ""),
        (1.1, 1.0, "planned for 1.1 s, at most 1 s"),
        (1.003, 1.0, "planned for 1.003 s, at most 1 s"),
        (1.9, 2.0, ""),
        (0.9, 0.5, "planned for 1.8 s (divided by the factor 0.50), at most 1 s"),
        (np.nan, 1.0, "states no planning time (planning_s)"),
    ],
)
def test_planning_times_are_limited_after_division_by_the_factor(
    benchmark, sets, seconds, factor, reason
):
    rows = empty_rows(replace(sets[NAME], problems=1), "")
    timed = replace(rows, planning_s=np.array([seconds]))
    one = checked_set(benchmark, sets[NAME], timed, time_factor=factor)
    assert checking._find_late(one, 0) == reason


@pytest.mark.parametrize(
    ("seconds", "fault", "verdict", "arrived"),
    [
        (0.9, "", "", 1),
        (1.1, "", "", 0),
        (0.9, "cut", "", 0),
        (0.9, "", "the referee disagrees", 0),
    ],
)
def test_plans_that_are_late_or_have_a_fault_bring_no_robot_to_its_goal(
    benchmark, sets, seconds, fault, verdict, arrived
):
    episode = {
        "outcome": "reached",
        "plan_reason": "",
        "planned": True,
        "robot": 0,
        "time_to_goal_s": 60.0,
        "energy_j": 900.0,
        "min_clearance_m": 1.0,
        "min_separation_m": None,
    }
    rows = replace(
        empty_rows(replace(sets[NAME], problems=1), ""),
        planning_s=np.array([seconds]),
        faults=[fault],
    )
    one = checked_set(benchmark, sets[NAME], rows, time_factor=1.0)
    score = checking._flown_score(one, 0, [episode], verdict)
    assert (score.solved, score.arrived, score.time_factor) == (arrived == 1, arrived, 1.0)
    assert score.makespan_s == (60.0 if arrived else None)


def test_a_problem_that_nobody_flies_has_the_reason_of_its_file(benchmark, sets):
    rows = replace(empty_rows(replace(sets[NAME], problems=2), ""), notes={(1, 0): "walled in"})
    rows = replace(rows, faults=["", ""])
    one = checked_set(benchmark, sets[NAME], rows)
    reasons = [checking._unflown_score(one, world).reason for world in range(2)]
    assert reasons == ["robot 0 has no plan: no path", "robot 0 has no plan: walled in"]


@pytest.mark.parametrize(
    ("kind", "device", "machine"),
    [
        ("plans", "gpu", "theirs"),
        ("program", "gpu", "our core"),
        ("in_flight", "cpu", "our core"),
        ("in_flight", "gpu", "gpu"),
    ],
)
def test_planning_times_are_of_the_machine_that_planned(monkeypatch, kind, device, machine):
    monkeypatch.setattr(checking, "processor_name", lambda: "our core")
    tables = {
        "plans": {},
        "program": {"program": {"command": ("./a",)}},
        "in_flight": {"in_flight": {"policy": {"name": "mppi"}}},
    }
    card = Card(benchmark="b", name="n", kind=kind, machine="theirs", **tables[kind])
    assert checking._name_machine(card, device) == machine
