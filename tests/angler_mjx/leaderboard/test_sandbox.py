"""Programs of submissions in bubblewrap: what they can do, and how they fail."""

import json
import os
import shutil
import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from angler_mjx.errors import UnsupportedError
from angler_mjx.leaderboard import problem_files, sandbox
from angler_mjx.leaderboard.submission import ProgramConfig
from angler_mjx.leaderboard.submitted_plans import PlanRows

from .submitting import run_command

NAME = "open-still-known-01"
try:
    sandbox.require_sandbox()
    REASON = ""
except UnsupportedError as error:
    REASON = str(error)
needs_sandbox = pytest.mark.skipif(bool(REASON), reason=REASON)

STRAIGHT = """
import json, math, os, struct, sys
problem, plan = sys.argv[1:3]
def numbers(name):
    data = open(f"{problem}/{name}/c/0/0" + ("/0" if name.endswith("_m") else ""), "rb").read()
    return struct.unpack(f"<{len(data) // 4}f", data)
start, goal = numbers("team/start_m"), numbers("team/goal_m")
speed, = numbers("team/cruise_speed_mps")
seconds = math.dist(start, goal) / speed
attributes = json.load(open(f"{problem}/zarr.json"))["attributes"]
def write(name, shape, kind, code, values):
    os.makedirs(f"{plan}/{name}/c" + "/0" * (len(shape) - 1))
    json.dump({"zarr_format": 3, "node_type": "array", "shape": shape, "data_type": kind,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": shape}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "fill_value": 0, "codecs": [{"name": "bytes", "configuration": {"endian": "little"}}],
        "attributes": {}}, open(f"{plan}/{name}/zarr.json", "w"))
    open(f"{plan}/{name}/c" + "/0" * len(shape), "wb").write(struct.pack(code, *values))
write("points", [1, 1], "int32", "<i", [2])
write("time_s", [1, 1, 2], "float32", "<2f", [0, seconds])
write("position_m", [1, 1, 2, 3], "float32", "<6f", [*start, *goal])
json.dump({"zarr_format": 3, "node_type": "group", "attributes": {"schema": "angler_mjx plans",
    "schema_version": 1, "digest": attributes["digest"], "seed": attributes["seed"]}},
    open(f"{plan}/zarr.json", "w"))
"""


@pytest.fixture
def run(tmp_path, problems, benchmark, sets, manifest):
    """Run Python code as the program of a submission, and return its plans."""

    def run(code, count=1, time_factor=1.0, **limits):
        folder = tmp_path / "program"
        folder.mkdir(exist_ok=True)
        (folder / "plan.py").write_text(code)
        config = ProgramConfig(command=("/usr/bin/python3", "plan.py"), **limits)
        entry, record = replace(sets[NAME], problems=count), manifest.find(NAME)
        scenario = problem_files.build_set_scenario(benchmark, entry, record.attempt, b"")
        return sandbox.plan_set(tmp_path, config, entry, scenario, record, problems, time_factor)

    return run


needs_python = pytest.mark.skipif(
    shutil.which("/usr/bin/python3") is None, reason="no /usr/bin/python3 for the program"
)


@needs_sandbox
@needs_python
def test_a_program_plans_each_problem_and_is_timed(run, problems):
    rows = run(STRAIGHT, count=2)
    assert list(rows.faults) == ["", ""]
    assert rows.arrays["points"].tolist() == [[2], [2]]
    group = problems / f"{NAME}.zarr"
    for world in range(2):
        goal = np.frombuffer((group / f"team/goal_m/c/{world}/0/0").read_bytes(), "<f4")
        np.testing.assert_array_equal(rows.arrays["position_m"][world, 0, 1], goal)
    assert np.all((rows.planning_s > 0.0) & (rows.planning_s <= 1.0))


@needs_sandbox
@needs_python
def test_the_time_limit_is_as_many_times_as_long_as_the_machine_is_slow(run):
    slow = "import time; time.sleep(1.3)\n" + STRAIGHT
    assert run(slow).faults[0] == "did not end within 1 s"
    rows = run(slow, time_factor=8.0)
    assert rows.faults[0] == ""
    assert 1.3 <= rows.planning_s[0] < 8.0


@needs_sandbox
@needs_python
@pytest.mark.parametrize(
    ("name", "fault"),
    [
        ("SIGSEGV", "was ended by the signal SIGSEGV"),
        ("SIGXFSZ", "wrote a file of more than 64 MiB"),
    ],
)
def test_a_program_that_a_signal_ends_fails_with_its_name(run, name, fault):
    code = f"import os, signal\nsignal.signal(signal.{name}, signal.SIG_DFL)\n"
    code += f"os.kill(os.getpid(), signal.{name})"
    assert run(code).faults[0].startswith(fault)


@needs_sandbox
@needs_python
@pytest.mark.parametrize(
    ("code", "fault"),
    [
        ("import socket; socket.create_connection(('127.0.0.1', 1))", "status 1: "),
        ("import socket; socket.create_connection(('1.1.1.1', 80), 2)", "unreachable"),
        ("import time; time.sleep(60)", "did not end within 1 s"),
        ("import os, time\nfor i in range(1000): os.fork() or time.sleep(60)", "status 1: "),
        ("bytearray(8 << 30)", "status 1: MemoryError"),
        (f"open({__file__!r})", "status 1: FileNotFoundError"),
        ("open('/problem.zarr/zarr.json', 'a')", "status 1: "),
        ("open('/program/plan.py', 'a')", "status 1: "),
        ("open('/out/x', 'wb').write(bytes(65 << 20))", "File too large"),
        (
            "for i in range(9): open(f'/out/{i}', 'wb').write(bytes(8 << 20))",
            "wrote more than 10000 files or 64 MiB",
        ),
        (
            "import os\nfor i in range(99): os.mkdir(f'/out/{i}'); "
            "[open(f'/out/{i}/{j}', 'w') for j in range(101)]",
            "wrote more than 10000 files or 64 MiB",
        ),
        (
            "import time\nfor i in range(9): open(f'/out/{i}', 'wb').write(bytes(8 << 20))\n"
            "time.sleep(60)",
            "wrote more than 10000 files or 64 MiB",
        ),
        ("import sys\nwhile True: sys.stderr.write('x' * 99999)", "ended with status 120: xxx"),
        (
            "for i in range(9): open(f'/dev/shm/{i}', 'wb').write(bytes(8 << 20))",
            "No space left",
        ),
        ("for i in range(9): open(f'/tmp/{i}', 'wb').write(bytes(8 << 20))", "No space left"),
        ("open('/dev/x', 'wb')", "Read-only file system"),
        ("open('/x', 'wb')", "Read-only file system"),
        ("import os; assert os.getuid() != 0; raise SystemExit(7)", "ended with status 7"),
        ("", "plan.zarr is missing"),
    ],
    ids=[
        "loopback",
        "network",
        "hang",
        "fork",
        "memory",
        "files",
        "problem",
        "itself",
        "disk",
        "disk in parts",
        "many files",
        "disk and hang",
        "messages",
        "shared memory",
        "temporary files",
        "devices",
        "root",
        "rights",
        "nothing",
    ],
)
def test_a_program_that_misbehaves_fails_its_problem(run, code, fault):
    rows = run(code)
    assert len(rows.faults) == 1
    assert fault in rows.faults[0]
    assert not rows.arrays["points"].any()


@needs_sandbox
@needs_python
def test_processes_of_the_judge_do_not_count_as_the_programs(run, monkeypatch):
    """Whoever judges as an ordinary user has more processes than a program may start."""
    if os.geteuid() == 0:
        user = {"user": 54321, "group": 54321, "extra_groups": []}
        monkeypatch.setattr(sandbox, "unprivileged", lambda: user)
    else:
        user = {}
    others = [subprocess.Popen(["/usr/bin/sleep", "60"], **user) for _ in range(30)]
    try:
        assert run(STRAIGHT, processes=4).faults[0] == ""
        forks = "import os, time\nfor i in range(8): os.fork() or time.sleep(60)"
        assert "BlockingIOError" in run(forks, processes=4).faults[0]
    finally:
        for other in others:
            other.kill()
            other.wait()


@needs_sandbox
def test_a_sandbox_that_cannot_run_anything_is_said(monkeypatch):
    monkeypatch.setattr(sandbox, "run_program", lambda *_: "ended with status 1: bwrap: no")
    with pytest.raises(UnsupportedError, match="cannot run programs: /bin/sh ended with status 1"):
        sandbox._measure_start("bwrap")


@needs_sandbox
@needs_python
def test_links_of_a_program_lead_to_nothing_of_the_judge(run, tmp_path):
    (tmp_path / "secret").write_text("0123")
    (tmp_path / "program").mkdir()
    (tmp_path / "program" / "link").symlink_to(tmp_path / "secret")
    assert "FileNotFoundError" in run("open('link')").faults[0]


@needs_sandbox
@needs_python
def test_a_program_sees_its_problem_alone(run):
    rows = run("import os, sys; sys.exit(' '.join(sorted(os.listdir('/'))))")
    seen = set(rows.faults[0].split(": ")[1].split())
    assert seen <= {
        "bin",
        "dev",
        "etc",
        "lib",
        "lib64",
        "out",
        "problem.zarr",
        "proc",
        "program",
        "tmp",
        "usr",
    }


@needs_sandbox
@needs_python
def test_a_program_has_the_environment_of_its_card_and_not_the_judges(run, monkeypatch):
    monkeypatch.setenv("JUDGE_TOKEN", "0123")
    code = "import os, sys; sys.exit(os.environ['SEED'] + open('/proc/1/environ').read())"
    assert run(code, environment={"SEED": "a b"}).faults[0] == "ended with status 1: a b"


@needs_sandbox
def test_a_command_is_no_option_of_the_sandbox():
    assert "execvp --version: No such file" in run_command("--version")


@needs_sandbox
def test_nothing_runs_without_a_limit_of_processes(monkeypatch):
    run = subprocess.run

    def fail_limit(command, **options):
        if command[0] == "prlimit":
            return subprocess.CompletedProcess(command, 1)
        return run(command, **options)

    assert run_command("/usr/bin/true") == ""
    monkeypatch.setattr(subprocess, "run", fail_limit)
    assert run_command("/usr/bin/true").startswith("ended with status -9")


@needs_sandbox
def test_an_interrupt_ends_the_sandbox(monkeypatch):
    processes = []

    def interrupt(process, *_):
        processes.append(process)
        raise KeyboardInterrupt

    monkeypatch.setattr(sandbox, "_watch_process", interrupt)
    with pytest.raises(KeyboardInterrupt):
        run_command("/usr/bin/sleep", "60")
    assert [process.returncode for process in processes] == [128 + signal.SIGKILL]


def test_folders_are_deleted_however_deep_they_are(monkeypatch):
    with sandbox.open_scratch() as folder:
        monkeypatch.chdir(folder)
        for _ in range(2000):
            os.mkdir("a", 0o700)
            os.chdir("a")
        os.chmod(folder / "a", 0)
    assert not folder.exists()


def test_a_problem_of_a_set_becomes_world_0_of_a_file(problems, tmp_path):
    out = tmp_path / "problem.zarr"
    sandbox.extract_problem(problems / "open-ocean-known-01.zarr", 1, out)
    source = problems / "open-ocean-known-01.zarr"
    assert json.loads((out / "zarr.json").read_text())["attributes"]["problems"] == [
        "open-ocean-known-01/1"
    ]
    for name, depth in (("team/goal_m", 2), ("grid/occupied", 3), ("current_lattice/time_s", None)):
        tail = "/0" * (depth or 0)
        old = source / name / ("c/0" if depth is None else f"c/1{tail}")
        assert (out / name / f"c/0{tail}").read_bytes() == old.read_bytes()
        shape = json.loads((out / name / "zarr.json").read_text())["shape"]
        assert depth is None or shape[0] == 1


def test_plans_of_different_widths_are_joined():
    def rows(points, **more):
        arrays = {
            "points": np.full((1, 2), points, np.int32),
            "time_s": np.ones((1, 2, points), np.float32),
            **more,
        }
        return PlanRows(arrays=arrays, planning_s=np.array([points / 10]), faults=[f"{points}"])

    yaw = np.ones((1, 2, 2), np.float32)
    joined = sandbox.merge_rows([rows(3), rows(2, yaw_rad=yaw)])
    assert joined.arrays["points"].tolist() == [[3, 3], [2, 2]]
    assert joined.arrays["time_s"].tolist() == [[[1, 1, 1]] * 2, [[1, 1, 0]] * 2]
    assert joined.arrays["yaw_rad"].tolist() == [[[0, 0, 0]] * 2, [[1, 1, 0]] * 2]
    assert joined.planning_s.tolist() == [0.3, 0.2]
    assert joined.faults == ["3", "2"]


def test_without_bubblewrap_programs_are_refused_by_name(monkeypatch):
    monkeypatch.setenv("PATH", str(sys.prefix))
    with pytest.raises(UnsupportedError, match="apt-get install bubblewrap"):
        sandbox.require_sandbox()
