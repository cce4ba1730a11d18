"""Progress for people, each line with the time since the beginning."""

import time


class ProgressClock:
    """Tells lines, with seconds since it was made."""

    def __init__(self) -> None:
        """Begin to count."""
        self._start_s = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Since the beginning."""
        return time.perf_counter() - self._start_s

    def __call__(self, text: str) -> None:
        """Print a line at once."""
        print(f"[{self.seconds:6.1f} s] {text}", flush=True)
