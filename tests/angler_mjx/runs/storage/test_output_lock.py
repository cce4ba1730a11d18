"""Names that are taken once, by one process at a time, and files that are whole or not there."""

import json
import os
import signal
import subprocess
import sys

import jax
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.runs.storage import atomic_files, environments, folder, output_lock
from angler_mjx.world.config import WorldConfig

from ...report.conftest import make_environment

HOLD = """
import sys, time
from pathlib import Path
from angler_mjx.runs.storage import output_lock
held = output_lock.acquire(Path(sys.argv[1]))
(held.building / "result").write_text("half")
print("held", flush=True)
time.sleep(600)
"""


@pytest.fixture
def holder(tmp_path):
    """A process that builds ``tmp_path / "out"``."""
    started = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path / "out")], stdout=subprocess.PIPE, text=True
    )
    assert started.stdout.readline() == "held\n"
    yield started
    started.kill()
    started.wait()
    started.stdout.close()


def test_a_living_process_is_respected_and_a_dead_one_followed(holder, tmp_path):
    out = tmp_path / "out"
    for take in (output_lock.acquire, output_lock.acquire_unfinished):
        with pytest.raises(ConfigError, match=rf"another process makes this run: {holder.pid} on"):
            take(out)
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    assert out.is_dir()
    with pytest.raises(ConfigError, match=r"an unfinished run lies in .*\.out\.partial"):
        output_lock.acquire(out)
    taken = output_lock.acquire_unfinished(out)
    assert taken is not None
    assert (taken.building / "result").read_text() == "half"
    taken.publish()
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["out", "result"]


LEAVE = """
import os, signal, sys
from pathlib import Path
from angler_mjx.runs.storage import output_lock
held = output_lock.acquire(Path(sys.argv[1]))
if sys.argv[2:]:
    (held.building / sys.argv[2]).write_text("{}")
os.kill(os.getpid(), signal.SIGKILL)
"""


def leave(out, *name):
    """What a process leaves that is killed after it took a name (and wrote one file)."""
    done = subprocess.run([sys.executable, "-c", LEAVE, str(out), *name], check=False)
    assert done.returncode == -signal.SIGKILL
    assert out.is_dir()
    assert output_lock.partial_path(out).is_dir()


def test_an_empty_claim_of_a_dead_process_is_no_hindrance(tmp_path):
    leave(tmp_path / "out")
    folder.require_none(tmp_path / "out")
    held = output_lock.acquire(tmp_path / "out")
    (held.building / "result").write_text("whole")
    held.publish()
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["out", "result"]


def test_what_somebody_put_under_the_name_of_a_dead_claim_stays(tmp_path):
    leave(tmp_path / "out")
    (tmp_path / "out" / "mine").write_text("of another")
    with pytest.raises(ConfigError, match=r"it cannot go on; remove .*out and .*\.out\.partial"):
        output_lock.acquire(tmp_path / "out")
    assert (tmp_path / "out" / "mine").read_text() == "of another"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        (folder.CONFIG, "go on with it with --resume, or remove"),
        (folder.ROBOTS, "it cannot go on; remove"),
    ],
)
def test_an_unfinished_run_says_the_one_way_on(name, words, tmp_path):
    leave(tmp_path / "out", name)
    for take in (folder.create_folder, folder.require_none):
        with pytest.raises(ConfigError, match=f"its process has ended; {words}"):
            take(tmp_path / "out")
    assert (tmp_path / ".out.partial" / name).exists()


def test_environments_of_a_killed_process_are_made_anew(tmp_path, monkeypatch):
    made = make_environment(np.random.default_rng(1), (4, 4, 4))
    batch = jax.tree.map(lambda leaf: np.asarray(leaf)[None], made)
    monkeypatch.setattr(environments, "generate_batch", lambda *_: batch)
    leave(tmp_path / "envs.zarr", "zarr.json")
    config = WorldConfig.model_validate({"preset": "open"})
    assert environments.generate_file(tmp_path / "envs.zarr", config, np.full(1, 0.4), 0, 1, 1) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["envs.zarr"]
    assert environments.open_environments(tmp_path / "envs.zarr")["valid"].shape == (1,)


def test_where_there_are_no_locks_the_file_says_who_it_is(tmp_path, monkeypatch):
    def no_locks(handle, operation):
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(output_lock.fcntl, "flock", no_locks)
    held = output_lock.acquire(tmp_path / "out")
    with pytest.raises(ConfigError, match=f"another process makes this run: {os.getpid()}"):
        output_lock.acquire_unfinished(tmp_path / "out")
    lock = held.building / output_lock.LOCK
    owner = json.loads(lock.read_text())
    # The same number, another process: begun at another time.
    lock.write_text(json.dumps(owner | {"started": "1"}))
    held.release()
    again = output_lock.acquire_unfinished(tmp_path / "out")
    assert again is not None
    lock.write_text(json.dumps(owner | {"host": "elsewhere"}))
    with pytest.raises(ConfigError, match=r"on elsewhere.*if it is gone for sure, remove"):
        output_lock.acquire_unfinished(tmp_path / "out")
    again.withdraw()
    assert list(tmp_path.iterdir()) == []


def test_the_name_is_taken_and_given_back(tmp_path):
    held = output_lock.acquire(tmp_path / "out")
    with pytest.raises(FileExistsError):
        (tmp_path / "out").mkdir()
    held.release()
    assert [path.name for path in tmp_path.iterdir()] == [".out.partial"]
    assert output_lock.acquire_unfinished(tmp_path / "nothing") is None
    (tmp_path / "empty").mkdir()
    assert output_lock.acquire_unfinished(tmp_path / "empty") is None
    with pytest.raises(ConfigError, match="exists"):
        output_lock.acquire(tmp_path / "empty")


def test_a_name_under_a_file_says_that_this_is_no_folder(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match=r"a part of .*file is no folder"):
        output_lock.acquire(tmp_path / "file" / "out")


def test_what_is_in_the_way_at_the_end_stays_and_so_does_the_work(tmp_path):
    held = output_lock.acquire(tmp_path / "out")
    (held.building / "result").write_text("whole")
    (tmp_path / "out" / "other").write_text("of another")
    with pytest.raises(RunError, match=r"what was made is whole in .*\.out\.partial"):
        held.publish()
    assert (held.building / "result").read_text() == "whole"
    assert (tmp_path / "out" / "other").read_text() == "of another"


def test_a_file_is_whole_or_as_it_was(tmp_path):
    path = tmp_path / "file.txt"
    atomic_files.write_text(path, "old")

    def broken_off():
        with atomic_files.write_atomically(path) as writing:
            writing.write_text("new, but not yet")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        broken_off()
    assert path.read_text() == "old"
    with pytest.raises(ConfigError, match="exists"), atomic_files.replace_file(path, flag="--out"):
        pass
    long = tmp_path / ("x" * 300)
    with pytest.raises(ConfigError, match="written"), atomic_files.replace_file(long, flag="--out"):
        pass
    with pytest.raises(ConfigError, match=r"--mcap .*too long"):
        atomic_files.require_free(long, flag="--mcap")
    with atomic_files.replace_file(path, flag="--out", force=True) as writing:
        writing.write_text("new")
    assert path.read_text() == "new"
    assert [one.name for one in tmp_path.iterdir()] == ["file.txt"]


def test_tables_are_written_whole(tmp_path):
    atomic_files.write_json(tmp_path / "table.json", {"a": 1})
    with pytest.raises(ValueError, match="JSON compliant"):
        atomic_files.write_json(tmp_path / "table.json", {"a": float("nan")})
    assert (tmp_path / "table.json").read_text() == '{\n  "a": 1\n}\n'
    rows = pa.table({"a": [1, 2]})
    atomic_files.write_parquet(tmp_path / "rows.parquet", rows, page_checksums=True)
    assert pq.read_table(tmp_path / "rows.parquet", page_checksum_verification=True) == rows
    with (
        pytest.raises(RunError, match=r"rows: cannot be written \(.*\); make room"),
        atomic_files.wrap_write_errors("rows", "make room"),
    ):
        atomic_files.write_parquet(tmp_path / "missing" / "rows.parquet", rows)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["rows.parquet", "table.json"]
