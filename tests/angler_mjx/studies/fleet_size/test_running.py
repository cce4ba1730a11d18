"""A small study in open water: flown whole, and interrupted and gone on with."""

import dataclasses
import json
import math
import os
import shutil
import subprocess
import sys
from types import SimpleNamespace

import jax
import numpy as np
import pyarrow.parquet as pq
import pytest

from angler_mjx.cli import main as cli
from angler_mjx.cli.studies import fleet_size as command
from angler_mjx.errors import ConfigError, RunError
from angler_mjx.progress import Progress
from angler_mjx.studies.fleet_size import conditions, flying, folder, report, running
from angler_mjx.studies.fleet_size.flying import compute_completion_s
from angler_mjx.studies.fleet_size.simulators import Simulators
from angler_mjx.studies.fleet_size.store import Batch, StudyStore

from ...threads import together

PLANNER = '''
import jax.numpy as jnp
from angler_mjx.robot.control.commands.trajectory import Trajectory


class Straight:
    """Straight on at cruise speed: compiles in a moment."""

    def plan_batch(self, problems):
        team = problems.team
        time = jnp.linalg.norm(team.goal_m - team.start_m, axis=-1) / team.cruise_speed_mps
        return Trajectory(
            time_s=jnp.stack([0.0 * time, time], axis=-1),
            position_m=jnp.stack([team.start_m, team.goal_m], axis=-2),
            found=time > 0.0,
        )
'''

FILE = """
name = "small"
scenario = "reef_fleet"
sizes = [2]
deadline_s = 21.0
seed = 3

[set]
engine = "fused"
tile = 2
kernels = "xla"
planner = { name = "FOLDER/straight.py:Straight", points = 2 }
time = { horizon_s = 24.0 }
fleet = [{ vehicle = "bluerov2_heavy" }]

[set.world]
preset = "open"
shape = [8, 4, 2]
placement = "parallel"
currents = [{ type = "gauss_markov", max_speed_mps = 0.4 }]
obstacles = { dynamic = { count = 0 } }

[budget]
batch = 4
max_worlds = 8

[[condition]]
name = "calm"
set = { randomise = { current = [0.5, 0.5] } }

[[condition]]
name = "moving"

[[condition]]
name = "breaking"
set = { randomise = { current = [0.0, 0.0] }, breakdowns = { fraction = 1.0, latest_s = 2.0 } }
"""


class Reports(Progress):
    """Keeps its reports; interrupts after some batches."""

    def __init__(self, batches=None):
        self.left, self.said = batches, []

    def report(self, text):
        self.said.append(text)

    def advance(self, amount, vehicle_steps=0):
        if self.left is not None:
            self.left -= 1
            if self.left == 0:
                raise KeyboardInterrupt


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    path = tmp_path_factory.mktemp("study") / "small.toml"
    path.with_name("straight.py").write_text(PLANNER)
    path.write_text(FILE.replace("FOLDER", str(path.parent)))
    return path


@pytest.fixture(scope="module")
def study(source):
    return conditions.read_study(source)


@pytest.fixture(scope="module")
def simulators(study):
    made = Simulators(study, tile=2, devices=1)
    yield made
    made.close()


@pytest.fixture(scope="module")
def whole(study, source, simulators, tmp_path_factory):
    out = tmp_path_factory.mktemp("whole") / "small"
    found = running.run_study(study, source, out, progress=Reports(), simulators=simulators)
    return out, found


def test_every_world_has_a_row(whole, study):
    out, found = whole
    rows = pq.read_table(out / folder.RESULTS)
    assert rows.schema == report.SCHEMA
    keys = [(r["condition"], r["size"], r["world"]) for r in rows.to_pylist()]
    assert len(set(keys)) == len(keys) == found["worlds"]
    for row in rows.to_pylist():
        done = row["completed_s"]
        assert row["success"] == (done is not None and done <= 21.0)
        assert row["arrived"] + row["lost"] <= row["size"]
    assert found == folder.read_results(out) | {"timing": found["timing"]}
    assert found["ended"] == "max_worlds"


def test_conditions_that_differ_in_numbers_share_programs(whole, simulators):
    _, found = whole
    assert simulators.compiled == 1
    by_name = {one["name"]: one["sizes"][0] for one in found["conditions"]}
    assert by_name["calm"]["energy_j"] != by_name["moving"]["energy_j"]
    # 10.5 m are left to 0.5 m/s; within 2 s of that nobody arrives.
    assert by_name["breaking"]["done"] == 0
    assert by_name["breaking"]["lost_per_robot"] == 1.0
    assert by_name["calm"]["done"] > 0


def test_worlds_get_the_current_that_they_would_be_drawn_with(study, simulators):
    simulator = simulators.of(study.conditions[1], 2)
    drawn = simulator.worlds(4, seed=3)
    changed = [simulators.change(one, 2, simulator, [4], drawn) for one in study.conditions]
    for factor, world in zip((0.5, 1.0, 0.0), changed, strict=True):
        for made, had in zip(
            jax.tree.leaves(world.environment.current),
            jax.tree.leaves(drawn.environment.current),
            strict=True,
        ):
            if made.ndim > 1:  # velocities; the time between them stays
                np.testing.assert_allclose(made, factor * np.asarray(had), atol=1e-6)
    times = [np.asarray(world.fails_at_s) for world in changed]
    assert np.isinf(times[0]).all()
    assert np.isinf(times[1]).all()
    assert ((times[2] >= 0.0) & (times[2] <= 2.0)).all()
    # Those that the simulator drew itself, with the breakdowns of the study.
    np.testing.assert_array_equal(times[2], np.asarray(drawn.fails_at_s))


def test_an_interrupted_study_goes_on_to_the_same_bytes(whole, study, source, simulators, tmp_path):
    out = tmp_path / "again"
    begun = running.run_study(study, source, out, progress=Reports(4), simulators=simulators)
    assert (begun["ended"], begun["complete"]) == ("interrupted", False)
    assert (out / folder.PAGE).is_file()
    # As if the process had been killed in the middle of a line.
    with (out / "batches.jsonl").open("a") as file:
        file.write('{"condition":"ca')
    with pytest.raises(ConfigError, match="exists"):
        running.run_study(study, source, out, progress=Reports(), simulators=simulators)
    reports = Reports()
    found = running.run_study(
        study, source, out, progress=reports, resume=True, simulators=simulators
    )
    for name in ("batches.jsonl", folder.RESULTS):
        assert (out / name).read_bytes() == (whole[0] / name).read_bytes()
    same = ("conditions", "ended", "worlds", "complete")
    assert {key: found[key] for key in same} == {key: whole[1][key] for key in same}
    with pytest.raises(ConfigError, match="is complete"):
        running.run_study(
            study, source, out, progress=Reports(), resume=True, simulators=simulators
        )


@pytest.fixture
def flights(monkeypatch):
    """What each process flew: its index, and how many tiles; at ``stop`` the second is
    interrupted."""
    found, fly = SimpleNamespace(flown=[], stop=math.inf), flying.fly_batch

    def watched(*args, partition, failures):
        if len(found.flown) >= found.stop and partition[0] == 1:
            raise KeyboardInterrupt
        part = fly(*args, partition=partition, failures=failures)
        found.flown.append((partition[0], len(part["first"])))
        return part

    monkeypatch.setattr(flying, "fly_batch", watched)
    return found


def test_processes_that_share_batches_come_to_the_same_bytes(
    whole, study, source, simulators, flights, tmp_path
):
    """Also where one is interrupted: all stop after the same batch, and go on together."""
    out = tmp_path / "shared"

    def run(one, resume=False):
        return running.run_study(
            study,
            source,
            out,
            progress=Reports(),
            simulators=simulators,
            processes=one,
            resume=resume,
        )

    flights.stop = 6
    ends, ours = together(3, run)
    assert [end["ended"] for end in ends] == ["interrupted"] * 3
    assert [one.stops for one in ours] == [0, 1, 0]
    held = StudyStore(out / "batches.jsonl", writes=False).batches
    assert 0 < len(held) < len(StudyStore(whole[0] / "batches.jsonl", writes=False).batches)
    flights.stop = math.inf
    ends, ours = together(3, lambda one: run(one, resume=True))
    assert [one.left for one in ours] == [0, 0, 0]  # who leaves first ends the wait of others
    for name in ("batches.jsonl", folder.RESULTS):
        assert (out / name).read_bytes() == (whole[0] / name).read_bytes()
    assert [end["worlds"] for end in ends] == [whole[1]["worlds"]] * 3
    # Two tiles a batch: the third process has none, and is there all the same.
    assert {i: {n for j, n in flights.flown if j == i} for i in range(3)} == {
        0: {1},
        1: {1},
        2: {0},
    }


@pytest.mark.nightly(by="runs/test_many_devices.py: test_the_same_bytes_on_any_number_of_devices")
def test_the_same_bytes_on_two_devices(whole, source, tmp_path):
    """By the command: the first batch of one size and condition."""
    file, out = tmp_path / "one.toml", tmp_path / "one"
    file.write_text(source.read_text())
    line = ["study", "fleet_size", str(file), "--only", "moving", "--max-worlds", "4", "--json"]
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=2"
    ended = subprocess.run(
        [sys.executable, "-m", "angler_mjx.cli.main", *line, "--devices", "2", "--out", str(out)],
        capture_output=True,
        text=True,
        timeout=500,
        env=os.environ | {"JAX_PLATFORMS": "cpu", "XLA_FLAGS": flags},
    )
    assert ended.returncode == 0, ended.stderr
    assert json.loads(ended.stdout)["worlds"] == 4
    lines = (whole[0] / "batches.jsonl").read_text().splitlines()
    first = [one for one in lines if '"moving","size":2,"first":0,' in one]
    assert len(first) == 1
    assert (out / "batches.jsonl").read_text().splitlines() == first


def test_a_batch_of_fewer_tiles_than_devices_is_told_of(study, source, simulators, tmp_path):
    reports = Reports(1)
    running.run_study(
        study, source, tmp_path / "a", progress=reports, simulators=simulators, devices=1
    )
    assert not [text for text in map(str, reports.said) if "devices have work" in text]
    reports = Reports(1)
    running.run_study(
        study, source, tmp_path / "b", progress=reports, simulators=simulators, devices=3
    )
    assert "2 of 3 devices have work" in reports.said[0]
    assert "tile = 1" in reports.said[0]


def test_another_study_does_not_go_on_with_it(whole, source, tmp_path):
    out = tmp_path / "small"
    shutil.copytree(whole[0], out)
    table = json.loads((out / folder.STUDY).read_text())
    (out / folder.STUDY).write_text(json.dumps(table | {"complete": False}))
    other = conditions.read_study(source, batch=8)
    with pytest.raises(ConfigError, match=r"another study\.budget"):
        running.run_study(other, source, out, progress=Reports(), resume=True)
    with pytest.raises(ConfigError, match="no interrupted study"):
        running.run_study(other, source, tmp_path / "nothing", progress=Reports(), resume=True)


def test_no_batch_begins_after_the_time_is_over(source, tmp_path, simulators):
    study = conditions.read_study(source, max_minutes=1e-9)
    with pytest.raises(RunError, match=r"max_minutes.*over before the first batch"):
        running.run_study(
            study, source, tmp_path / "late", progress=Reports(), simulators=simulators
        )
    assert not (tmp_path / "late").exists()
    given = conditions.read_study(source)
    with pytest.raises(KeyboardInterrupt):
        running.run_study(given, source, tmp_path / "no", progress=_Never(), simulators=simulators)
    assert not (tmp_path / "no").exists()


class _Never(Reports):
    def describe(self, text):
        raise KeyboardInterrupt


def test_the_command_tells_what_came_of_it(whole, source, capsys):
    out, found = whole
    with pytest.raises(SystemExit) as left:
        cli.main(["study", "fleet_size", str(source), "--out", str(out), "--resume"])
    assert left.value.code == cli.EXIT_FAULT
    assert "is complete; nothing is left to do" in capsys.readouterr().err
    command._print_study(found, out, as_json=True)
    reports = json.loads(capsys.readouterr().out)
    assert reports["conditions"] == json.loads(json.dumps(found["conditions"]))
    command._print_study(found, out, as_json=False)
    text = capsys.readouterr().out
    for one in found["conditions"]:
        assert one["name"] in text
    page = (out / folder.PAGE).read_text()
    # One size: 2.5 % for its upper end and as much for its lower one.
    assert "| robots | worlds | met the deadline | 95 % interval |" in page
    assert "median time (95 % interval), s" in page
    assert "mean to the horizon (95 % interval), s" in page
    assert "| breaking | none | more than 2 |" in page or "| breaking | none | 1 or more |" in page


def test_a_batch_is_made_of_whole_tiles(source):
    assert running.tile_of(conditions.read_study(source)) == 2  # the scenario's
    with pytest.raises(ConfigError, match=r"budget\.batch = 3: must be whole tiles of 2 worlds"):
        running.tile_of(conditions.read_study(source, batch=3, max_worlds=6))


def test_every_interval_names_its_level(source):
    """Of 14 sizes each may be accepted wrongly with 1 / 14 of half of 10 %, excluded with half."""
    given = conditions.read_study(source)
    rule = running.rule_of(given)
    rule = dataclasses.replace(rule, sizes=tuple(range(3, 17)), confidence=0.9)
    found = {"levels": report.confidence_levels(rule)}
    assert (
        report.format_level(found, "share") == f"{100 * (1 - 0.05 - 0.05 / 14):.4g} %" == "94.64 %"
    )
    assert [report.format_level(found, kind) for kind in ("answer", "quantile", "mean")] == [
        "90 %",
        "90 %",
        "95 %",
    ]
    row = {"size": 3, "worlds": 10, "met": 9, "rate": 0.9, "low": 0.5, "high": 1.0}
    row |= {"median_s": dict.fromkeys(("value", "low", "high"), 1.0)}
    row |= {"p90_s": row["median_s"], "mean_s": dict.fromkeys(("mean", "low", "high"), 1.0)}
    row |= {"lost_per_robot": 0.0, "energy_j": 1.0}
    head, _ = report.sizes_table({**found, "probability": 0.95}, {"sizes": [row]})
    assert head[3] == "94.64 % interval"
    assert [name for name in head if "interval" in name and "%" not in name] == []


def test_arrival_of_some_robots():
    reached = np.array([[True, True, False], [False, False, True], [True, True, True]])
    end = np.array([[5.0, 9.0, 1.0], [2.0, 2.0, 7.0], [3.0, 1.0, 2.0]])
    assert compute_completion_s(reached, end, 1).tolist() == [5.0, 7.0, 1.0]
    assert compute_completion_s(reached, end, 2).tolist() == [9.0, math.inf, 2.0]
    assert compute_completion_s(reached, end, 3).tolist() == [math.inf, math.inf, 3.0]
    assert compute_completion_s(reached, end, 4).tolist() == [math.inf] * 3


def test_a_damaged_file_of_batches_is_refused(tmp_path):
    path = tmp_path / "batches.jsonl"
    store = StudyStore(path)
    batch = Batch(
        condition="a",
        size=1,
        first=0,
        completed_s=[None, 3.0],
        arrived=[0, 1],
        lost=[1, 0],
        energy_j=[1.0, 2.0],
        path_length_m=[1.0, 2.0],
        no_room=[False, False],
    )
    store.add(batch)
    store.close()
    assert StudyStore(path).batches == [batch]
    assert batch.hits(3.0) == 1
    assert batch.hits(2.9) == 0
    older = tmp_path / "older.jsonl"
    older.write_text(path.read_text().replace('"path_length_m"', '"path_m"'))
    assert StudyStore(older).batches == [batch]
    path.write_text(path.read_text().replace('"lost":[1,0]', '"lost":[1]'))
    with pytest.raises(ConfigError, match="cannot be read"):
        StudyStore(path)
