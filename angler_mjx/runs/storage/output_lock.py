"""Lock and hidden name of a folder that one process builds.

``NAME`` is made at once, empty, so that nobody else can take it while the work goes on; the work
goes into the hidden ``.NAME.partial`` beside it, which takes the place of the empty folder at the
end. A file ``lock`` in it is locked while its process lives, however that ends.
"""

import fcntl
import json
import os
import platform
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.runs.storage import atomic_files

LOCK = "lock"
PREFIX, SUFFIX = ".", ".partial"

RESUMABLE, BROKEN_OFF = "go on with it with --resume, or remove", "it cannot go on; remove"
"""What can be done about an unfinished folder whose process has ended."""


@dataclass(kw_only=True)
class OutputLock:
    """Claim of a folder that this process builds."""

    out: Path
    """The name that it will have."""
    building: Path
    """Absolute path where it is built: libraries resolve relative paths each in its own way."""
    flag: str
    """How a person named it, for messages."""
    handle: int | None
    """Of the lock; None when it was given up."""

    def publish(self) -> None:
        """Give the folder its name, and part from it.

        Raises:
            RunError: the name was taken by another; the folder stays whole where it was built.
        """
        try:
            atomic_files.sync_path(self.building)
            self.building.rename(self.out)
        except OSError as error:
            self.release()
            raise RunError(
                f"{self.flag} {self.out}: cannot be given that name "
                f"({error.strerror or error}); what was made is whole in {self.building}: give it "
                f"another name, for example with mv {self.building} NAME"
            ) from error
        with suppress(OSError):  # it has its name: nothing is lost any more
            atomic_files.sync_path(self.out.parent)
            (self.out / LOCK).unlink()
        self._unlock()

    def release(self) -> None:
        """Part from the hidden folder and leave it as it is, for another to go on with."""
        if self.handle is not None:
            with suppress(OSError):  # what another put there stays
                self.out.rmdir()
            self._unlock()

    def withdraw(self) -> None:
        """Take the folder and its name away: only while nothing in it is worth keeping."""
        shutil.rmtree(self.building, ignore_errors=True)
        self.release()

    def filling(self) -> AbstractContextManager[Path]:
        """Write the first files of a new folder inside; it is withdrawn if that fails.

        Raises:
            RunError: the disk gave out.
        """
        return self._writing(self.withdraw)

    def keeping(self) -> AbstractContextManager[Path]:
        """Work inside on a folder that can be resumed; it is released if that fails.

        Raises:
            RunError: the disk gave out.
        """
        return self._writing(
            self.release,
            f"finished parts are in {self.building}: make room and go on with --resume",
        )

    @contextmanager
    def _writing(self, give_up: Callable[[], None], advice: str = "") -> Iterator[Path]:
        """Work inside; any exception gives the folder up, and that of a disk becomes a message."""
        try:
            with atomic_files.wrap_write_errors(f"{self.flag} {self.out}", advice):
                yield self.building
        except BaseException:
            give_up()
            raise

    def _unlock(self) -> None:
        if self.handle is not None:
            os.close(self.handle)
            self.handle = None


def partial_path(out: Path) -> Path:
    """Return the path where the folder ``out`` is built."""
    return out.parent / f"{PREFIX}{out.name}{SUFFIX}"


def default_advice(building: Path) -> str | None:
    """Return the advice on a hidden folder; None if it holds nothing but its lock."""
    return RESUMABLE if any(path.name != LOCK for path in building.iterdir()) else None


def acquire(
    out: Path, *, kind: str = "run", advise: Callable[[Path], str | None] = default_advice
) -> OutputLock:
    """Take a name and make the hidden folder.

    What a process that was killed left behind is taken away first where it is worth nothing.

    Args:
        out: the folder to be.
        kind: is made, in a word.
        advise: what can be done about the hidden folder that a dead process left, for a message;
            None if nothing in it is worth keeping.

    Raises:
        ConfigError: the name is taken, by something unfinished perhaps, or cannot be had.
    """
    building = partial_path(out)
    with _reporting_errors(f"--out {out}"):
        require_none(out, kind=kind, advise=advise)
        out.parent.mkdir(parents=True, exist_ok=True)
        if building.is_dir():
            _remove_leftover(out, building, kind)
        building.mkdir()
        try:
            out.mkdir()
            handle = _lock_file(building / LOCK, f"--out {out}", kind)
        except BaseException:
            shutil.rmtree(building, ignore_errors=True)
            raise
    return OutputLock(out=out, building=building.absolute(), flag="--out", handle=handle)


@contextmanager
def _reporting_errors(label: str) -> Iterator[None]:
    """Convert the exceptions of a name that cannot be had to one message."""
    try:
        yield
    except FileExistsError as error:
        raise ConfigError(
            f"{label}: exists since a moment ago; give another folder or remove it"
        ) from error
    except OSError as error:
        raise ConfigError(f"{label}: cannot be written ({error.strerror})") from error


def require_none(
    out: Path, *, kind: str = "run", advise: Callable[[Path], str | None] = default_advice
) -> None:
    """Refuse a name that is taken: by a link to nothing too, or by something unfinished of worth.

    One that cannot be had is refused too; nothing is made. Arguments as of `acquire`.

    Raises:
        ConfigError: it is.
    """
    require_name(out, flag="--out")
    require_writable(out, flag="--out")
    building = partial_path(out)
    if building.is_dir():
        locked = (building / LOCK).exists()
        os.close(_lock_file(building / LOCK, f"--out {out}", kind))
        # Without a lock another process may be about to make one.
        advice = advise(building)
        if advice is None and locked and _is_bare(out):
            return
        paths_text = f"{out} and {building}" if os.path.lexists(out) else str(building)
        raise ConfigError(
            f"--out {out}: an unfinished {kind} lies in {building}, and its process has ended; "
            f"{advice or BROKEN_OFF} {paths_text}"
        )
    if os.path.lexists(out):
        link = "" if out.exists() else " as a link to nothing"
        raise ConfigError(f"--out {out}: exists{link}; give another folder or remove it")


def _is_bare(out: Path) -> bool:
    """Return whether a name is free, or taken only by the empty folder of a claim."""
    if not os.path.lexists(out):
        return True
    return out.is_dir() and not out.is_symlink() and not any(out.iterdir())


def _remove_leftover(out: Path, building: Path, kind: str) -> None:
    """Take away what a dead process left, while nobody else can."""
    handle = _lock_file(building / LOCK, f"--out {out}", kind)
    try:
        with suppress(FileNotFoundError):
            out.rmdir()
        shutil.rmtree(building)
    finally:
        os.close(handle)


def acquire_unfinished(out: Path, *, kind: str = "run") -> OutputLock | None:
    """Take up the folder of a process that ended, or a folder that it had given its name.

    Returns:
        The claim; None if there is nothing of that name.

    Raises:
        ConfigError: its process still works on it, or it cannot be written.
    """
    require_name(out, flag="--resume")
    building, label = partial_path(out), f"--resume {out}"
    with _reporting_errors(label):
        if building.is_dir():
            handle = _lock_file(building / LOCK, label, kind)
        elif out.is_dir() and any(out.iterdir()):
            handle = _lock_file(out / LOCK, label, kind)
            out.rename(building)
        else:
            return None
        if not os.path.lexists(out):
            out.mkdir()
    return OutputLock(out=out, building=building.absolute(), flag="--resume", handle=handle)


def require_name(out: Path, *, flag: str) -> None:
    """Refuse a name that its file system cannot hold, with what it is hidden by around it.

    Raises:
        ConfigError: naming the longest that it can.
    """
    affix_length = len(PREFIX + SUFFIX)
    try:
        parent = out.absolute().parent
        while not parent.exists():
            parent = parent.parent
        max_length = os.pathconf(parent, "PC_NAME_MAX")
    except OSError as error:
        shown = str(out) if len(str(out)) <= 60 else f"{str(out)[:57]}..."
        raise ConfigError(
            f"{flag} {shown}: cannot be the name of a folder ({error.strerror}); give another one"
        ) from error
    length = len(os.fsencode(out.name))
    if length > max_length - affix_length:
        raise ConfigError(
            f"{flag} {out.name[:40]}...: the name has {length} bytes, {max_length - affix_length} "
            "are the most here; give a shorter one"
        )


def require_writable(out: Path, *, flag: str) -> None:
    """Refuse a name under which this process can make no folder, as far as can be seen beforehand.

    Raises:
        ConfigError: saying what of its path is no folder, or cannot be written.
    """
    parent = out.absolute().parent
    while not os.path.lexists(parent):
        parent = parent.parent
    if not parent.is_dir():
        raise ConfigError(
            f"{flag} {out}: cannot be written (a part of {out.parent} is no folder); "
            "give another folder"
        )
    if not os.access(parent, os.W_OK | os.X_OK):
        raise ConfigError(
            f"{flag} {out}: cannot be written (nothing can be made in {parent}); give another "
            "folder"
        )


def _lock_file(path: Path, label: str, kind: str) -> int:
    """Lock a file as long as this process lives.

    Raises:
        ConfigError: another one holds it.
        OSError: it cannot be written.
    """
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            is_free = os.path.samestat(os.fstat(handle), path.stat())
        except (BlockingIOError, FileNotFoundError):
            is_free = False
        except OSError:  # a file system without locks: by what the file says
            is_free = not _is_alive(_read_owner(handle))
        if not is_free:
            owner = _read_owner(handle)
            owner_text = "it has just begun"
            if {"pid", "host", "since"} <= owner.keys():
                owner_text = f"{owner['pid']} on {owner['host']}, since {owner['since']}"
            raise ConfigError(
                f"{label}: another process makes this {kind}: {owner_text}; "
                f"wait for it or end it (if it is gone for sure, remove {path})"
            )
        os.ftruncate(handle, 0)
        os.pwrite(handle, json.dumps(_process_identity()).encode(), 0)
    except BaseException:
        os.close(handle)
        raise
    return handle


def _process_identity() -> dict[str, object]:
    return {
        "pid": os.getpid(),
        "host": platform.node(),
        "since": time.strftime("%Y-%m-%d %H:%M:%S %z"),
        "started": _process_start(os.getpid()),
    }


def _read_owner(handle: int) -> dict[str, object]:
    try:
        owner = json.loads(os.pread(handle, 4096, 0))
    except (OSError, ValueError, RecursionError):
        return {}
    return owner if isinstance(owner, dict) else {}


def _is_alive(owner: dict[str, object]) -> bool:
    """Return whether the process named in a lock may be running; on another host it may."""
    if not owner:
        return False
    if owner.get("host") != platform.node():
        return True
    started = owner.get("started")
    return started is not None and started == _process_start(owner.get("pid"))


def _process_start(pid: object) -> str | None:
    """Return the start of a process of this host, ticks since boot; None if there is none."""
    if not isinstance(pid, int):
        return None
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[19]
    except (OSError, ValueError, IndexError):
        return None
