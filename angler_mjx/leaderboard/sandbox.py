"""Programs that plan, run one problem at a time in a sandbox.

Bubblewrap gives a program namespaces of its own: no network, no user rights, no processes but its
own, and no files but system libraries, its folder (read-only), the problem (read-only) and an empty
folder for its plan. Memory, processor time, processes and what is written are limited; at the time
limit the whole sandbox is killed.
"""

import contextlib
import itertools
import json
import math
import os
import select
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from angler_mjx.errors import UnsupportedError
from angler_mjx.leaderboard import problem_sets, submitted_plans
from angler_mjx.leaderboard.problem_files import SetRecord
from angler_mjx.leaderboard.problem_sets import ProblemSet
from angler_mjx.leaderboard.submission import ProgramConfig
from angler_mjx.leaderboard.submitted_plans import PlanRows
from angler_mjx.scenario.scenario import Scenario

FOLDER = "program"
"""Folder of the program in a submission."""
GRACE = 1.0
"""Seconds beyond the limit after which a program is ended, so that its start is no matter."""
STARTS, START_LIMIT_S = 5, 30.0
"""Empty programs whose least time is that of starting a sandbox, and the limit for each."""
NOBODY = 65534
"""User and group inside."""
FIRST_USER = 1_000_000
"""Least number of users of sandboxes, above those of people and services."""
_sandboxes = itertools.count()
MAX_WRITTEN_BYTES, MAX_WRITTEN_FILES = 64 * 2**20, 10_000
"""What a program may write: bytes in each of its folders and on standard error, and files and
folders of its plan."""
POLL_S = 0.05
"""Time between two looks at the folder of the plan: what is written meanwhile can be more."""
ERROR_BYTES = 4096
"""Read of the end of standard error."""
_SYSTEM_FOLDERS = ("/usr", "/bin", "/lib", "/lib64", "/etc/alternatives", "/etc/ld.so.cache")
"""Folders of programs and libraries, read-only in the sandbox."""


def require_sandbox() -> str:
    """Return the path of bubblewrap.

    Raises:
        UnsupportedError: it is not installed, or the kernel does not let it make namespaces.
    """
    path = shutil.which("bwrap")
    if path is None:
        raise UnsupportedError(
            "programs of submissions are run by bubblewrap: apt-get install bubblewrap; or judge "
            'plans (kind = "plans")'
        )
    test = subprocess.run(
        [
            path,
            "--unshare-all",
            "--ro-bind",
            "/usr",
            "/usr",
            "--symlink",
            "usr/lib64",
            "/lib64",
            "--symlink",
            "usr/lib",
            "/lib",
            "/usr/bin/true",
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    if test.returncode:
        raise UnsupportedError(f"bubblewrap does not work on this machine: {test.stderr.strip()}")
    return path


def plan_set(
    source: Path,
    config: ProgramConfig,
    entry: ProblemSet,
    scenario: Scenario,
    record: SetRecord,
    problems: Path,
    time_factor: float = 1.0,
) -> PlanRows:
    """Run a program once for each problem of a set, and gather its plans.

    A problem whose program fails, is late, or writes nothing usable has the reason instead.

    Args:
        source: folder of the submission.
        config: the program.
        entry: the set.
        scenario: of the set.
        record: of the set, in the manifest.
        problems: folder of problem files.
        time_factor: times as long as the reference core that a core of this machine needs; the
            time limit is so many times as long.
    """
    bubblewrap = require_sandbox()
    start_s = _measure_start(bubblewrap)
    return merge_rows(
        [
            _plan_problem(
                bubblewrap,
                source,
                config,
                entry,
                scenario,
                record,
                problems,
                world,
                time_factor,
                start_s,
            )
            for world in range(entry.problems)
        ]
    )


def _measure_start(bubblewrap: str) -> float:
    """Return the seconds that a sandbox takes for a program that does nothing.

    They are measured for each set: a machine that was busy once would make all programs look fast.

    Raises:
        UnsupportedError: it does not run there.
    """
    config = ProgramConfig(command=("/usr/bin/true",))
    forking = ProgramConfig(command=("/bin/sh", "-c", "/usr/bin/true; exit $?"))
    times = []
    with tempfile.TemporaryDirectory(prefix="angler-sandbox-") as name:
        folder = Path(name)
        folder.chmod(0o755)
        for part in (FOLDER, "problem.zarr", "out"):
            (folder / part).mkdir()
        for tried in (forking, *(config for _ in range(STARTS))):
            begin = time.perf_counter()
            if fault := run_program(bubblewrap, tried, folder, START_LIMIT_S):
                raise UnsupportedError(
                    f"the sandbox of this machine cannot run programs: {tried.command[0]} {fault}. "
                    "Users other than root need Linux 5.14, which counts their processes by sandbox"
                )
            times.append(time.perf_counter() - begin)
    return min(times)


def _plan_problem(
    bubblewrap: str,
    source: Path,
    config: ProgramConfig,
    entry: ProblemSet,
    scenario: Scenario,
    record: SetRecord,
    problems: Path,
    world: int,
    time_factor: float,
    start_s: float,
) -> PlanRows:
    limit_s = time_factor * entry.limit_s
    single = problem_sets.single_problem(entry)
    with tempfile.TemporaryDirectory(prefix="angler-sandbox-") as name:
        folder = Path(name)
        folder.chmod(0o755)
        # A link is copied as it is: in the sandbox it leads to nothing of the judge.
        shutil.copytree(source / FOLDER, folder / FOLDER, symlinks=True)
        extract_problem(problems / f"{entry.name}.zarr", world, folder / "problem.zarr")
        (folder / "out").mkdir()
        (folder / "out").chmod(0o777)
        begin = time.perf_counter()
        fault = run_program(bubblewrap, config, folder, limit_s)
        seconds = max(0.0, time.perf_counter() - begin - start_s)
        if seconds > limit_s and not fault:
            fault = _describe_late(limit_s)
        if fault:
            rows = submitted_plans.empty_rows(single, fault)
        else:
            one = SetRecord(
                name=record.name,
                attempt=record.attempt,
                digest=record.digest,
                sha256=record.sha256[world : world + 1],
                bound_s=record.bound_s[world : world + 1],
            )
            path = folder / "out" / "plan.zarr"
            problem = json.loads((folder / "problem.zarr" / "zarr.json").read_text("utf-8"))
            seed = problem["attributes"]["seed"]
            rows = submitted_plans.read_plans(path, single, one, seed, scenario.planner.points)
    return PlanRows(
        arrays=rows.arrays, planning_s=np.array([min(seconds, limit_s)]), faults=rows.faults
    )


def extract_problem(group: Path, world: int, out: Path) -> None:
    """Copy one problem of a set's raw file into a file of its own, as its world 0.

    Args:
        group: of the set, written with one chunk per world.
        world: index of the problem.
        out: to make.
    """
    for source in sorted(group.rglob("zarr.json")):
        target = out / source.parent.relative_to(group)
        target.mkdir(parents=True, exist_ok=True)
        metadata = json.loads(source.read_text(encoding="utf-8"))
        if metadata["node_type"] == "group":
            for name in ("problems", "sha256"):
                if name in metadata["attributes"]:
                    metadata["attributes"][name] = metadata["attributes"][name][world : world + 1]
        elif metadata["dimension_names"][0] == "world":
            metadata["shape"][0] = 1
            chunk = source.parent / "c" / str(world)
            copy = shutil.copytree if chunk.is_dir() else shutil.copyfile
            (target / "c").mkdir()
            copy(chunk, target / "c" / "0")
        else:
            shutil.copytree(source.parent / "c", target / "c")
        (target / "zarr.json").write_text(json.dumps(metadata), encoding="utf-8")


def run_program(bubblewrap: str, config: ProgramConfig, folder: Path, limit_s: float) -> str:
    """Run a program on one problem; returns what went wrong, or an empty text.

    Args:
        bubblewrap: path of it.
        config: command and limits.
        folder: with ``program``, ``problem.zarr``, and ``out`` for the plan.
        limit_s: planning time.
    """
    command = [
        *_limit_resources(config, limit_s),
        bubblewrap,
        "--unshare-all",
        "--die-with-parent",
        "--new-session",
        "--cap-drop",
        "ALL",
        "--uid",
        str(NOBODY),
        "--gid",
        str(NOBODY),
        "--clearenv",
        "--setenv",
        "PATH",
        "/usr/local/bin:/usr/bin:/bin",
        *(part for path in _SYSTEM_FOLDERS for part in _bind_system(path)),
        "--proc",
        "/proc",
        "--dev",
        "/dev",
        *(
            part
            for folder in ("/dev/shm", "/tmp")
            for part in ("--size", str(MAX_WRITTEN_BYTES), "--tmpfs", folder)
        ),
        "--ro-bind",
        str(folder / FOLDER),
        "/program",
        "--ro-bind",
        str(folder / "problem.zarr"),
        "/problem.zarr",
        "--bind",
        str(folder / "out"),
        "/out",
        # Both lie in memory that no limit counts.
        "--remount-ro",
        "/dev",
        "--remount-ro",
        "/",
        "--chdir",
        "/program",
        # Inside, where the kernel counts the processes of the sandbox alone; outside it would count
        # all of the person who judges. Bubblewrap itself has two.
        "prlimit",
        f"--nproc={config.processes + 3}",
        "--",
        *config.command,
        "/problem.zarr",
        "/out/plan.zarr",
    ]
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=errors,
            start_new_session=True,
            **_unprivileged(),
        )
        fault = _watch_process(process, folder / "out", limit_s)
        errors.seek(max(0, errors.seek(0, os.SEEK_END) - ERROR_BYTES))
        lines = errors.read().decode(errors="replace").strip().splitlines()
    if fault or process.returncode == 0:
        return fault
    text = f": {lines[-1][:200]}" if lines else ""
    if process.returncode in (128 + signal.SIGXCPU, 128 + signal.SIGKILL):
        return f"was killed at a limit of time or memory{text}"
    if process.returncode == 128 + signal.SIGXFSZ:
        return f"wrote a file of more than {MAX_WRITTEN_BYTES // 2**20} MiB{text}"
    names = {128 + number: number.name for number in signal.Signals}
    if process.returncode in names:
        return f"was ended by the signal {names[process.returncode]}{text}"
    return f"ended with status {process.returncode}{text}"


def _watch_process(process: subprocess.Popen[bytes], out: Path, limit_s: float) -> str:
    """Wait for the end of a sandbox, or end it for its time or what it wrote; returns why."""
    end = time.perf_counter() + limit_s + GRACE
    ended = os.pidfd_open(process.pid)
    try:
        fault = ""
        while not fault and not select.select([ended], [], [], POLL_S)[0]:
            fault = _check_written(out)
            if time.perf_counter() > end:
                fault = _describe_late(limit_s)
        if fault:
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    finally:
        os.close(ended)
    return fault or _check_written(out)


def _check_written(out: Path) -> str:
    """Return what is wrong with the amount of files in a program's folder; empty if nothing is."""
    files = size = 0
    folders = [out]
    while folders:
        try:
            with os.scandir(folders.pop()) as found:
                entries = list(itertools.islice(found, MAX_WRITTEN_FILES + 1))
        except FileNotFoundError:  # removed since
            continue
        except OSError as error:
            return f"made a folder that cannot be read: {error.strerror}"
        files += len(entries)
        for entry in entries:
            with contextlib.suppress(FileNotFoundError):
                size += entry.stat(follow_symlinks=False).st_size
                if entry.is_dir(follow_symlinks=False):
                    folders.append(Path(entry.path))
        if files > MAX_WRITTEN_FILES or size > MAX_WRITTEN_BYTES:
            return f"wrote more than {MAX_WRITTEN_FILES} files or {MAX_WRITTEN_BYTES // 2**20} MiB"
    return ""


def _describe_late(limit_s: float) -> str:
    return f"did not end within {limit_s:.3g} s"


def _unprivileged() -> dict[str, Any]:
    """Return the user that a sandbox runs as: a number of its own, where this process is root.

    The kernel limits the processes of users other than root only, and those before Linux 5.14 count
    them by user: those of an earlier sandbox that are still ending must not count.
    """
    if os.geteuid() != 0:
        return {}
    number = FIRST_USER + (os.getpid() * 1000 + next(_sandboxes)) % 2**30
    return {"user": number, "group": number, "extra_groups": []}


def _bind_system(path: str) -> Sequence[str]:
    """Return bubblewrap's arguments for a system folder, or its link."""
    if os.path.islink(path):
        return ("--symlink", os.readlink(path), path)
    return ("--ro-bind", path, path) if os.path.exists(path) else ()


def _limit_resources(config: ProgramConfig, limit_s: float) -> list[str]:
    """Return the command that limits the sandbox's processes, to stand before it."""
    seconds = max(1, math.ceil(limit_s * config.processes))
    limits = {
        "as": int(config.memory_gib * 2**30),
        "cpu": seconds,
        "fsize": MAX_WRITTEN_BYTES,
        "core": 0,
        "nofile": 256,
    }
    return ["prlimit", *(f"--{name}={limit}" for name, limit in limits.items())]


def merge_rows(parts: Sequence[PlanRows]) -> PlanRows:
    """Join the plans of single problems; arrays that only some have are left out of none.

    Args:
        parts: of one problem each, in their order.
    """
    points = max(part.arrays["time_s"].shape[2] for part in parts)
    names = sorted({name for part in parts for name in part.arrays})
    arrays = {
        name: np.concatenate([_widen(part, name, points, parts) for part in parts])
        for name in names
    }
    return PlanRows(
        arrays=arrays,
        planning_s=np.concatenate([part.planning_s for part in parts]),
        faults=[fault for part in parts for fault in part.faults],
    )


def _widen(part: PlanRows, name: str, points: int, parts: Sequence[PlanRows]) -> np.ndarray:
    """Return an array of a part with so many points; zeros where the part lacks it."""
    if name == "points":
        return part.arrays[name]
    example = next(other.arrays[name] for other in parts if name in other.arrays)
    shape = (*part.arrays["points"].shape, points, *example.shape[3:])
    wide = np.zeros(shape, example.dtype)
    if name in part.arrays:
        values = part.arrays[name]
        wide[:, :, : values.shape[2]] = values
    return wide
