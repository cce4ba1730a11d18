"""Real-time pace: one scene step per control period of the wall clock, and its overruns."""

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Overruns:
    """Count of the steps that were not done when their period was over."""

    count: int = 0
    worst_s: float = 0.0
    """Max delay of a step."""

    def __str__(self) -> str:
        """Return the count as text for a screen."""
        if self.count == 0:
            return "no overruns"
        return f"{self.count} overrun{'s' * (self.count > 1)}, worst {1e3 * self.worst_s:.0f} ms"


class RealTimePacer:
    """Pacer of a loop at real time.

    A late step moves all later ones: the scene falls behind the wall clock, and never hurries to
    catch up.
    """

    def __init__(
        self,
        dt_s: float,
        clock: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Start the first period.

        Args:
            dt_s: control period.
            clock: of the wall, s.
            sleep: waits for seconds.
        """
        self._dt, self._clock, self._sleep = dt_s, clock, sleep
        self._due = clock() + dt_s
        self.overruns = Overruns()

    def wait(self) -> None:
        """Wait for the end of the period, or count an overrun if it is past."""
        late = self._clock() - self._due
        if late > 0.0:
            before = self.overruns
            self.overruns = Overruns(count=before.count + 1, worst_s=max(before.worst_s, late))
            self._due += late
        else:
            self._sleep(-late)
        self._due += self._dt
