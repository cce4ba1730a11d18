"""Progress of long work: how much is done of how much, and lines for a person."""

import sys
import time

from angler_mjx._moved import renamed as _renamed

INTERVAL_S = 1.0
"""Time between two lines of amounts."""


class Progress:
    """Receiver of progress that ignores everything; subclasses override what they show."""

    def start(self, total: int, done: int = 0, unit: str = "worlds") -> None:
        """Begin work.

        Args:
            total: amount of all work, including what was finished before.
            done: amount finished before.
            unit: noun of the amount, in the plural.
        """

    def describe(self, text: str) -> None:
        """Replace the description of the step that is being done."""

    def advance(self, amount: float, vehicle_steps: int = 0) -> None:
        """Add finished work.

        Args:
            amount: in the unit of `start`; parts of one count.
            vehicle_steps: simulated for it.
        """

    def report(self, text: str) -> None:
        """Show a line that stays, such as a repair, a warning or an intermediate result."""


class ProgressLines(Progress):
    """Lines on stderr, each behind the seconds since the beginning; no thread redraws them.

    Amounts are shown at most once in `INTERVAL_S`.
    """

    def __init__(self) -> None:
        """Start the clock."""
        self._begin_s = self._last_s = time.perf_counter()
        self._total, self._done, self._unit = 0, 0.0, ""

    def start(self, total: int, done: int = 0, unit: str = "worlds") -> None:
        """See `Progress`."""
        self._total, self._done, self._unit = total, float(done), unit

    def describe(self, text: str) -> None:
        """See `Progress`."""
        self.report(text)

    def advance(self, amount: float, vehicle_steps: int = 0) -> None:
        """See `Progress`."""
        self._done += amount
        if time.perf_counter() - self._last_s >= INTERVAL_S:
            done = f"{self._done:.1f}".removesuffix(".0")
            self.report(f"{done} of {self._total} {self._unit}")

    def report(self, text: str) -> None:
        """See `Progress`."""
        self._last_s = time.perf_counter()
        print(f"[{self._last_s - self._begin_s:6.1f} s] {text}", file=sys.stderr, flush=True)


def __getattr__(name: str) -> object:
    """Return a class by its name of 0.1."""
    return _renamed(__name__, name)
