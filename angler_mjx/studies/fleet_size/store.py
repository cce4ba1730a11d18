"""What was flown: a line of JSON for each batch, on the disk before the next one begins.

A line that was not written whole (its process was killed) is taken away when the file is opened
again, and its batch is flown again.
"""

import json
import os
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from angler_mjx.errors import RunError
from angler_mjx.runs.storage.read_errors import wrap_read_errors

FILE = "batches.jsonl"
RENAMED = {"path_m": "path_length_m"}
"""Keys of lines that older versions wrote, and their names now."""
ADVICE = "put back a copy of it, or begin a new study"


@dataclass(frozen=True, kw_only=True)
class Batch:
    """Neighbouring worlds of one condition and size."""

    condition: str
    size: int
    first: int
    """Index of the first world."""
    completed_s: list[float | None]
    """When the task of each was done; None if it was not."""
    arrived: list[int]
    """Robots of each that reached their goal, or did their part."""
    lost: list[int]
    """Robots of each that ended otherwise, before the time was over."""
    energy_j: list[float]
    """Electrical energy of all thrusters of each."""
    path_length_m: list[float]
    """Flown length, sum of all robots of each."""
    no_room: list[bool]
    """Whether a world had no room for the team, or for the task; it counts as not done."""
    planned: list[int | None] = field(default_factory=list)
    """Robots of each with a plan, None where they have a task; empty in older studies."""

    @property
    def worlds(self) -> int:
        """How many they are."""
        return len(self.completed_s)

    def hits(self, deadline_s: float) -> int:
        """Worlds that met a deadline."""
        return sum(t is not None and t <= deadline_s for t in self.completed_s)


class StudyStore:
    """The batches of a study."""

    def __init__(self, path: Path, *, writes: bool = True) -> None:
        """Open the file, made if it is not there.

        Args:
            path: of the file.
            writes: whether batches are kept in it; of several processes, one does.

        Raises:
            ConfigError: it is damaged.
            RunError: it cannot be written.
        """
        self._path = path
        self.batches: list[Batch] = []
        self._file: BinaryIO | None = None
        if not writes:
            if path.is_file():
                with wrap_read_errors(path, ADVICE):
                    self._take(path.read_bytes())
            return
        try:
            self._file = path.open("a+b")
        except OSError as error:
            raise RunError(f"{path}: cannot be written ({error.strerror})") from error
        self._file.seek(0)
        with wrap_read_errors(path, ADVICE):
            torn = self._take(self._file.read())
        if torn:
            self._file.truncate(self._file.tell() - torn)

    def _take(self, data: bytes) -> int:
        """The batches of a file; how many bytes at its end are no whole line."""
        whole, _, torn = data.rpartition(b"\n")
        self.batches = [_parse_batch(json.loads(line)) for line in whole.splitlines()]
        return len(torn)

    def add(self, batch: Batch) -> None:
        """Keep a batch.

        Raises:
            RunError: the disk gave out; what was kept before is still there.
        """
        if self._file is not None:
            self._write(self._file, batch)
        self.batches.append(batch)

    def _write(self, file: BinaryIO, batch: Batch) -> None:
        line = json.dumps(asdict(batch), separators=(",", ":")).encode() + b"\n"
        try:
            file.write(line)
            file.flush()
            os.fsync(file.fileno())
        except OSError as error:
            raise RunError(
                f"{self._path}: cannot be written ({error.strerror or error}); all batches before "
                "are in it: make room and go on with --resume"
            ) from error

    def close(self) -> None:
        """Part from the file."""
        if self._file is not None:
            self._file.close()


def _parse_batch(table: dict[str, Any]) -> Batch:
    """A batch from a line; TypeError or ValueError for anything else."""
    table = {RENAMED.get(key, key): value for key, value in table.items()}
    batch = Batch(**table)
    lists = (batch.arrived, batch.lost, batch.energy_j, batch.path_length_m, batch.no_room)
    if any(len(values) != batch.worlds for values in lists) or len(batch.planned) not in (
        0,
        batch.worlds,
    ):
        raise ValueError("a batch is none")
    return batch
