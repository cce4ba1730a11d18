"""The loop of one scene: when it ends, and what is kept of a flight that something breaks off."""

from types import SimpleNamespace

import pytest

from angler_mjx.errors import RunError
from angler_mjx.runs.session.session_flight import build_course, fly_session
from angler_mjx.sim.state import Outcome


class Scene:
    """One robot that arrives in the 7th step; the scene fails in the step that is named."""

    dt_s = 0.5

    def __init__(self, fails_in=None):
        self.steps, self.fails_in = 0, fails_in

    def observe(self):
        outcome = Outcome.REACHED if self.steps >= 7 else Outcome.RUNNING
        return SimpleNamespace(
            time_s=self.steps * self.dt_s, status=(SimpleNamespace(outcome=outcome),)
        )

    def step(self, commands):
        assert commands == {0: self.steps}
        if self.steps + 1 == self.fails_in:
            raise RunError("robot_0: its autopilot ended")
        self.steps += 1
        return self.observe()


def flown(scene, horizon_s=60.0, **changes):
    flyer = SimpleNamespace(commands=lambda seen: {0: round(seen.time_s / scene.dt_s)})
    return fly_session(scene, horizon_s, flyer=flyer, **changes)


def test_a_flight_ends_with_the_last_robot_or_with_the_horizon():
    whole = flown(Scene())
    assert (whole.steps, whole.last.time_s, whole.broken) == (7, 3.5, "")
    short = flown(Scene(), horizon_s=2.0)
    assert (short.steps, short.last.time_s, short.broken) == (4, 2.0, "")


@pytest.mark.parametrize("fails_in", [1, 5])
def test_what_was_flown_before_a_failure_is_kept(fails_in):
    seen = []
    broken = flown(Scene(fails_in=fails_in), watch=seen.append)
    assert broken.steps == len(seen) == fails_in - 1
    assert broken.last.time_s == 0.5 * (fails_in - 1)
    assert build_course(broken, 0.0).interrupted == "robot_0: its autopilot ended"


def test_a_signal_ends_a_flight_between_two_steps():
    seen = []
    ended = flown(Scene(), watch=seen.append, stopped=lambda: len(seen) == 3)
    assert (ended.steps, ended.last.time_s) == (3, 1.5)
    assert "signal" in build_course(ended, 0.0).interrupted
