"""What a benchmark's results folder holds, against the planners that it asked."""

import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time

import numpy as np
import pyarrow.parquet as pq
import pytest

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.studies.benchmark import folder_comparison, running
from angler_mjx.studies.benchmark import path_archive as bytes_of
from angler_mjx.studies.benchmark.store import BenchmarkStore

from .conftest import PLANNERS, Interrupting, rows, workers

STRAIGHT, MOODY, LAZY = "Straight", "Moody", "lazy <one>"


@pytest.fixture(scope="module")
def folder(made):
    return made[0]


@pytest.fixture(scope="module")
def runs(folder):
    table = pq.read_table(folder / "runs.parquet").to_pylist()
    return {(row["planner"], row["world"]): row for row in table}


@pytest.fixture(scope="module")
def robots(folder):
    table = pq.read_table(folder / "robots.parquet").to_pylist()
    made = {}
    for row in table:
        made.setdefault(row["run"], []).append(row)
    return made


def test_every_planner_is_asked_every_problem_and_closed_where_it_is_hopeless(runs):
    assert {key[0] for key in runs} == {STRAIGHT, MOODY, LAZY}
    assert {key[1] for key in runs} == {0, 1, 2, 3}
    status = {key: row["plan_status"] for key, row in runs.items()}
    assert [status[STRAIGHT, w] for w in range(4)] == ["planned"] * 4
    assert [status[MOODY, w] for w in range(4)] == ["planned", "error", "partial", "planned"]
    assert [status[LAZY, w] for w in range(4)] == ["none"] * 3 + ["closed"]
    line = next(i for i, text in enumerate(PLANNERS.splitlines(), 1) if "no idea" in text)
    assert runs[MOODY, 1]["plan_reason"] == f"ValueError: no idea (planners.py:{line})"
    assert runs[MOODY, 2]["plan_reason"] == "robot 0: not today"
    assert runs[LAZY, 0]["plan_reason"] == "too far"
    assert "first 3 problems" in runs[LAZY, 3]["plan_reason"]
    assert runs[LAZY, 3]["run"] is None
    assert runs[LAZY, 3]["planning_s"] is None


def test_what_was_finished_before_an_interruption_is_neither_lost_nor_done_again(made):
    folder, kept = made
    assert len(kept) >= 5
    now = rows(folder / "results.sqlite", "SELECT id, plannerid, world, time FROM runs")
    assert set(kept) <= set(now)
    assert len(now) == 11
    assert len({(planner, world) for _, planner, world, _ in now}) == 11


def test_measures_of_straight_plans_are_those_of_straight_lines(runs, folder):
    plans = rows(folder / "results.sqlite", "SELECT runid, paths FROM plans")
    unpacked = {run: bytes_of.unpack_paths(data) for run, data in plans}
    for world in range(4):
        row = runs[STRAIGHT, world]
        paths = unpacked[row["run"]]
        lengths = [np.linalg.norm(path.position_m[1] - path.position_m[0]) for path in paths]
        ends = [path.time_s[1] for path in paths]
        assert row["robots"] == row["robots_planned"] == len(paths) == 2
        assert row["plan_length_m"] == pytest.approx(sum(lengths), rel=1e-6)
        assert row["plan_makespan_s"] == pytest.approx(max(ends), rel=1e-6)
        assert row["plan_flowtime_s"] == pytest.approx(sum(ends), rel=1e-6)
        assert row["plan_turn_rad"] == 0.0
        assert 0.0 < row["planning_s"] < 2.0
        assert row["plan_length_m"] <= row["straight_m"] * (1 + 1e-6)
        assert 0.0 < row["density"] < 1.0
        assert row["path_ratio"] >= 1.0


def test_flights_add_up_from_their_robots(runs, robots):
    for row in runs.values():
        own = robots.get(row["run"], [])
        assert row["flown"] == bool(own) == (row["robots_planned"] not in (None, 0))
        if not own:
            assert row["energy_j"] is None
            assert not row["success"]
            continue
        ended = [robot["outcome"] for robot in own]
        assert row["robots_reached"] == ended.count("reached")
        assert row["success"] == (row["planned"] and set(ended) == {"reached"})
        assert row["energy_j"] == pytest.approx(sum(robot["energy_j"] for robot in own))
        assert row["min_clearance_m"] == min(robot["min_clearance_m"] for robot in own)
        assert (row["makespan_s"] is not None) == row["success"]
        failed = [robot for robot in own if robot["outcome"] != "reached"]
        if failed:
            first = min(failed, key=lambda robot: robot["failure_time_s"])
            assert row["failure"] == first["outcome"]
            assert row["failure_robot"] == first["robot"]
            assert row["failure_x_m"] == first["failure_x_m"]


def test_a_robot_without_a_path_stays_and_others_fly(runs, robots):
    first, second = robots[runs[MOODY, 2]["run"]]
    other_first, other_second = robots[runs[STRAIGHT, 2]["run"]]
    assert not first["planned"]
    assert second["planned"]
    # the same world: the second robot flies the same path, past one that holds its start
    assert second["plan_length_m"] == other_second["plan_length_m"]
    assert first["path_length_m"] < 0.5 * other_first["path_length_m"]


def test_plans_of_the_same_numbers_fly_to_the_same_bytes(runs, robots):
    """Tiles of two worlds, planner after planner: none of them feels the others."""
    for world in (0, 3):
        one, two = (robots[runs[who, world]["run"]] for who in (STRAIGHT, MOODY))
        assert [{**row, "run": 0} for row in one] == [{**row, "run": 0} for row in two]


def test_a_folder_compared_with_itself_and_with_an_edited_one(folder, tmp_path):
    same = tmp_path / "same"
    shutil.copytree(folder, same)
    assert folder_comparison.compare_folders(folder, same).same
    edited = tmp_path / "edited"
    shutil.copytree(folder, edited)
    with BenchmarkStore(edited / "results.sqlite") as store:
        run = store.rows("SELECT runid, paths FROM plans")[0]
        paths = bytes_of.unpack_paths(run["paths"])
        paths[1].position_m[1, 2] += np.float32(1e-3)
        store._write(
            "UPDATE plans SET paths = ? WHERE runid = ?",
            [(bytes_of.pack_paths(paths), run["runid"])],
        )
        store._write("DELETE FROM runs WHERE plannerid = ? AND world = 2", [(3,)])
    found = folder_comparison.compare_folders(folder, edited)
    assert not found.same
    assert found.planners[STRAIGHT].same_plans == 3
    assert found.planners[STRAIGHT].same_plans_other_outcomes == 0
    assert found.planners[LAZY].only_one == 1
    assert (edited / "comparison.json").is_file()


def test_the_first_worlds_are_kept_to_be_drawn(folder):
    with np.load(folder / "examples" / "0.npz") as archive:
        held = {name: archive[name] for name in archive.files}
    assert list(held["planners"]) == [STRAIGHT, MOODY, LAZY]
    assert held["occupied"].ndim == 3
    start = held["start_m"]
    for k in range(2):
        np.testing.assert_allclose(held[f"planned_{k}"][:, 0], start, atol=1e-5)
        np.testing.assert_allclose(held[f"flown_{k}"][0], start, atol=1e-5)
    assert np.isnan(held["planned_2"]).all()
    assert len(held["flown_2"]) == 0


def test_the_page_and_its_figures_are_made(folder):
    assert (folder / "report.html").stat().st_size > 1000
    assert list((folder / "figures").glob("*.png"))


def test_a_finished_folder_records_that_it_is_complete(folder):
    about = json.loads((folder / "about.json").read_text())
    assert about["complete"] is True
    assert [entry["label"] for entry in about["planners"]] == [STRAIGHT, MOODY, LAZY]


def test_a_full_disk_and_a_damaged_database_have_a_message_each(folder, tmp_path):
    full = sqlite3.OperationalError("database or disk is full")
    with BenchmarkStore(folder / "results.sqlite", only_read=True) as store:
        assert isinstance(store._name_error(full), RunError)
        assert "make room and go on with --resume" in str(store._name_error(full))
        locked = store._name_error(sqlite3.OperationalError("database is locked"))
        assert isinstance(locked, ConfigError)
    damaged = tmp_path / "results.sqlite"
    damaged.write_bytes(b"no database at all" * 100)
    with pytest.raises(ConfigError, match="no database of a benchmark, or it is damaged"):
        BenchmarkStore(damaged, only_read=True)


def test_a_database_of_an_older_version_gets_the_names_of_columns_of_now(folder, tmp_path):
    older = tmp_path / "results.sqlite"
    shutil.copyfile(folder / "results.sqlite", older)
    with sqlite3.connect(older) as base:
        before = base.execute("SELECT path_length_m FROM runs ORDER BY id").fetchall()
        base.execute("ALTER TABLE runs RENAME COLUMN path_length_m TO flown_length_m")
    BenchmarkStore(older).close()
    with sqlite3.connect(older) as base:
        names = [row[1] for row in base.execute("PRAGMA table_info(runs)")]
        after = base.execute("SELECT path_length_m FROM runs ORDER BY id").fetchall()
    assert "flown_length_m" not in names
    assert after == before
    assert any(value for (value,) in after)


def test_a_finished_or_foreign_folder_is_not_gone_on_with(source, folder, tmp_path):
    benchmark, how = (
        running.read_benchmark(source),
        {"workers": workers, "progress": Interrupting(None)},
    )
    with pytest.raises(ConfigError, match="is complete"):
        running.run_benchmark(benchmark, source, folder, resume=True, **how)
    with pytest.raises(ConfigError, match="no interrupted benchmark"):
        running.run_benchmark(benchmark, source, tmp_path / "x", resume=True, **how)
    with pytest.raises(ConfigError, match="exists"):
        running.run_benchmark(benchmark, source, folder, **how)
    with pytest.raises(ConfigError, match="no results folder"):
        running.read_benchmark(tmp_path)


@pytest.mark.nightly(
    by="tests/angler_mjx/studies/benchmark/test_results.py::"
    "test_what_was_finished_before_an_interruption_is_neither_lost_nor_done_again"
)
def test_a_killed_process_loses_nothing_and_leaves_nobody(source, tmp_path):
    """``kill -9``, at three times; then whole, by the command."""
    out, seen = tmp_path / "killed", set()
    command = [sys.executable, "-c", "from angler_mjx.cli.main import main; main()"]
    command += ["benchmark", str(source), "--out", str(out), "--workers", "2"]
    database = tmp_path / ".killed.partial" / "results.sqlite"
    for least in (1, 5, 9):
        again = ["--resume"] if database.exists() else []
        process = subprocess.Popen([*command, *again], start_new_session=True)
        while process.poll() is None and (not database.exists() or count(database) < least):
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        now = set(rows(database, "SELECT id, plannerid, world, time FROM runs"))
        assert seen <= now
        seen = now
    subprocess.run([*command, "--resume"], check=True)
    now = set(rows(out / "results.sqlite", "SELECT id, plannerid, world, time FROM runs"))
    assert seen <= now
    assert len(now) == 11


def count(database):
    try:
        return rows(database, "SELECT count(*) FROM runs")[0][0]
    except sqlite3.OperationalError:  # its tables are just being made
        return 0


@pytest.mark.nightly(
    by="tests/angler_mjx/studies/benchmark/test_results.py::"
    "test_every_planner_is_asked_every_problem_and_closed_where_it_is_hopeless"
)
def test_a_world_that_cannot_hold_the_team_is_nobodys_failure(source, tmp_path):
    table = source.read_text().replace(
        "problems = 4",
        'problems = 2\nteams = [60]\nset.world.preset = "open"\nset.world.shape = [3, 3, 3]',
    )
    file = source.with_name("crowded.toml")
    file.write_text(table)
    out = tmp_path / "crowded"
    running.run_benchmark(
        running.read_benchmark(file), file, out, workers=workers, progress=Interrupting(None)
    )
    found = pq.read_table(out / "runs.parquet").to_pylist()
    assert len(found) == 6
    assert {row["plan_reason"] for row in found} == {"the world cannot hold the team"}
    assert {row["plan_status"] for row in found} == {"no room"}
