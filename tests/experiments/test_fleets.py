"""Tables and figures of the study of fleets, of runs that were counted by hand."""

import json

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from angler_experiments.benchmarks import fleets
from angler_mjx.errors import ConfigError
from angler_mjx.shipped import list_shipped
from angler_mjx.studies.benchmark import problem_settings
from angler_mjx.studies.benchmark.columns import RUN_SCHEMA

PLANNERS = [
    {"label": "grid", "name": "grid", "settings": {}, "online": {}},
    {"label": "anew", "name": "grid", "settings": {}, "online": {"replan_hz": 1.0}},
    {"label": "mppi", "name": "mppi", "settings": {}, "online": {}},
    {"label": "mppi, blind", "name": "mppi", "settings": {}, "online": {}},
]


def row(label, level, robots, world, reached, **more):
    return dict.fromkeys(RUN_SCHEMA.names) | {
        "run": world + 1,
        "planner": label,
        "planner_name": label,
        "scene": "reef",
        "preset": "reef",
        "robots": robots,
        "knows_obstacles": level,
        "knows_current": "nothing",
        "problem_seed": 1,
        "world": world,
        "plan_status": "planned",
        "planned": True,
        "flown": True,
        "robots_planned": robots,
        "robots_reached": reached,
        "reached": reached == robots,
        "success": reached == robots,
        "density": 0.1,
        **more,
    }


ROWS = [
    *[row("grid", "observed", 2, w, reached) for w, reached in enumerate([2, 1, 0, 1])],
    *[
        row("anew", "observed", 2, w, reached, failed_replans=3 * w)
        for w, reached in enumerate([2, 2, 2, 1])
    ],
    *[
        row("mppi", "observed", 2, w, 2, plan_status="policy", planned=False, robots_planned=0)
        for w in range(4)
    ],
    row("mppi, blind", "nothing", 2, 0, 0, plan_status="policy", planned=False),
    row("grid", "observed", 4, 0, 4),
    row("grid", "observed", 4, 1, 0, plan_status="closed", planned=False, flown=False, run=None),
    row("grid", "observed", 4, 2, 0, plan_status="no room", planned=False, flown=False, run=None),
]


def folder(target, rows, teams):
    target.mkdir()
    pq.write_table(pa.Table.from_pylist(rows, RUN_SCHEMA), target / "runs.parquet")
    about = {"name": "x", "planners": PLANNERS, "scenes": ["reef"], "teams": teams}
    (target / "about.json").write_text(json.dumps(about))
    return target


@pytest.fixture
def parts(tmp_path):
    """The study in two folders: a team each."""
    small, large = ([one for one in ROWS if one["robots"] == n] for n in (2, 4))
    return [folder(tmp_path / "a", small, [2]), folder(tmp_path / "b", large, [4])]


def test_arrivals_are_those_counted_by_hand(parts):
    study = fleets.read_study(parts)
    lines = fleets.format_by_team(study, "observed")
    # Of teams 1 of 4, and of robots 4 of 8; of four robots 1 of 2 teams, who has no room aside.
    assert "| grid | 25 (50) | 50 (50) |" in lines
    assert "| grid, 1 Hz | 75 (88) | - |" in lines
    assert "| mppi | 100 (100) | - |" in lines
    assert "**reef, 2 robots**" in (by_level := fleets.format_by_level(study))
    assert "**reef, 4 robots**" not in by_level
    assert "| mppi | 0 (0) | 100 (100) | - | - |" in by_level
    assert "| grid, 1 Hz | - | 75 (88) | - | - |" in by_level


def test_failed_replans_are_a_robots_mean_and_of_those_alone_that_plan_anew(parts):
    lines = fleets.format_replans(fleets.read_study(parts))
    # 0 + 3 + 6 + 9 of 8 robots
    assert lines[3:] == ["| reef, grid, 1 Hz | `observed` | 2.2 | - |"]


def test_planning_anew_is_compared_with_the_same_planner_on_the_same_problems(parts):
    lines = fleets.format_pairs(fleets.read_study(parts))
    assert len(lines) == 4
    assert lines[3].startswith("| anew | 4 | +50.0 (")


def test_folders_may_be_named_in_any_order(tmp_path):
    """Costs of what both flew are paired over the worlds of all folders."""
    rows = [{**one, "energy_j": 100.0 + one["world"], "makespan_s": 50.0} for one in ROWS]
    small, large = ([one for one in rows if one["robots"] == n] for n in (2, 4))
    parts = [folder(tmp_path / "b", large, [4]), folder(tmp_path / "a", small, [2])]
    there, back = (fleets.format_pairs(fleets.read_study(some)) for some in (parts, parts[::-1]))
    assert there == back
    assert len(there) == 4


def test_what_is_still_to_be_flown_has_not_failed(tmp_path, capsys):
    unflown = {"flown": False, "success": False}
    rows = [
        row("grid", "observed", 2, 0, 2),
        row("grid", "observed", 2, 1, 0, **unflown),
        row("grid", "observed", 2, 2, 0, planned=False, robots_planned=0, **unflown),
        row("mppi", "observed", 2, 0, 0, plan_status="policy", robots_planned=0, **unflown),
    ]
    fleets.main((folder(tmp_path / "a", rows, [2]),))
    output = capsys.readouterr().out
    assert "2 runs are not flown yet" in output
    assert "| grid | 50 (50) |" in output
    assert "| mppi |" not in output


def test_a_run_that_is_there_twice_is_not_counted_twice(parts):
    with pytest.raises(ConfigError, match="planner 'grid', reef, 2 robots, world 0 is there twice"):
        fleets.read_study([*parts, parts[0]])


def test_tables_and_figures_come_of_one_command(parts, tmp_path, capsys):
    fleets.main(tuple(parts), figures=tmp_path / "drawn")
    assert "| grid, 1 Hz | 75 (88) | - |" in capsys.readouterr().out
    for name in ("fleets_teams.png", "fleets_known.png"):
        assert (tmp_path / "drawn" / name).read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ConfigError, match="--level all: give one of nothing, observed"):
        fleets.main(tuple(parts), level="all")


def study_file():
    return list_shipped("angler_mjx.studies.benchmark")["fleets"]


def test_the_studys_file_asks_what_its_page_says():
    made = problem_settings.read_benchmark(study_file())
    pairs = [(s, one) for s in made.settings for one in made.select_planners(s)]
    assert {s.preset for s, _ in pairs} == {"open", "reef", "dense", "corridor"}
    assert {s.robots for s, _ in pairs} == {1, 4, 16, 64}
    assert all(one.spec is None or one.spec.reference.on_device for _, one in pairs)
    levels = {
        (s.robots, one.name, s.information.obstacles)
        for s, one in pairs
        if s.preset == "dense" and not one.online
    }
    for robots in (4, 16):
        for name in ("grid", "priority", "current", "mppi"):
            for level in fleets.LEVELS:
                assert (robots, name, level) in levels
    assert len({(s.robots, one.label) for s, one in pairs if one.flies_itself}) == 20


@pytest.mark.nightly(
    by="tests/experiments/test_fleets.py::test_tables_and_figures_come_of_one_command"
)
def test_the_study_is_flown_in_small_and_drawn(tmp_path):
    import subprocess
    import sys

    out = tmp_path / "fleets"
    start = [sys.executable, "-c", "from angler_mjx.cli.main import main; main()", "benchmark"]
    small = ["--presets", "open", "--teams", "1", "--problems", "2", "--out", str(out)]
    subprocess.run([*start, str(study_file()), *small], check=True)
    found = pq.read_table(out / "runs.parquet").to_pylist()
    labels = ["grid", "priority", "current", "grid, 1 Hz", "mppi"]
    assert sorted(row["planner"] for row in found) == sorted(labels * 2)
    for row in found:
        assert row["flown"]
        assert (row["failed_replans"] is not None) == (row["planner"] == "grid, 1 Hz")
    fleets.main((out,), figures=tmp_path)
    assert (tmp_path / "fleets_teams.png").is_file()
