"""Images of programs: file systems of containers, unpacked for the time of a check.

A sandbox unpacks them without rights: no path, link or device of an image reaches files of the
judge.
"""

import contextlib
import math
import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from angler_mjx.errors import UnsupportedError
from angler_mjx.leaderboard import sandbox
from angler_mjx.leaderboard.submission import ProgramConfig
from angler_mjx.progress import Progress

MAX_BYTES, MAX_FILES = 16 * 2**30, 500_000
"""What an image may hold: bytes, and files and folders."""
MAX_ROOT_ENTRIES = 100
"""Files and folders in its root, each of which is an argument of the sandbox."""
LIMIT_S, POLL_S = 600.0, 1.0
"""Time limit of the unpacking, and time between two counts of what was unpacked."""
MEMORY_BYTES, PROCESSES = 2**30, 16
"""What the unpacking may use."""
_UNPACK = r"""
umask 022
fault=$(
    {
        tar --extract --warning=none --no-same-owner --no-same-permissions --file=-
        [ $? -le 2 ] || echo "tar was ended"
    } 2>&1 | grep -a -v -e ': Cannot mknod: Operation not permitted$' \
        -e '^tar: Exiting with failure' -e '^tar: Removing leading' | head -n 1
)
[ -z "$fault" ] || { printf '%s\n' "$fault" >&2; exit 1; }
chmod -R u+rwX,go+rX,a-st .
"""
"""Unpacks standard input but for devices, which need rights. Tar messages are of faults, since its
warnings are off, and end with status 2 at most; all users may read what it unpacked."""


@dataclass(frozen=True, kw_only=True)
class ProgramImage:
    """The image of a program, if it has one."""

    root: Path | None = None
    """Folder of its files; None without an image."""
    fault: str = ""
    """Why it cannot be used."""


@contextlib.contextmanager
def open_image(
    source: Path, config: ProgramConfig | None, progress: Progress
) -> Iterator[ProgramImage]:
    """Unpack the image of a program, and delete its files afterwards.

    Args:
        source: folder of the submission.
        config: the program; None if there is none to run.
        progress: receives the progress.

    Raises:
        UnsupportedError: the sandbox is not installed, or the disk too small.
    """
    if config is None or config.image is None:
        yield ProgramImage()
        return
    progress.describe(f"unpacking {config.image}")
    with sandbox.open_scratch() as folder:
        root = folder / "root"
        root.mkdir()
        yield ProgramImage(root=root, fault=_unpack(source / config.image, root))


def _unpack(path: Path, root: Path) -> str:
    """Unpack an image into an empty folder; returns why that failed, or an empty text."""
    if not path.is_file():
        return f"{path.name} is missing"
    size, user = path.stat().st_size, sandbox.unprivileged()
    if size > MAX_BYTES:
        return f"{path.name} has more than {MAX_BYTES // 2**20} MiB"
    if size > shutil.disk_usage(root).free:
        raise UnsupportedError(
            f"{path}: does not fit on the disk of {root.parent.parent}: set TMPDIR to a folder of "
            "a larger one"
        )
    root.chmod(0o755)
    if user:
        os.chown(root, user["user"], user["group"])
    arguments = [
        *("--setenv", "LC_ALL", "C"),
        *sandbox.bind_system_folders(),
        *("--proc", "/proc", "--dev", "/dev", "--bind", str(root), "/image"),
        *("--remount-ro", "/dev", "--remount-ro", "/", "--chdir", "/image"),
        *("--", "/bin/sh", "-c", _UNPACK),
    ]
    limits = {
        "as": MEMORY_BYTES,
        "cpu": math.ceil(LIMIT_S),
        "fsize": MAX_BYTES,
        "core": 0,
        "nofile": 256,
    }
    check = partial(sandbox.check_written, root, MAX_FILES, MAX_BYTES)
    with path.open("rb") as file:
        fault = sandbox.run_sandbox(
            sandbox.require_sandbox(),
            arguments,
            limits,
            PROCESSES,
            LIMIT_S,
            check,
            user,
            stdin=file,
            poll_s=POLL_S,
        )
    if fault:
        return f"{path.name} cannot be unpacked: {fault}"
    is_wide = len(os.listdir(root)) > MAX_ROOT_ENTRIES
    return f"{path.name} has more than {MAX_ROOT_ENTRIES} entries in its root" if is_wide else ""
