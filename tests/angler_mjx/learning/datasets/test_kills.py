"""Making a dataset, killed at any moment, goes on to the same bytes."""

import hashlib
import os
import random
import signal
import subprocess
import sys
import time

import pytest

KILLS = 50
EPISODES = 40
REWRITTEN = (
    *("summary.json", "run.log", "environment.json"),
    *("dataset.json", "sha256sums.txt", "README.md"),
)
"""They hold times, and the command of the process that finished."""


def bytes_of(folder):
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in REWRITTEN
    }


def command(file, out, *more):
    line = ["dataset", "make", str(file), "--episodes", str(EPISODES), "--out", str(out), *more]
    return subprocess.Popen(
        [sys.executable, "-c", "from angler_mjx.cli.main import main; main()", *line],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env={**os.environ, "NO_COLOR": "1"},
    )


@pytest.mark.nightly(
    by="tests/angler_mjx/learning/datasets/test_generation.py::test_a_broken_off_making_goes_on_to_the_same_bytes"
)
def test_fifty_kills_lose_nothing(file, tmp_path):
    whole = tmp_path / "whole"
    begun_at = time.monotonic()
    assert command(file, whole).wait() == 0
    longest = 1.5 * (time.monotonic() - begun_at)
    wanted = bytes_of(whole)
    assert len(wanted) > 20
    rng, kills, finished = random.Random(0), 0, 0
    while kills < KILLS:
        out, more = tmp_path / f"out{finished}", ()
        while True:
            making = command(file, out, *more)
            try:
                _, output = making.communicate(timeout=rng.uniform(0.0, longest))
            except subprocess.TimeoutExpired:
                making.send_signal(signal.SIGKILL)
                making.communicate()
                kills += 1
                print(f"killed {kills} times, {finished} finished", flush=True)
                if (out / "dataset.json").exists():  # killed on its way out
                    break
                begun = out.exists() or (tmp_path / f".{out.name}.partial").exists()
                more = ("--resume",) if begun else ()
            else:
                assert making.returncode == 0, output.decode()
                break
        assert bytes_of(out) == wanted
        finished += 1
    print(f"{kills} kills, {finished} datasets finished")
    assert finished > 1
