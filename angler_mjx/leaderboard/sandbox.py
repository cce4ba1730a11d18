"""Programs that plan, run one problem at a time in a sandbox.

Bubblewrap gives a program namespaces of its own: no network, no user rights, no processes but its
own, and no files but system libraries or those of its image (read-only), its folder (read-only),
the problem (read-only) and an empty folder for its plan. Memory, processor time, processes and what
is written are limited; at the time limit the whole sandbox is killed.
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
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import IO, Any

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
DEFAULT_PATH = "/usr/local/bin:/usr/bin:/bin"
_ISOLATION = (
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
    DEFAULT_PATH,
)
"""First arguments of bubblewrap."""
_OTHER_ENTRIES = ("proc", "dev", "tmp", FOLDER, "problem.zarr", "out")
"""Entries of the sandbox's root that are no image's."""


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
    image: Path | None = None,
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
        image: folder of the program's image, unpacked; without one it has the system's folders.
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
                image,
            )
            for world in range(entry.problems)
        ]
    )


@contextlib.contextmanager
def open_scratch() -> Iterator[Path]:
    """Make a folder that users of sandboxes may enter, and delete it afterwards."""
    folder = Path(tempfile.mkdtemp(prefix="angler-sandbox-"))
    try:
        folder.chmod(0o755)
        yield folder
    finally:
        # Python itself cannot delete a thousand folders in each other.
        for command in (("chmod", "-R", "u+rwX"), ("rm", "-rf")):
            subprocess.run([*command, folder], stderr=subprocess.DEVNULL, check=False)


def _measure_start(bubblewrap: str) -> float:
    """Return the seconds that a sandbox takes for a program that does nothing.

    They are measured for each set: a machine that was busy once would make all programs look fast.

    Raises:
        UnsupportedError: it does not run there.
    """
    config = ProgramConfig(command=("/usr/bin/true",))
    forking = ProgramConfig(command=("/bin/sh", "-c", "/usr/bin/true; exit $?"))
    times = []
    with open_scratch() as folder:
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
    image: Path | None,
) -> PlanRows:
    limit_s = time_factor * entry.limit_s
    single = problem_sets.single_problem(entry)
    with open_scratch() as folder:
        # A link is copied as it is: in the sandbox it leads to nothing of the judge.
        if (source / FOLDER).exists():
            shutil.copytree(source / FOLDER, folder / FOLDER, symlinks=True)
        extract_problem(problems / f"{entry.name}.zarr", world, folder / "problem.zarr")
        (folder / "out").mkdir()
        (folder / "out").chmod(0o777)
        begin = time.perf_counter()
        fault = run_program(bubblewrap, config, folder, limit_s, image)
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


def run_program(
    bubblewrap: str, config: ProgramConfig, folder: Path, limit_s: float, image: Path | None = None
) -> str:
    """Run a program on one problem; returns what went wrong, or an empty text.

    Args:
        bubblewrap: path of it.
        config: command and limits.
        folder: with ``program``, which an image may do without, ``problem.zarr``, and ``out`` for
            the plan.
        limit_s: planning time.
        image: folder that is seen as the root; without one the system's folders are.
    """
    program = folder / FOLDER
    arguments = [
        *(part for name, value in config.environment.items() for part in ("--setenv", name, value)),
        *(bind_system_folders() if image is None else _bind_image(image)),
        "--proc",
        "/proc",
        "--dev",
        "/dev",
        *(
            part
            for path in ("/dev/shm", "/tmp")
            for part in ("--size", str(MAX_WRITTEN_BYTES), "--tmpfs", path)
        ),
        *(("--ro-bind", str(program), f"/{FOLDER}") if program.exists() else ()),
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
        f"/{FOLDER}" if program.exists() else "/",
        "--",
        *config.command,
        "/problem.zarr",
        "/out/plan.zarr",
    ]
    limits = {
        "as": int(config.memory_gib * 2**30),
        "cpu": max(1, math.ceil(limit_s * config.processes)),
        "fsize": MAX_WRITTEN_BYTES,
        "core": 0,
        "nofile": 256,
    }
    check = partial(check_written, folder / "out")
    return run_sandbox(
        bubblewrap, arguments, limits, config.processes, limit_s, check, unprivileged()
    )


def run_sandbox(
    bubblewrap: str,
    arguments: Sequence[str],
    limits: Mapping[str, int],
    processes: int,
    limit_s: float,
    check: Callable[[], str],
    user: Mapping[str, Any],
    stdin: IO[bytes] | int = subprocess.DEVNULL,
    poll_s: float = POLL_S,
) -> str:
    """Run a command in namespaces of its own; returns what went wrong, or an empty text.

    Nothing of the sandbox runs any more when this returns or raises.

    Args:
        bubblewrap: path of it.
        arguments: of it: what is seen, and the command behind ``--``.
        limits: by the names of ``prlimit``, for each process.
        processes: processes and threads together.
        limit_s: wall-clock time.
        check: returns what is wrong with what was written so far.
        user: of the process, as `subprocess.Popen` takes it.
        stdin: file of the standard input.
        poll_s: time between two checks.
    """
    info_read, info = os.pipe()
    hold, release = os.pipe()
    command = [
        shutil.which("prlimit") or "prlimit",
        *(f"--{name}={limit}" for name, limit in limits.items()),
        bubblewrap,
        *_ISOLATION,
        "--info-fd",
        str(info),
        "--block-fd",
        str(hold),
        *arguments,
    ]
    with (
        tempfile.TemporaryFile() as errors,
        open(info_read, "rb") as info_file,
        open(release, "wb", buffering=0) as release_file,
    ):
        try:
            process = subprocess.Popen(
                command,
                stdin=stdin,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                start_new_session=True,
                pass_fds=(info, hold),
                env={},  # a program can read it in /proc/1
                **user,
            )
        finally:
            os.close(info)
            os.close(hold)
        first = None
        try:
            if text := info_file.read():
                first = json.loads(text)["child-pid"]
                _release(process, first, processes, user, release_file)
            fault = _watch_process(process, check, limit_s, poll_s)
        finally:
            if process.poll() is None:
                # All others of the sandbox end before its first process does.
                with contextlib.suppress(ProcessLookupError):
                    os.kill(first or process.pid, signal.SIGKILL)
            process.wait()
        fault = fault or check()
        errors.seek(max(0, errors.seek(0, os.SEEK_END) - ERROR_BYTES))
        lines = errors.read().decode(errors="replace").strip().splitlines()
    return fault or _describe_end(process.returncode, f": {lines[-1][:200]}" if lines else "")


def _release(
    process: subprocess.Popen[bytes],
    first: int,
    processes: int,
    user: Mapping[str, Any],
    release: IO[bytes],
) -> None:
    """Limit the number of processes of a sandbox, whose first one waits for it, and let it begin.

    The limit is set inside, where the kernel counts the processes of the sandbox alone; outside it
    would count all of the person who judges. It is set from outside, since an image may lack
    ``prlimit``, and by the sandbox's user, since root may lack the right.
    """
    # Bubblewrap itself has two.
    command = ["prlimit", f"--pid={first}", f"--nproc={processes + 3}"]
    if subprocess.run(command, stderr=subprocess.DEVNULL, check=False, **user).returncode:
        process.kill()
        return
    with contextlib.suppress(BrokenPipeError):
        release.write(b"x")


def _describe_end(status: int, text: str) -> str:
    """Return what went wrong by the exit status; empty if nothing did."""
    if status == 0:
        return ""
    if status in (128 + signal.SIGXCPU, 128 + signal.SIGKILL):
        return f"was killed at a limit of time or memory{text}"
    if status == 128 + signal.SIGXFSZ:
        return f"wrote a file of more than {MAX_WRITTEN_BYTES // 2**20} MiB{text}"
    names = {128 + number: number.name for number in signal.Signals}
    if status in names:
        return f"was ended by the signal {names[status]}{text}"
    return f"ended with status {status}{text}"


def _watch_process(
    process: subprocess.Popen[bytes], check: Callable[[], str], limit_s: float, poll_s: float
) -> str:
    """Wait for the end of a sandbox, its time limit, or a fault of what it wrote; returns it."""
    end = time.perf_counter() + limit_s + GRACE
    ended = os.pidfd_open(process.pid)
    try:
        fault = ""
        while not fault and not select.select([ended], [], [], poll_s)[0]:
            fault = check()
            if time.perf_counter() > end:
                fault = _describe_late(limit_s)
        return fault
    finally:
        os.close(ended)


def check_written(
    out: Path, max_files: int = MAX_WRITTEN_FILES, max_bytes: int = MAX_WRITTEN_BYTES
) -> str:
    """Return what is wrong with the amount of files in a folder; empty if nothing is."""
    files = size = 0
    folders = [out]
    while folders:
        try:
            with os.scandir(folders.pop()) as found:
                entries = list(itertools.islice(found, max_files + 1))
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
        if files > max_files or size > max_bytes:
            return f"wrote more than {max_files} files or {max_bytes // 2**20} MiB"
    return ""


def _describe_late(limit_s: float) -> str:
    return f"did not end within {limit_s:.3g} s"


def unprivileged() -> dict[str, Any]:
    """Return the user that a sandbox runs as: a number of its own, where this process is root.

    The kernel limits the processes of users other than root only, and those before Linux 5.14 count
    them by user: those of an earlier sandbox that are still ending must not count.
    """
    if os.geteuid() != 0:
        return {}
    number = FIRST_USER + (os.getpid() * 1000 + next(_sandboxes)) % 2**30
    return {"user": number, "group": number, "extra_groups": []}


def bind_system_folders() -> list[str]:
    """Return bubblewrap's arguments for the system's folders."""
    return [part for path in _SYSTEM_FOLDERS for part in _bind(path, path)]


def _bind_image(image: Path) -> list[str]:
    """Return bubblewrap's arguments for the entries of an image's root."""
    names = sorted(set(os.listdir(image)) - set(_OTHER_ENTRIES))
    return [part for name in names for part in _bind(str(image / name), f"/{name}")]


def _bind(source: str, path: str) -> Sequence[str]:
    """Return bubblewrap's arguments for a folder, file or link, to be seen at a path."""
    if os.path.islink(source):
        return ("--symlink", os.readlink(source), path)
    return ("--ro-bind", source, path) if os.path.exists(source) else ()


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
