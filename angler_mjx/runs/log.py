"""Log of a run: its progress as lines with times in ``run.log`` of its folder."""

import time
from pathlib import Path
from typing import TextIO

from angler_mjx.progress import Progress

INTERVAL_S = 10.0
"""Between two lines of progress."""


class Log(Progress):
    """Progress that is also written to a file; without it where the disk is full."""

    def __init__(self, path: Path, progress: Progress) -> None:
        """Add to a file.

        Args:
            path: of the file; made if there is none.
            progress: receives everything too.
        """
        self._progress = progress
        self._file: TextIO | None = None
        self._total, self._done, self._unit, self._steps = 0, 0.0, "worlds", 0
        self._started_s = self._last = time.monotonic()
        try:
            self._file = path.open("a", encoding="utf-8", buffering=1)
        except OSError:
            self._file = None

    def start(self, total: int, done: int = 0, unit: str = "worlds") -> None:
        """See `Progress`."""
        self._total, self._done, self._unit = total, float(done), unit
        self.write(f"{total} {unit}" + (f", {done} of them finished before" if done else ""))
        self._started_s = self._last = time.monotonic()
        self._progress.start(total, done, unit)

    def describe(self, text: str) -> None:
        """See `Progress`."""
        self.write(text)
        if self._steps == 0:
            self._started_s = self._last = time.monotonic()
        self._progress.describe(text)

    def advance(self, amount: float, vehicle_steps: int = 0) -> None:
        """See `Progress`."""
        self._done += amount
        self._steps += vehicle_steps
        now = time.monotonic()
        if now - self._last >= INTERVAL_S:
            self._last = now
            speed = self._steps / (now - self._started_s)
            done = f"{self._done:.1f} of {self._total} {self._unit}"
            self.write(f"{done}, {speed:.2e} vehicle-steps/s")
        self._progress.advance(amount, vehicle_steps)

    def report(self, text: str) -> None:
        """See `Progress`."""
        self.write(text)
        self._progress.report(text)

    def write(self, text: str) -> None:
        """Add a line."""
        if self._file is None:
            return
        line = " ".join(text.split())
        try:
            self._file.write(f"{time.strftime('%Y-%m-%d %H:%M:%S%z')} {line}\n")
        except OSError:
            self.close()

    def close(self) -> None:
        """Write no more."""
        file, self._file = self._file, None
        if file is not None:
            try:
                file.close()
            except OSError:
                return
