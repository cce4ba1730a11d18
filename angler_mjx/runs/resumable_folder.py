"""Frame in which a results folder is made part by part: locked or resumed, filled, published.

Sweeps, datasets, benchmarks, fleet-size studies and tunings are made in it. A preset declares a
`ResumableFolder` and fills the folder inside `open_folder`; of several processes, process 0 alone
writes the files that are not of a part.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from angler_mjx.runs.processes import Processes, reporting_failure
from angler_mjx.runs.storage import output_lock, results_folder
from angler_mjx.runs.storage.output_lock import OutputLock


@dataclass(frozen=True, kw_only=True)
class ResumableFolder[T]:
    """Declaration of a kind of folders: how one begins, and how it is resumed."""

    kind: str
    """Noun of the kind, for messages."""
    request_file: str
    """Name of the file that says what was asked for; a folder without it has not begun."""
    begin: Callable[[Path], T]
    """Writes the first files of a new folder; returns what the work depends on, in plain values if
    several processes fill the folder."""
    resume: Callable[[Path], T]
    """Returns the same of an interrupted folder; raises ConfigError if it is of another request."""
    is_complete: Callable[[Path], bool]
    """Whether nothing is left to do in a published folder."""
    advise: Callable[[Path], str | None] = output_lock.default_advice
    """Advice on the unfinished folder of a dead process; see `output_lock.acquire`."""

    def acquire(self, out: Path, *, resume: bool) -> tuple[OutputLock, T]:
        """Lock a new folder, or an interrupted one.

        Raises:
            ConfigError: the name is taken; or there is nothing to resume, or another request.
            RunError: the disk gave out.
        """
        if resume:
            return results_folder.resume_folder(
                out,
                kind=self.kind,
                file=self.request_file,
                is_complete=self.is_complete(out),
                check=self.resume,
            )
        lock = output_lock.acquire(out, kind=self.kind, advise=self.advise)
        with lock.filling() as building:
            start = self.begin(building)
        return lock, start


@dataclass(frozen=True, kw_only=True)
class OpenFolder[T]:
    """Locked folder that is being filled."""

    building: Path
    """Path of the hidden folder."""
    start: T
    """Result of `ResumableFolder.begin` or ``resume``, in every process."""
    lock: OutputLock | None
    """Lock of process 0; None in the others."""

    def publish(self, write: Callable[[Path], None]) -> None:
        """Write the last files into the folder, then give it its name; process 0 alone does.

        Args:
            write: receives the folder.

        Raises:
            RunError: the disk gave out; finished parts are kept.
        """
        if self.lock is None:
            return
        with self.lock.keeping() as building:
            write(building)
        self.lock.publish()


@contextmanager
def open_folder[T](
    folder: ResumableFolder[T], out: Path, *, resume: bool, processes: Processes
) -> Iterator[OpenFolder[T]]:
    """Hold a folder while it is filled; unless it is published inside, it can be resumed.

    Args:
        folder: its declaration.
        out: the folder to be.
        resume: resume an interrupted folder.
        processes: processes that fill it together; each calls this with the same arguments.

    Raises:
        ConfigError, RunError: as `ResumableFolder.acquire`; or another process failed.
    """
    with reporting_failure(processes), ExitStack() as stack:
        lock = start = None
        if processes.index == 0:
            lock, start = folder.acquire(out, resume=resume)
            stack.callback(lock.release)
        start = processes.meet(folder.kind, start)[0]
        yield OpenFolder(building=output_lock.partial_path(out), start=start, lock=lock)
        processes.meet("closed")
