"""What a run tells, as lines with times in ``run.log`` of its folder, whoever watches."""

import time
from pathlib import Path
from typing import TextIO

from angler_mjx.runs.progress import Progress
from angler_mjx.runs.simulator.compilation import CompileTime

INTERVAL_S = 10.0
"""Between two lines of progress."""


class Log:
    """A progress that also writes; where the disk gives out it goes on without."""

    def __init__(self, path: Path, progress: Progress) -> None:
        """Add to a file.

        Args:
            path: of the file; made if there is none.
            progress: that is told everything too.
        """
        self._progress = progress
        self._file: TextIO | None = None
        self._worlds, self._done, self._steps = 0, 0.0, 0
        self._started_s = self._last = time.monotonic()
        try:
            self._file = path.open("a", encoding="utf-8", buffering=1)
        except OSError:
            self._file = None

    def start(self, worlds: int, done: int) -> None:
        """See `SampleProgress`."""
        self._worlds, self._done = worlds, float(done)
        self.write(f"{worlds} worlds" + (f", {done} of them finished before" if done else ""))
        self._progress.start(worlds, done)

    def compiling(self) -> None:
        """See `SampleProgress`."""
        self.write("compiling")
        self._progress.compiling()

    def compiled(self, compile_time: CompileTime) -> None:
        """See `SampleProgress`."""
        self.write(f"compiled in {compile_time.total_s:.1f} s")
        self._started_s = self._last = time.monotonic()
        self._progress.compiled(compile_time)

    def advance(self, worlds: float, vehicle_steps: int) -> None:
        """See `SampleProgress`."""
        self._done += worlds
        self._steps += vehicle_steps
        now = time.monotonic()
        if now - self._last >= INTERVAL_S:
            self._last = now
            speed = self._steps / (now - self._started_s)
            self.write(f"{self._done:.1f} of {self._worlds} worlds, {speed:.2e} vehicle-steps/s")
        self._progress.advance(worlds, vehicle_steps)

    def tell(self, text: str) -> None:
        """See `SampleProgress`."""
        self.write(text)
        self._progress.tell(text)

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
