"""Processes that share the making of a dataset: in threads by a run that was flown before, and in
earnest at night."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.learning.datasets import generation, index, manifest
from angler_mjx.progress import Progress
from angler_mjx.runs import multi_run, rollout
from angler_mjx.runs.storage import folder, output_lock
from angler_mjx.runs.storage.atomic_files import write_json
from angler_mjx.runs.storage.folder import Run

from ...threads import together


@pytest.fixture
def flown_before(made, monkeypatch):
    """Runs that the first process copies from the dataset, with the meetings of a run."""
    parts = {part.seed: made / part.path for part in manifest.read_manifest(made).parts}
    flights = []

    def fly(scenario, *, out, processes, **how):
        flights.append((processes.index, scenario.seed))
        processes.meet("folder")
        if processes.index == 0:
            shutil.copytree(parts[scenario.seed], out)
        processes.meet("closed")
        return Run(out)

    monkeypatch.setattr(rollout, "rollout", fly)
    return flights


def test_parts_are_flown_together_and_one_writes_the_rest(file, made, flown_before, tmp_path):
    request, out = generation.read_request(file, 6), tmp_path / "out"
    ends, ours = together(
        3, lambda one: generation.make_dataset(request, out, progress=Progress(), processes=one)
    )
    assert ends == [out] * 3
    assert len(flown_before) == 6
    assert index.read_index(out).equals(index.read_index(made))
    # Who left before all others were done would end their wait.
    assert [one.left for one in ours] == [0, 0, 0]


def test_a_part_that_is_whole_is_begun_by_nobody(file, made, flown_before, tmp_path):
    request, out = generation.read_request(file, 6), tmp_path / "out"
    claimed = output_lock.acquire(out, kind="dataset")
    write_json(claimed.building / multi_run.REQUEST_FILE, request.resolved())
    first = manifest.read_manifest(made).parts[0]
    shutil.copytree(made / first.path, claimed.building / first.path)
    claimed.release()
    ends, _ = together(
        2,
        lambda one: generation.make_dataset(
            request, out, progress=Progress(), processes=one, resume=True
        ),
    )
    assert ends == [out] * 2
    assert sorted(flown_before) == [(i, manifest.read_manifest(made).parts[1].seed) for i in (0, 1)]


def test_what_one_cannot_do_ends_all(file, flown_before, tmp_path):
    (tmp_path / "out" / "mine").mkdir(parents=True)
    ends, ours = together(
        2,
        lambda one: generation.make_dataset(
            generation.read_request(file, 6), tmp_path / "out", progress=Progress(), processes=one
        ),
    )
    assert isinstance(ends[0], ConfigError)
    assert isinstance(ends[1], RunError)
    assert "exists" in str(ends[0])
    assert "exists" in str(ends[1])
    assert [one.left for one in ours] == [1, 1]
    assert not flown_before


def commands(file, out, *more):
    """Two processes that share a making, started."""
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        port = probe.getsockname()[1]
    command = [sys.executable, "-m", "angler_mjx.cli.main", "dataset", "make", str(file)]
    command += ["--episodes", "6", "--out", str(out), "--distributed", "--processes", "2"]
    command += ["--coordinator", f"localhost:{port}", *more, "--process"]
    return [
        subprocess.Popen(
            [*command, str(i)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"JAX_PLATFORMS": "cpu"},
        )
        for i in (0, 1)
    ]


@pytest.mark.nightly(by="test_parts_are_flown_together_and_one_writes_the_rest")
def test_two_processes_make_the_same_dataset_also_when_one_was_lost(file, made, tmp_path):
    out = tmp_path / "out"
    started = commands(file, out)
    building = output_lock.partial_path(out)
    try:
        # Killed when the first part is whole: by then it is at the second.
        until = time.monotonic() + 400
        while not (
            building / manifest.read_manifest(made).parts[0].path / folder.SUMMARY
        ).is_file():
            assert time.monotonic() < until
            assert all(one.poll() is None for one in started)
            time.sleep(0.1)
        started[1].send_signal(signal.SIGKILL)
        _, output = started[0].communicate(timeout=300)
        assert started[0].returncode == 2
        assert "process 1 is gone" in " ".join(output.split())
        assert "--resume" in output
        assert building.is_dir()
        assert not (out / manifest.MANIFEST).exists()
    finally:
        for one in started:
            one.kill()
            one.communicate()
    again = commands(file, out, "--resume")
    ends = [one.communicate(timeout=400) for one in again]
    assert [one.returncode for one in again] == [0, 0], ends
    assert ends[1][0] == ""
    assert_same(out, made)


def assert_same(out: Path, made: Path):
    """Every byte of the samples, and every row."""
    names = [p.relative_to(made) for p in made.rglob("trajectories.zarr/**/*") if p.is_file()]
    assert names
    for name in names:
        assert (out / name).read_bytes() == (made / name).read_bytes(), name
    assert index.read_index(out).equals(index.read_index(made))
    for part in manifest.read_manifest(made).parts:
        ours, theirs = Run(out / part.path).episodes, Run(made / part.path).episodes
        assert ours.equals(theirs)
