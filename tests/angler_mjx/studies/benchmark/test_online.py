"""Planners that are flown online and policies in one benchmark, interrupted and made again."""

import hashlib
import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.studies.benchmark import folder_comparison, problem_settings, running
from angler_mjx.studies.benchmark.columns import NUMBER_COLUMNS
from angler_mjx.studies.benchmark.report import reading
from angler_mjx.studies.benchmark.store import BenchmarkStore

from .conftest import Interrupting, workers

FILE = """
name = "online"
scenario = "small.toml"
problems = 2
set.engine = "fused"

[[planner]]
name = "grid"
information = { obstacles = "observed" }

[[planner]]
name = "grid"
replan_hz = 1.0
information = { obstacles = "observed" }

[[planner]]
policy = "mppi"
settings = { samples = 32, hz = 5.0 }
information = { obstacles = "observed" }
"""


@pytest.fixture
def file(tmp_path, scenario_file):
    text = scenario_file.read_text().replace("horizon_s = 20.0", "horizon_s = 40.0")
    (tmp_path / "small.toml").write_text(text)
    (tmp_path / "online.toml").write_text(FILE)
    return tmp_path / "online.toml"


def test_what_a_folder_keeps_of_it_is_the_same_benchmark(file):
    made = problem_settings.read_benchmark(file)
    kept = json.loads(json.dumps(made.resolved()))
    other = problem_settings.rebuild_benchmark(file.parent, kept, {})
    assert [one.label for one in other.planners] == [one.label for one in made.planners]
    assert [one.online for one in other.planners] == [one.online for one in made.planners]
    assert [one.policy for one in other.planners] == [None, None, "mppi"]
    assert {s.scenario.digest() for s in other.settings} == {
        s.scenario.digest() for s in made.settings
    }


def test_a_database_of_an_older_version_is_brought_up_to_date(tmp_path):
    place = tmp_path / "old.sqlite"
    with BenchmarkStore(place, new=True) as store:
        store._base.execute("ALTER TABLE runs DROP COLUMN failed_replans")
    with BenchmarkStore(place) as store:
        there = {row["name"] for row in store.rows("PRAGMA table_info(runs)")}
    assert {name for _, name in NUMBER_COLUMNS} <= there


class Stopping(Interrupting):
    """Ends a benchmark when it begins to fly somebody."""

    def __init__(self, who):
        super().__init__(None)
        self.who = who

    def describe(self, text):
        super().describe(text)
        if text.endswith(f"flying {self.who}"):
            raise KeyboardInterrupt


@pytest.mark.nightly(
    by="tests/angler_mjx/studies/benchmark/test_questions.py::"
    "test_who_flies_otherwise_flies_the_same_problems_by_another_scenario"
)
def test_online_and_policy_are_flown_once_and_alike_when_made_again(file):
    out, how = file.parent / "out", {"workers": workers}
    for who in ("grid, 1 Hz", "mppi"):
        going = (file.parent / ".out.partial").exists()
        with pytest.raises(KeyboardInterrupt):
            running.run_benchmark(
                running.read_benchmark(file), file, out, progress=Stopping(who), resume=going, **how
            )
    last = Interrupting(None)
    running.run_benchmark(
        running.read_benchmark(file), file, out, progress=last, resume=True, **how
    )
    assert not any(text.endswith("flying grid, 1 Hz") for text in last.texts)
    found = pq.read_table(out / "runs.parquet").to_pylist()
    runs = {(row["planner"], row["world"]): row for row in found}
    assert len(runs) == len(found) == 6
    for world in (0, 1):
        plain, online, mppi = (runs[x, world] for x in ("grid", "grid, 1 Hz", "mppi"))
        assert plain["plan_length_m"] == online["plan_length_m"]
        assert plain["failed_replans"] is None
        assert online["failed_replans"] >= 0
        assert (mppi["plan_status"], mppi["planned"]) == ("policy", False)
        assert mppi["planning_s"] is None
        assert mppi["success"] == (mppi["robots_reached"] == 2)
        assert mppi["flown"]
        assert mppi["density"] == plain["density"]
    robots = pq.read_table(out / "robots.parquet").to_pylist()
    own = {run: [one for one in robots if one["run"] == run] for run in {x["run"] for x in found}}
    for row in found:
        counts = [one["failed_replans"] for one in own[row["run"]]]
        online = row["planner"] == "grid, 1 Hz"
        assert row["failed_replans"] == (sum(counts) if online else None)
    assert reading.read_results(out).planners == ["grid", "grid, 1 Hz", "mppi"]
    assert "mppi: " in running.format_summary(out)
    twin = file.parent / "twin"
    running.run_benchmark(
        running.read_benchmark(out), out, twin, progress=Interrupting(None), **how
    )
    assert folder_comparison.compare_folders(out, twin).same


def test_a_policy_of_a_file_is_compared_by_the_name_of_its_class(file):
    straight = file.parent / "straight.py"
    straight.write_text(Path("docs/examples/policy.py").read_text())
    name = f"{straight}:Straight"
    (entry,) = problem_settings.select_entries([], [name], file.parent)
    assert entry == {"policy": name}
    file.write_text(
        'name = "own"\nscenario = "small.toml"\nproblems = 1\nset.engine = "fused"\n'
        '[[planner]]\npolicy = "straight.py:Straight"\nsettings = { speed_mps = 0.3 }\n'
    )
    # The scenario may name one too, with settings that are not the contestants'.
    with (file.parent / "small.toml").open("a") as scenario:
        scenario.write(
            '[policy]\nname = "straight.py:Straight"\n[policy.Straight]\nspeed_mps = 1\n'
        )
    out, made = file.parent / "out", running.read_benchmark(file)
    assert made.scenario.policy.settings
    assert made.settings[0].scenario.policy.settings == {}
    running.run_benchmark(made, file, out, progress=Interrupting(None), workers=workers)
    (run,) = pq.read_table(out / "runs.parquet").to_pylist()
    assert (run["planner"], run["plan_status"], run["flown"]) == ("Straight", "policy", True)
    # The folder keeps the file: what is made again of it does not need the file's own.
    straight.unlink()
    (kept,) = running.read_benchmark(out).planners
    assert kept.file.is_relative_to(out.resolve())
    assert kept.label == "Straight"
    assert kept.sha256 == hashlib.sha256(Path("docs/examples/policy.py").read_bytes()).hexdigest()
    file.write_text(file.read_text().replace("policy = ", "name = "))
    straight.write_text(Path("docs/examples/policy.py").read_text())
    with pytest.raises(ConfigError, match="is a policy; give policy = "):
        problem_settings.read_benchmark(file)
