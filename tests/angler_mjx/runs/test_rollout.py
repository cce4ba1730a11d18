"""Whole runs: the same bytes for any chunking and after any interruption, and what they hold."""

import hashlib
import json
import os
import re
import resource
import shutil
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import chex
import jax
import numpy as np
import pytest
import zarr

from angler_mjx.cli.main import main
from angler_mjx.errors import ConfigError, RunError
from angler_mjx.progress import Progress
from angler_mjx.robot.vehicles import library
from angler_mjx.runs.rollout import resume, rollout
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage import folder, input_copies
from angler_mjx.runs.storage.episode_columns import EPISODE_SCHEMA
from angler_mjx.runs.storage.folder import Run
from angler_mjx.runs.storage.output_lock import partial_path
from angler_mjx.runs.storage.results import OUTCOMES
from angler_mjx.sim.state import Outcome
from angler_mjx.testing import referee


@pytest.fixture(scope="module")
def simulator(scenario):
    simulator = Simulator(scenario)
    simulator.compile()
    return simulator


@pytest.fixture(scope="module")
def run(scenario, simulator, tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "whole"
    return rollout(scenario, out=out, chunk=2, simulator=simulator)


def leaves(group):
    """All arrays of a Zarr group by path, as raw bytes."""
    return {
        path: array[...].tobytes()
        for path, array in group.members(max_depth=None)
        if isinstance(array, zarr.Array)
    }


def assert_same(one, other):
    assert one.episodes.equals(other.episodes, check_metadata=True)
    first, second = leaves(one.trajectories), leaves(other.trajectories)
    assert first.keys() == second.keys()
    different = [name for name in first if first[name] != second[name]]
    assert different == []


def test_holds_one_row_per_robot_per_world(run, scenario):
    assert run.episodes.schema.equals(EPISODE_SCHEMA)
    assert run.episodes["world"].to_pylist() == [w for w in range(5) for _ in range(2)]
    assert run.episodes["robot"].to_pylist() == [0, 1] * 5
    assert set(run.episodes["outcome"].to_pylist()) <= set(OUTCOMES)
    assert set(run.episodes["vehicle"].to_pylist()) == {"bluerov2_heavy", "bluerov2"}
    assert run.summary["complete"]
    assert run.summary["robots"] == 10
    assert sum(row["count"] for row in run.summary["outcomes"].values()) == 10
    assert run.scenario == scenario.model_copy(update={"tile": 2, "kernels": "xla"})
    environment = json.loads((run.path / "environment.json").read_text())
    assert environment["versions"]["mujoco"] == environment["versions"]["mujoco-mjx"]


def test_the_planner_that_auto_resolved_to_is_said_and_stored(run, scenario):
    stored = json.loads((run.path / folder.CONFIG).read_text())["planner"]
    assert (stored["name"], stored["requested"]) == ("grid", "auto")
    assert Run(run.path).scenario.planner == scenario.planner
    first = (run.path / folder.LOG).read_text().splitlines()[1]
    assert first.endswith(f"planner: grid (auto: {len(scenario.members())} robots)")


def test_the_referee_agrees_as_far_as_two_samples_a_second_say(run):
    verdict = referee.judge(run.path)
    assert [one.line() for one in verdict.differences] == []
    assert verdict.robots == 10
    assert verdict.counts["outcome"].bounded == 10


def test_the_state_after_the_last_sample_is_where_the_rows_say(run, scenario):
    end = run.trajectories["end"]
    assert set(end["step"][...]) <= set(range(1, scenario.time.control_steps + 1))
    failed = 0
    for row in run.episodes.to_pylist():
        where = row["world"], row["robot"]
        outcome = Outcome[row["outcome"].upper()]
        running = outcome == Outcome.TIMEOUT
        assert end["outcome"][where] == (Outcome.RUNNING if running else outcome)
        if outcome != Outcome.REACHED:
            failed += 1
            place = [row[f"failure_{axis}_m"] for axis in "xyz"]
            np.testing.assert_array_equal(end["p_m"][where], np.float32(place))
    assert failed > 0


def test_rows_agree_with_the_trajectories(run):
    flown = run.trajectories["p_m"][...]
    outcome = run.trajectories["outcome"][...]
    start = run.trajectories["environment/start_m"][...]
    np.testing.assert_array_equal(flown[:, 0], start)
    goal = run.trajectories["environment/goal_m"][...]
    rows = run.episodes.to_pylist()
    for row in rows:
        world, robot = row["world"], row["robot"]
        path = flown[world, :, robot]
        path = path[np.isfinite(path[:, 0])]
        straight = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
        running = outcome[world, :, robot] == Outcome.RUNNING
        if row["outcome"] == "timeout":
            # Chords of 0.5 s are shorter than the way, by little at these speeds; the last half
            # second is not among the samples.
            assert straight <= row["path_length_m"] + 1e-3
            assert row["path_length_m"] < straight + 0.6
            assert running.all()
        if row["outcome"] == "reached":
            at = round(row["time_to_goal_s"] * 2)
            assert running[:at].all()
            near = np.linalg.norm(flown[world, min(at, 39), robot] - goal[world, robot])
            assert near < 0.3 + 0.5


def test_chunking_changes_no_byte(run, scenario, simulator, tmp_path):
    out = tmp_path / "chunk"
    assert_same(run, rollout(scenario, out=out, chunk=100, simulator=simulator))


class Beside:
    """One of two that share a run, as `runs.processes.Processes`: threads of this process."""

    count, stopping = 2, False

    def __init__(self, index, meeting, brought):
        self.index, self._meeting, self._brought = index, meeting, brought

    def check(self):
        """The other one is here as long as this one is."""

    def meet(self, name, value=None):
        self._brought[self.index] = (name, value)
        self._meeting.wait(100.0)
        names, values = zip(*self._brought, strict=True)
        assert set(names) == {name}
        self._meeting.wait(100.0)
        return list(values)

    def fail(self, reason):
        self._meeting.abort()

    def stop(self):
        """Nobody interrupts."""

    def leave(self):
        """There is nothing to leave."""


def test_two_that_share_a_run_write_the_same_bytes(run, scenario, simulator, tmp_path):
    meeting, brought = threading.Barrier(2), [None, None]

    def share(index):
        here = Beside(index, meeting, brought)
        return rollout(scenario, out=tmp_path / "run", simulator=simulator, processes=here)

    with ThreadPoolExecutor(2) as threads:
        both = list(threads.map(share, range(2)))
    for one in both:
        assert_same(run, one)
        assert one.summary["complete"]
        assert (one.summary["processes"], one.summary["devices"]) == (2, 2)
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_the_command_prints_the_documented_keys(
    scenario_file, simulator, tmp_path, capsys, monkeypatch
):
    # The command takes the simulator of its scenario that is compiled already.
    monkeypatch.setattr("angler_mjx.runs.rollout.Simulator", lambda *_, **__: simulator)
    out = tmp_path / "run"
    main(["rollout", str(scenario_file), "--out", str(out), "--no-figures", "--json"])
    summary = json.loads(capsys.readouterr().out)
    assert sorted(summary) == sorted(
        [
            "scenario", "engine", "kernels", "seed", "tile", "devices", "processes", "worlds",
            "worlds_done", "complete", "robots", "outcomes", "planned_rate", "planning",
            "passed_goal_early", "time_to_goal_s",
            "path_length_m", "energy_j",
            "min_clearance_m", "redraws", "by_vehicle", "timing", "peak_memory_bytes", "run",
        ]
    )  # fmt: skip
    assert summary == json.loads((out / "summary.json").read_text())


class Stop(Progress):
    """Presses Ctrl-C in the middle of the second tile."""

    def __init__(self):
        self.done, self.told = 0.0, []

    def advance(self, worlds, vehicle_steps):
        self.done += worlds
        if self.done > 2.5:
            raise KeyboardInterrupt


class Listen(Progress):
    """Keeps what it is told."""

    def __init__(self):
        self.told = []

    def report(self, text):
        self.told.append(text)


def test_interrupted_and_resumed_is_the_same_run(run, scenario, simulator, tmp_path):
    out = tmp_path / "cut"
    cut = rollout(scenario, out=out, chunk=100, progress=Stop(), simulator=simulator)
    assert not cut.summary["complete"]
    assert cut.summary["worlds_done"] == 2
    assert_same(run, resume(out, simulator=simulator))
    with pytest.raises(ConfigError, match="complete"):
        resume(out)


def test_interrupted_at_once_leaves_nothing(scenario, simulator, tmp_path):
    class Stop(Progress):
        """Presses Ctrl-C in the first tile."""

        def advance(self, worlds, vehicle_steps):
            raise KeyboardInterrupt

    with pytest.raises(RunError, match="interrupted"):
        rollout(scenario, out=tmp_path / "none", progress=Stop(), simulator=simulator)
    assert list(tmp_path.iterdir()) == []


@contextmanager
def files_restored():
    """Afterwards files may be as large as before."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_keeps_the_finished_tiles(run, scenario, simulator, tmp_path):
    class FillUp(Progress):
        """Fills the disk in the last tile."""

        done = 0.0

        def advance(self, worlds, vehicle_steps):
            self.done += worlds
            if self.done > 4.5:
                # Two kilobytes hold no array of samples, but the metadata that are written before.
                resource.setrlimit(resource.RLIMIT_FSIZE, (2048, resource.RLIM_INFINITY))

    out = tmp_path / "full"
    with files_restored(), pytest.raises(RunError, match=r"worlds [024] and on failed") as caught:
        rollout(scenario, out=out, progress=FillUp(), simulator=simulator)
    assert partial_path(out).exists() == ("--resume" in str(caught.value))
    if partial_path(out).exists():
        assert_same(run, resume(out, simulator=simulator))


def test_out_of_device_memory_names_the_tile_that_fits(run, scenario, simulator, tmp_path):
    class Small(Simulator):
        """A simulator on a device that has no room for the third tile."""

        def __init__(self):
            self.__dict__.update(simulator.__dict__)

        def begin(self, firsts, *, seed=None, counts=None):
            if firsts[0] == 4:
                raise jax.errors.JaxRuntimeError(
                    "RESOURCE_EXHAUSTED: Out of memory allocating 1 TB"
                )
            return super().begin(firsts, seed=seed)

    out = tmp_path / "small"
    with pytest.raises(RunError, match="largest tile that fits is about 1 worlds"):
        rollout(scenario, out=out, simulator=Small())
    assert_same(run, resume(out, simulator=simulator))


def test_a_tile_larger_than_the_memory_is_refused_before_the_first_world(scenario, tmp_path):
    huge = scenario.model_copy(update={"worlds": 2**30, "tile": 2**30})
    with pytest.raises(RunError, match=r"largest tile that fits is about [1-9][0-9]* worlds"):
        rollout(huge, out=tmp_path / "huge")
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_compiled_between_tiles(simulator):
    def tile(first):
        worlds = simulator.worlds(first)
        return jax.block_until_ready(simulator.segment(worlds, simulator.reset(worlds)))

    tile(0)
    compiled = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, *_, **__: compiled.append(event) if "backend_compile" in event else None
    )
    tile(2)
    tile(4)
    assert compiled == []


def test_a_world_is_the_same_wherever_its_tile_stands(simulator):
    early, late, other = jax.device_get(
        (simulator.worlds(1), simulator.worlds(2), simulator.worlds(2, seed=4))
    )
    chex.assert_trees_all_equal(
        jax.tree.map(lambda leaf: leaf[1], early), jax.tree.map(lambda leaf: leaf[0], late)
    )
    assert not np.array_equal(late.environment.start_m, other.environment.start_m)


def test_a_world_that_diverges_is_marked_and_leaves_the_others_alone(simulator):
    worlds = simulator.worlds(0)

    def fly(roll_radps):
        """State and samples of ten seconds, that begin with robot 0 of world 1 rolling so."""
        state = simulator.reset(worlds)
        nu = np.array(state.vehicles.nu)
        nu[1, 0, 3] = roll_radps
        nu = jax.device_put(nu, state.vehicles.nu.sharding)
        vehicles = replace(state.vehicles, nu=nu)
        return jax.device_get(simulator.segment(worlds, replace(state, vehicles=vehicles)))

    good, bad = fly(0.0), fly(np.nan)
    wanted = good[0].tally.outcome.copy()
    assert Outcome.DIVERGED not in wanted
    wanted[1, 0] = Outcome.DIVERGED
    np.testing.assert_array_equal(bad[0].tally.outcome, wanted)
    chex.assert_trees_all_equal(*(jax.tree.map(lambda leaf: leaf[0], one) for one in (good, bad)))
    chex.assert_tree_all_finite(bad[0].vehicles)


def test_an_existing_folder_is_refused_and_kept(scenario, tmp_path):
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "mine.txt").write_text("mine")
    with pytest.raises(ConfigError, match="exists"):
        rollout(scenario, out=tmp_path / "here")
    assert (tmp_path / "here" / "mine.txt").read_text() == "mine"
    assert not partial_path(tmp_path / "here").exists()


def test_cuda_kernels_without_a_gpu_are_refused(scenario):
    if jax.default_backend() == "gpu":
        pytest.skip("there is a GPU here")
    fused = scenario.model_copy(update={"engine": "fused", "kernels": "cuda"})
    with pytest.raises(ConfigError, match='use kernels = "xla"'):
        Simulator(fused)


def test_what_takes_the_name_meanwhile_costs_nothing(run, scenario, simulator, tmp_path):
    class Squat(Progress):
        """Puts something of another under the run's name, which was empty."""

        def report(self, text):
            if not text.startswith("compiled"):
                return
            assert list((tmp_path / "mine").iterdir()) == []
            (tmp_path / "mine" / "of_another.txt").write_text("other")

    out = tmp_path / "mine"
    with pytest.raises(RunError, match=r"what was made is whole in .*\.mine\.partial"):
        rollout(scenario, out=out, progress=Squat(), simulator=simulator)
    assert (out / "of_another.txt").read_text() == "other"
    partial_path(out).rename(tmp_path / "moved")
    assert_same(run, Run(tmp_path / "moved"))


def test_names_that_cannot_be_are_refused_before_anything_is_computed(scenario, tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    with pytest.raises(ConfigError, match="exists as a link to nothing"):
        rollout(scenario, out=tmp_path / "link")
    for length in (247, 300, 5000):
        with pytest.raises(ConfigError, match=r"247 bytes, 246 are the most|bytes|too long"):
            rollout(scenario, out=tmp_path / ("x" * length))
    assert [path.name for path in tmp_path.iterdir()] == ["link"]


def test_a_living_run_is_not_resumed(scenario, simulator, tmp_path):
    out = tmp_path / "alive"

    class Twice(Progress):
        """Tries the same run from another process's place."""

        said = ""

        def report(self, text):
            if not text.startswith("compiled"):
                return
            for again in (lambda: resume(out), lambda: rollout(scenario, out=out)):
                with pytest.raises(ConfigError, match=rf"another process.*{os.getpid()}") as caught:
                    again()
                self.said = str(caught.value)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rollout(scenario, out=out, progress=Twice(), simulator=simulator)
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def cut(scenario, simulator, tmp_path_factory):
    out = tmp_path_factory.mktemp("cut") / "run"
    rollout(scenario, out=out, chunk=100, progress=Stop(), simulator=simulator)
    return out


def test_another_scenario_is_not_resumed(cut, scenario):
    other = scenario.model_copy(update={"name": "other"})
    with pytest.raises(ConfigError, match="run of 'small', not of 'other'"):
        resume(cut, scenario=other)
    nearer = scenario.model_copy(update={"goal_tolerance_m": 0.1})
    with pytest.raises(ConfigError, match="goal_tolerance_m"):
        resume(cut, scenario=nearer)
    assert not Run(cut).summary["complete"]


def test_a_refused_resume_leaves_the_folder_under_its_name(cut, tmp_path):
    """The vehicle was edited since, as far as the list of inputs says."""
    out = tmp_path / "run"
    shutil.copytree(cut, out)
    index = out / "inputs" / "inputs.json"
    table = json.loads(index.read_text())
    for one in table["files"]:
        one["sha256"] = "0" * 64
    index.write_text(json.dumps(table))
    before = sorted(out.rglob("*"))
    with pytest.raises(ConfigError, match="edited since the run began"):
        resume(out)
    assert sorted(out.rglob("*")) == before
    assert list(tmp_path.iterdir()) == [out]
    assert not Run(out).summary["complete"]


def damaged_part(building):
    place = building / "parts" / "before.parquet"
    place.write_bytes(place.read_bytes()[:-40])


def missing_array(building):
    shutil.rmtree(building / "trajectories.zarr" / "p_m")


def missing_shard(building):
    (building / "trajectories.zarr" / "q" / "c" / "0" / "0" / "0" / "0").unlink()


def cut_environment(building):
    place = building / "trajectories.zarr" / "environment" / "goal_m" / "c" / "0" / "0" / "0"
    place.write_bytes(place.read_bytes()[:-3])


def cut_description(building):
    place = building / "trajectories.zarr" / "nu" / "zarr.json"
    place.write_text(place.read_text()[:100])


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (damaged_part, "worlds are computed again"),
        (missing_array, "p_m.*computed again"),
        (missing_shard, "/q: worlds 0 and on"),
        (cut_environment, "goal_m: worlds 0 and on"),
        (cut_description, "nu/zarr.json: was missing or damaged"),
    ],
)
def test_what_is_damaged_is_computed_again(run, cut, scenario, simulator, tmp_path, damage, told):
    out = tmp_path / "run"
    shutil.copytree(cut, out)
    folder.reopen_folder(out, print).release()
    damage(partial_path(out))
    listener = Listen()
    assert_same(run, resume(out, scenario=scenario, simulator=simulator, progress=listener))
    assert any(re.search(told, text) for text in listener.told), listener.told
    log = (out / "run.log").read_text()
    assert "5 of 5 worlds are finished" in log
    assert re.match(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d[+-]\d{4} 5 worlds$", log.splitlines()[0])


def test_an_unreadable_config_is_refused(cut, tmp_path):
    out = tmp_path / "run"
    shutil.copytree(cut, out)
    (out / "config.json").write_text("{")
    with pytest.raises(ConfigError, match=r"config\.json: cannot be read"):
        resume(out)
    assert (out / "episodes.parquet").is_file()


def test_every_array_names_its_dimensions(run):
    for name, node in run.trajectories.members(max_depth=None):
        if not isinstance(node, zarr.Array):
            continue
        dims = node.metadata.dimension_names
        assert len(dims) == node.ndim, name
        assert len(set(dims)) == node.ndim, name
        assert all(dims), name
    # What xarray asks of a group: a dimension has one size.
    for group in (run.trajectories, *[n for _, n in run.trajectories.members(max_depth=None)]):
        sizes = {}
        for _, array in group.arrays() if isinstance(group, zarr.Group) else ():
            for dim, size in zip(array.metadata.dimension_names, array.shape, strict=True):
                assert sizes.setdefault(dim, size) == size
    assert run.trajectories["p_m"].metadata.dimension_names == ("world", "time", "robot", "xyz")


def test_the_inputs_lie_in_the_folder_and_edited_ones_are_refused(cut, tmp_path, scenario_file):
    used = {(one.role, one.named): one for one in input_copies.read_inputs(cut)}
    assert set(used) == {
        ("vehicle", "bluerov2_heavy"),
        ("vehicle", "bluerov2"),
        ("thruster", "t200"),
    }
    for one in used.values():
        source = Path(one.source).read_bytes()
        assert hashlib.sha256(source).hexdigest() == one.sha256
    for named, copy in input_copies.vehicle_copies(cut).items():
        assert library.load_vehicle(str(copy)).rotor.model.startswith(str(cut.resolve()))
        assert (
            library.load_vehicle(str(copy)).parameter_sets
            == library.load_vehicle(named).parameter_sets
        )


def test_a_vehicle_of_ones_own_is_copied_and_an_edit_is_noticed(tmp_path, monkeypatch):
    home, away, run_path = tmp_path / "home", tmp_path / "away", tmp_path / "run"
    for place in (home, away, run_path):
        place.mkdir()
    text = library.locate_vehicle("bluerov2").read_text()
    thruster = library.locate_thruster("t200").read_text()
    (home / "own.toml").write_text(
        text.replace('"t200"', '"props.toml"').replace('name = "bluerov2"', 'name = "mine"')
    )
    (home / "props.toml").write_text(thruster)
    monkeypatch.chdir(home)
    input_copies.copy_inputs(run_path, ["own.toml"], [("plan", home / "props.toml")])
    assert input_copies.stand_ins(run_path) == {}
    input_copies.require_unchanged(run_path, flag="--resume")
    monkeypatch.chdir(away)  # where no such file is
    copy = input_copies.stand_ins(run_path)[input_copies.VEHICLE, "own.toml"]
    assert library.load_vehicle(copy).name == "mine"
    assert input_copies.vehicle_file(run_path, "mine") == copy
    input_copies.require_unchanged(run_path, flag="--resume")
    monkeypatch.chdir(home)
    (home / "props.toml").write_text(thruster + "\n# edited\n")
    with pytest.raises(ConfigError, match=r"own\.toml or its thruster file was edited"):
        input_copies.require_unchanged(run_path, flag="--resume")
    assert [one.role for one in input_copies.read_inputs(run_path)] == [
        "thruster",
        "vehicle",
        "plan",
    ]
