"""The database read by those who read OMPL's: its own statistics, and Planner Arena."""

import shutil
import sqlite3

import pyarrow.parquet as pq
import pytest

from .conftest import rows

tools = pytest.importorskip("ompl.tools", reason="needs OMPL: pip install 'angler-mjx[plan]'")

TABLES = ("experiments", "plannerConfigs", "enums", "runs", "progress")

LOG = """OMPL version 2.0.1
Experiment toy
Running on somewhere
Starting at 2026-01-01 00:00:00
<<<|
nothing to say
|>>>
<<<|
cpu
|>>>
0 is the random seed
1 seconds per run
1 MB per run
1 runs per planner
0.1 seconds spent to collect the data
1 enum types
status|Unknown|Exact solution
1 planners
geometric_RRT
0 common properties
3 properties for each run
time REAL
solved BOOLEAN
status ENUM
1 runs
0.5; 1; 1;{space}
.
""".replace("{space}", " ")


@pytest.fixture(scope="module")
def database(made, tmp_path_factory):
    """A copy: OMPL adds views to it."""
    place = tmp_path_factory.mktemp("arena") / "results.db"
    shutil.copyfile(made[0] / "results.sqlite", place)
    return place


def columns(path, table):
    return [(row[1], row[2].upper()) for row in rows(path, f"PRAGMA table_info({table})")]


def test_tables_begin_as_those_that_ompl_makes_of_its_own_logs(database, tmp_path, capsys):
    log, theirs = tmp_path / "toy.log", tmp_path / "toy.db"
    log.write_text(LOG)
    tools.readBenchmarkLog(str(theirs), [str(log)], False)
    for table in TABLES:
        wanted, ours = columns(theirs, table), columns(database, table)
        if table == "runs":
            assert ours[:3] == wanted[:3]
            assert set(wanted[3:]) <= {(n, k.replace("DOUBLE", "REAL")) for n, k in ours}
        else:
            assert ours[: len(wanted)] == wanted


def test_ompls_statistics_of_the_database_are_those_of_the_table(database, made):
    tools.computeViews(str(database), False)
    best = rows(
        database,
        "SELECT name, avg_solved, avg_total_time FROM bestPlannerConfigsPerExperiment "
        "JOIN plannerConfigs ON plannerConfigs.id = plannerid",
    )
    table = pq.read_table(made[0] / "runs.parquet").to_pylist()
    asked = [row for row in table if row["plan_status"] != "closed"]
    assert len(best) == 3
    for label, solved, seconds in best:
        own = [row for row in asked if row["planner"] == label]
        assert solved == pytest.approx(sum(row["planned"] for row in own) / len(own))
        assert seconds == pytest.approx(sum(row["planning_s"] for row in own) / len(own))


def test_the_database_refuses_the_same_run_twice(database):
    base = sqlite3.connect(database)
    with pytest.raises(sqlite3.IntegrityError):
        base.execute(
            "INSERT INTO runs (experimentid, plannerid, world) "
            "SELECT experimentid, plannerid, world FROM runs LIMIT 1"
        )
    base.close()


def test_planner_arena_reads_and_draws_it(database, tmp_path):
    reason = "needs Planner Arena: pip install plannerarena"
    arena = pytest.importorskip("plannerarena.database", reason=reason)
    performance = pytest.importorskip("plannerarena.performance", reason=reason)
    data = arena.load_database(database)
    assert data["problem_names"] == ["as it is"]
    assert set(data["planner_configs"]["planner"].to_list()) == {"Straight", "Moody", "lazy <one>"}
    assert len(data["runs"]) == 11
    assert {"time", "solved", "status", "makespan s", "energy j"} <= set(data["attributes"])
    assert data["parameters"] == [
        "preset",
        "robots",
        "knows obstacles",
        "knows current",
        "problem seed",
    ]
    status = performance.enums_plot(data["runs"], data["enums"], "")
    time = performance.boxplot(data["runs"], "time", "", "o", False)
    ecdf = performance.ecdf_plot(data["runs"], "energy j", "")
    for name, plot in (("status", status), ("time", time), ("ecdf", ecdf)):
        plot.save(tmp_path / f"{name}.png", verbose=False)
        assert (tmp_path / f"{name}.png").stat().st_size > 5000
