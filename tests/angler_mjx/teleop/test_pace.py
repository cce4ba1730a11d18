"""Real time by a clock that the test turns."""

import pytest

from angler_mjx.teleop.pace import RealTimePacer


class Clock:
    """A wall clock that sleeping turns."""

    def __init__(self):
        self.now = 100.0
        self.slept = []

    def __call__(self):
        return self.now

    def sleep(self, seconds):
        self.slept.append(seconds)
        self.now += seconds


def test_a_quick_loop_waits_for_each_period():
    clock = Clock()
    pace = RealTimePacer(0.05, clock, clock.sleep)
    for _ in range(4):
        clock.now += 0.01
        pace.wait()
    assert clock.slept == pytest.approx([0.04] * 4)
    assert clock.now == pytest.approx(100.2)
    assert pace.overruns.count == 0
    assert str(pace.overruns) == "no overruns"


def test_late_steps_are_counted_and_not_caught_up():
    clock = Clock()
    pace = RealTimePacer(0.05, clock, clock.sleep)
    for work in (0.01, 0.17, 0.01, 0.06, 0.05 - 1e-6):
        clock.now += work
        pace.wait()
    # 0.17 s is 0.12 s late, 0.06 s is 0.01 s late; the step after a late one has its whole period.
    assert pace.overruns.count == 2
    assert pace.overruns.worst_s == pytest.approx(0.12)
    assert clock.slept == pytest.approx([0.04, 0.04, 1e-6])
    assert str(pace.overruns) == "2 overruns, worst 120 ms"
