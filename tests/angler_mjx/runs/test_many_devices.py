"""The same bytes on any number of devices and processes, and what happens when one goes away.

Devices are forced on the CPU, so all of this runs in processes of its own. The compiler does the
least it can: what is compared went through the same compiler. (Not by XLA's older emitters: theirs
differ in the last digit between one device and several.)
"""

import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import zarr

from angler_mjx.storage.folder import Run, partial_path

SCENARIO = """
schema_version = 1
name = "spread"
worlds = 7
seed = 3
tile = 2

[time]
horizon_s = 26.0
record_hz = 2.0

[world]
preset = "open"
placement = "random"

[[fleet]]
vehicle = "bluerov2"
cruise_speed_mps = 1.0
"""

HERE = Path(__file__).parent
COLLECTIVE = re.compile(r"all-reduce|all-gather|all-to-all|collective-permute|reduce-scatter")


def start(*arguments, cache):
    environment = os.environ | {
        "JAX_PLATFORMS": "cpu",
        "JAX_COMPILATION_CACHE_DIR": str(cache),
        "XLA_FLAGS": "--xla_force_host_platform_device_count=8 "
        "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true",
    }
    return subprocess.Popen(
        [sys.executable, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    )


def both(*commands, cache):
    """Exit codes, outputs and messages of processes started together."""
    started = [start(*command, cache=cache) for command in commands]
    try:
        ends = [process.communicate(timeout=500) for process in started]
    finally:
        for process in started:
            process.kill()
    return [(p.returncode, out, err) for p, (out, err) in zip(started, ends, strict=True)]


def free_port():
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        return probe.getsockname()[1]


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def scenario_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("scenario") / "spread.toml"
    path.write_text(SCENARIO)
    return path


@pytest.fixture(scope="module")
def runs(scenario_file, cache, tmp_path_factory):
    """Folder of the runs on 1 and 3 devices, the last program, and what was said.

    Seven worlds are four tiles: a wave of three, and one of one beside two idle devices.
    """
    out = tmp_path_factory.mktemp("devices")
    [(code, program, said)] = both(
        (HERE / "many_devices.py", scenario_file, out, 1, 3), cache=cache
    )
    assert code == 0, said
    return out, program, said


def files(run):
    """Everything in the trajectories but the description, by path."""
    root = run.path / "trajectories.zarr"
    return {p.relative_to(root): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()}


def assert_same(one, other):
    assert one.episodes.schema.equals(other.episodes.schema, check_metadata=True)
    for name in one.episodes.column_names:
        # numpy's comparison takes NaN as equal to NaN; Arrow's does not.
        np.testing.assert_array_equal(
            one.episodes[name].to_numpy(), other.episodes[name].to_numpy(), err_msg=name
        )
    assert files(one) == files(other)


@pytest.mark.parametrize("name", ["3_devices_2", "3_devices_100"])
def test_the_same_bytes_on_any_number_of_devices_and_for_any_chunk(runs, name):
    out, _, _ = runs
    one, other = Run(out / "1_devices_100"), Run(out / name)
    assert_same(one, other)
    assert other.summary["complete"]
    assert other.summary["devices"] == int(name[0])


@pytest.mark.nightly(by="test_the_same_bytes_on_any_number_of_devices_and_for_any_chunk")
def test_half_of_a_wave_that_is_idle_changes_nothing(runs, scenario_file, cache, tmp_path):
    # Four tiles on eight devices.
    command = (HERE / "many_devices.py", scenario_file, tmp_path, 8)
    [(code, program, said)] = both(command, cache=cache)
    assert code == 0, said
    assert_same(Run(runs[0] / "1_devices_100"), Run(tmp_path / "8_devices_100"))
    assert COLLECTIVE.findall(program) == []


def test_tiles_of_a_wave_end_by_themselves(runs):
    # One tile is over long before the horizon, another one runs to it beside it.
    out, _, _ = runs
    run = Run(out / "3_devices_100")
    assert run.episodes["world"].to_pylist() == list(range(7))
    assert set(run.episodes["outcome"].to_pylist()) == {"reached", "timeout"}
    missing = np.isnan(run.trajectories["p_m"][:, -1, 0, 0])
    np.testing.assert_array_equal(missing[:2], missing[0])
    assert missing.any()
    assert not missing.all()


def test_devices_do_not_talk_to_each_other(runs):
    _, program, _ = runs
    assert "num_partitions=3" in program
    assert COLLECTIVE.findall(program) == []


def test_fewer_devices_than_asked_says_how_many(runs):
    _, _, said = runs
    assert "--devices 9: there are 8" in said


def test_two_processes_write_the_same_run(runs, scenario_file, cache, tmp_path):
    out, _, _ = runs
    shared, port = tmp_path / "shared", free_port()
    command = ["-m", "angler_mjx.cli.main", "rollout", scenario_file, "--out", shared]
    command += ["--distributed", "--coordinator", f"localhost:{port}", "--processes", "2"]
    command += ["--devices", "1", "--no-figures", "--json", "--process"]
    (code_0, said_0, errors_0), (code_1, said_1, errors_1) = both(
        [*command, "0"], [*command, "1"], cache=cache
    )
    assert code_0 == 0, errors_0
    assert code_1 == 0, errors_1
    assert said_0.startswith("{")
    assert said_1 == ""
    run = Run(shared)
    assert_same(Run(out / "1_devices_100"), run)
    assert run.summary["complete"]
    assert (run.summary["processes"], run.summary["devices"]) == (2, 2)
    assert run.summary["timing"]["vehicle_steps"] > 0


@pytest.mark.nightly(by="test_a_lost_process_ends_the_wait_of_the_others")
def test_a_fault_of_process_0_ends_the_other_too(scenario_file, cache, tmp_path):
    (tmp_path / "there").mkdir()
    port = free_port()
    command = ["-m", "angler_mjx.cli.main", "rollout", scenario_file, "--out", tmp_path / "there"]
    command += ["--distributed", "--coordinator", f"localhost:{port}", "--processes", "2"]
    ends = both([*command, "--process", "0"], [*command, "--process", "1"], cache=cache)
    assert [code for code, _, _ in ends] == [2, 2]
    assert "exists" in ends[0][2]
    assert "process 0 failed" in ends[1][2]
    assert not partial_path(tmp_path / "there").exists()


@pytest.mark.parametrize(
    ("then", "word"), [("die", "process 1 is gone"), ("fail", "its disk is full")]
)
def test_a_lost_process_ends_the_wait_of_the_others(then, word, cache):
    port = free_port()
    script = HERE / "two_processes.py"
    (code, out, err), (lost, _, _) = both(
        (script, port, 0, then), (script, port, 1, then), cache=cache
    )
    assert out.startswith("[{'process': 0}, {'process': 1}]")
    assert code == 1
    assert word in err
    assert "--resume" in err
    assert lost in (3, 4)


def test_what_is_read_back_is_what_zarr_itself_would_read(runs):
    # The shards are written by our own code: every chunk of every array decodes, and the last,
    # incomplete shard holds no more worlds than the run.
    out, _, _ = runs
    run = Run(out / "1_devices_100")
    for name, array in run.trajectories.arrays():
        assert np.asarray(array[...]).shape == array.shape, name
    assert isinstance(run.trajectories["p_m"], zarr.Array)
    assert run.trajectories["p_m"].shape == (7, 52, 1, 3)
