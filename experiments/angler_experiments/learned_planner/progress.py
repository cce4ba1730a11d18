"""Progress for people, each line with the time since the beginning."""

import time


class ProgressClock:
    """Printer of lines with seconds since its creation."""

    def __init__(self) -> None:
        """Start the clock."""
        self._start_s = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Return the seconds since the beginning."""
        return time.perf_counter() - self._start_s

    def __call__(self, text: str) -> None:
        """Print a line at once."""
        print(f"[{self.seconds:6.1f} s] {text}", flush=True)
