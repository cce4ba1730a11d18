"""Whole runs: the same bytes for any chunking and after any interruption, and what they hold."""

import json
import resource
from contextlib import contextmanager
from dataclasses import replace

import chex
import jax
import numpy as np
import pytest
import zarr

from angler_mjx.engines import mjx
from angler_mjx.errors import ConfigError, RunError
from angler_mjx.runs.progress import Silent
from angler_mjx.runs.rollout import resume, rollout
from angler_mjx.sim.state import Outcome
from angler_mjx.simulator.simulator import Simulator
from angler_mjx.storage.folder import partial_path
from angler_mjx.storage.results import EPISODE_SCHEMA, OUTCOMES


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
    assert one.episodes.schema == other.episodes.schema
    for name in one.episodes.column_names:
        # numpy's comparison takes NaN as equal to NaN; Arrow's does not.
        np.testing.assert_array_equal(
            one.episodes[name].to_numpy(), other.episodes[name].to_numpy(), err_msg=name
        )
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


def test_interrupted_and_resumed_is_the_same_run(run, scenario, simulator, tmp_path):
    class Stop(Silent):
        """Presses Ctrl-C in the middle of the second tile."""

        done = 0.0

        def advance(self, worlds, vehicle_steps):
            self.done += worlds
            if self.done > 2.5:
                raise KeyboardInterrupt

    out = tmp_path / "cut"
    cut = rollout(scenario, out=out, chunk=100, progress=Stop(), simulator=simulator)
    assert not cut.summary["complete"]
    assert cut.summary["worlds_done"] == 2
    assert_same(run, resume(out, simulator=simulator))
    with pytest.raises(ConfigError, match="complete"):
        resume(out)


def test_interrupted_at_once_leaves_nothing(scenario, simulator, tmp_path):
    class Stop(Silent):
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
    class FillUp(Silent):
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

        def wave(self, firsts, *, seed=None):
            if firsts[0] == 4:
                raise jax.errors.JaxRuntimeError(
                    "RESOURCE_EXHAUSTED: Out of memory allocating 1 TB"
                )
            return super().wave(firsts, seed=seed)

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


def test_a_control_step_is_traced_once_for_all_worlds(simulator):
    chex.clear_trace_counter()

    @chex.assert_max_traces(n=1)
    def control_step(engine, world, state):
        return mjx.control_step(simulator.spec, engine, world, state)

    step = jax.jit(jax.vmap(control_step, (None, 0, 0)))
    for first in (0, 2):
        worlds = simulator.worlds(first)
        state = simulator.reset(worlds)
        state, _ = step(simulator.fleet.engine, worlds, state)
        state, _ = step(simulator.fleet.engine, worlds, state)
    chex.assert_tree_all_finite(state.vehicles)


def test_a_world_is_the_same_wherever_its_tile_stands(simulator):
    early, late = simulator.worlds(1), simulator.worlds(2)
    chex.assert_trees_all_equal(
        jax.tree.map(lambda leaf: leaf[1], early), jax.tree.map(lambda leaf: leaf[0], late)
    )
    other_seed = simulator.worlds(2, seed=4)
    assert not np.array_equal(
        np.asarray(late.environment.start_m), np.asarray(other_seed.environment.start_m)
    )


def test_a_world_that_diverges_is_marked_and_leaves_the_others_alone(simulator):
    worlds = simulator.worlds(0)
    state = simulator.reset(worlds)
    nu = state.vehicles.nu.at[1, 0, 3].set(jax.numpy.nan)
    poisoned = replace(state, vehicles=replace(state.vehicles, nu=nu))
    good, _ = simulator.step(worlds, state)
    bad, _ = simulator.step(worlds, poisoned)
    np.testing.assert_array_equal(bad.tally.outcome, [[0, 0], [Outcome.DIVERGED, 0]])
    chex.assert_trees_all_equal(
        *(jax.tree.map(lambda leaf: leaf[0], state) for state in (good, bad))
    )
    chex.assert_tree_all_finite(bad.vehicles)


def test_an_existing_folder_is_refused_and_kept(scenario, tmp_path):
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "mine.txt").write_text("mine")
    with pytest.raises(ConfigError, match="exists"):
        rollout(scenario, out=tmp_path / "here")
    assert (tmp_path / "here" / "mine.txt").read_text() == "mine"
    assert not partial_path(tmp_path / "here").exists()


def test_triton_kernels_without_a_gpu_are_refused(scenario):
    if jax.default_backend() == "gpu":
        pytest.skip("there is a GPU here")
    fused = scenario.model_copy(update={"engine": "fused", "kernels": "triton"})
    with pytest.raises(ConfigError, match='use kernels = "xla"'):
        Simulator(fused)
