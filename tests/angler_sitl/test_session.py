"""Sessions over real autopilots: conformance, holding in a current, losses, recordings.

One scene is compiled for each level that is flown. All of it needs a real ArduSub.
"""

import os
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.robot.control.commands import BodyTwist, PoseTarget
from angler_mjx.teleop.driving import TeleopRecording
from angler_mjx.teleop.loop import DriveResult
from angler_mjx.testing import Bounds, check_session
from angler_mjx.testing.driving import make_twist, run_steps
from angler_sitl.scene.scenario_options import select_scenario
from angler_sitl.session import SitlSession

pytestmark = pytest.mark.sitl

CALM = """
schema_version = 1
name = "calm"
seed = 3

[time]
horizon_s = 60.0
record_hz = 5.0

[world]
preset = "open"
placement = "random"

[[fleet]]
vehicle = "bluerov2_heavy"
parameter_set = "wu2018"

[[fleet]]
vehicle = "bluerov2_heavy"
"""

STREAM = """
schema_version = 1
name = "stream"
seed = 5

[time]
horizon_s = 60.0

[world]
preset = "open"
placement = "parallel"

[[world.currents]]
type = "uniform"
velocity_mps = [0.4, -0.3, 0.0]

[[fleet]]
vehicle = "bluerov2"
estimate = "noisy"
"""

GUIDED = Bounds(
    # The firmware's threads read their sockets when they do: a control loop sooner or later.
    repeat_m=0.02,
    # With the firmware's own gains the heading hunts across the dead band of the thrusters, which
    # it does not know of: at 0.2 rad/s it stops and starts every 2 s, and a second's mean is off.
    velocity_mps=0.12,
)
THRUSTERS = Bounds(repeat_m=0.02)  # as above; else no worse than in the simulator


class Borrowed:
    """A session that is shared: closing it closes only this view of it."""

    def __init__(self, session):
        self._session, self._closed = session, False

    def __getattr__(self, name):
        return getattr(self._session, name)

    def step(self, commands=None):
        if self._closed:
            raise RunError("closed")
        return self._session.step(commands)

    def close(self):
        self._closed = True


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    """A function: a scenario of this text."""

    def write(text):
        path = tmp_path_factory.mktemp("scene") / "scene.toml"
        path.write_text(text)
        return select_scenario(path, None)

    return write


@pytest.fixture(scope="module")
def guided(ardusub, scenario, tmp_path_factory):
    logs = tmp_path_factory.mktemp("logs")
    with SitlSession(scenario(CALM), binary=ardusub.path, folder=logs) as session:
        yield session


@pytest.fixture(scope="module")
def pids(guided):
    """A function: process numbers of its autopilots."""
    return lambda: [one.pid for one in guided.autopilots.instances]


def test_guided_conforms(guided):
    results = check_session(lambda: Borrowed(guided), bounds=GUIDED)
    skipped = {result.name for result in results if result.skipped}
    # Neither wrenches nor signals are taken at this level.
    assert skipped == {"wrenches_push", "neutral_signals_let_it_drift"}


def test_thrusters_conform(ardusub, scenario):
    def make():
        return SitlSession(scenario(CALM), level="thrusters", binary=ardusub.path)

    results = check_session(make, bounds=THRUSTERS)
    assert [result for result in results if result.skipped] == []


def test_what_the_autopilots_say_is_shown_and_logged(guided):
    guided.reset()
    seen = run_steps(guided, 2.0)[-1]
    for status in seen.status:
        assert "GUIDED, armed, EKF good" in status.note
    # External navigation is the truth here; the filter runs up to a step of 10 ms beside it.
    away = np.linalg.norm(np.asarray(seen.estimate.p) - np.asarray(seen.truth.p), axis=1)
    speed = np.linalg.norm(np.asarray(seen.truth.nu)[:, :3], axis=1)
    assert np.all(away < 0.005 + 0.015 * speed)
    assert guided.autopilots.differences == {"robot_0": [], "robot_1": []}
    logs = guided.settings.folder
    for name in ("robot_0", "robot_1"):
        assert (logs / name / "mavlink.tlog").stat().st_size > 10_000
        assert list((logs / name).glob("logs/*.BIN"))


def test_a_session_is_recorded_as_a_run(guided, scenario, tmp_path):
    guided.reset()
    with TeleopRecording(tmp_path / "run", scenario(CALM), world=0) as recording:
        recording.begin(guided)
        for _ in range(40):
            recording.after(guided.step())
        driven = DriveResult(
            steps=40, scene_s=2.0, wall_s=1.0, overruns=None, keys=(), last=guided.observe()
        )
        stored = recording.finish(driven, compile_s=0.0)
    samples = stored.trajectories
    truth, known = np.asarray(samples["p_m"])[0], np.asarray(samples["estimate/p_m"])[0]
    assert truth.shape == (10, 2, 3)  # 2 s at 5 Hz
    np.testing.assert_allclose(known, truth, atol=0.02)


def test_an_autopilot_that_is_killed_is_named_and_all_go_down(guided, pids):
    guided.reset()
    run_steps(guided, 0.5)
    first, second = pids()
    os.kill(second, signal.SIGKILL)
    with pytest.raises(RunError, match=r"robot_1: .*SIGKILL"):
        run_steps(guided, 5.0)
    for pid in (first, second):
        assert not Path(f"/proc/{pid}").exists()
    with pytest.raises(RunError, match="down"):
        guided.step()
    assert guided.reset().time_s == 0.0  # and comes up again


def test_the_others_go_on_without_it_where_that_is_asked_for(guided, pids):
    guided.settings = replace(guided.settings, on_crash="hold")
    try:
        guided.reset()
        run_steps(guided, 0.5, {1: make_twist(0.2, 0, 0, 0, 0, 0)})
        os.kill(pids()[0], signal.SIGKILL)
        seen = run_steps(guided, 4.0)[-1]
        assert seen.status[0].note.startswith("lost: robot_0: ")
        assert np.all(np.asarray(seen.pwm.pwm_us)[0] == 1500.0)
        assert np.asarray(seen.truth.nu)[1, 0] > 0.1
        refused = guided.step({0: make_twist(0, 0, 0, 0, 0, 0)}).status[0].refused
        assert "robot_0: cannot go on" in refused
    finally:
        guided.settings = replace(guided.settings, on_crash="end")


def test_poshold_holds_in_a_stream_and_takes_sticks_for_velocities(ardusub, scenario):
    with SitlSession(scenario(STREAM), level="poshold", binary=ardusub.path) as session:
        (robot,) = session.robots
        assert robot.accepts == (BodyTwist,)
        with pytest.raises(ConfigError, match=r"poshold.*by hand"):
            session.resume_plan(0)
        assert session.observe().status[0].command == PoseTarget.__name__
        held = run_steps(session, 20.0)
        late = [np.asarray(now.truth.p)[0] for now in held[-100:]]
        # It is carried off until its integral has built up, and comes back over half a minute.
        assert np.ptp(late, axis=0).max() < 0.3
        for axis, speed in ((0, 0.3), (2, -0.2)):
            told = np.zeros(6)
            told[axis] = speed
            seen = run_steps(session, 5.0, {0: make_twist(*told)})[-40:]
            # The firmware's loops overshoot by a tenth; without the dead zone it would be a third.
            moved = np.mean([np.asarray(now.truth.nu)[0, axis] for now in seen])
            assert moved == pytest.approx(speed, abs=0.06)
        # Its fixes are noisy, as the scenario's instruments are: the estimate is off the truth.
        off = [np.asarray(now.estimate.p - now.truth.p)[0] for now in held[200:]]
        assert 0.002 < np.std(off) < 0.1


def test_what_cannot_be_run_is_refused(ardusub, scenario, tmp_path):
    text = CALM.replace("bluerov2_heavy", "nothing_like_it")
    with pytest.raises(ConfigError, match="nothing_like_it"):
        scenario(text)
    calm = scenario(CALM)
    for wrong, said in (
        ({"world": -1}, "world = -1"),
        ({"robots": 0}, "robots = 0"),
        ({"speed": 0.0}, "speed = 0.0"),
        ({"level": "autopilot"}, "autopilot"),
        ({"binary": tmp_path / "none"}, "none"),
    ):
        with pytest.raises(ConfigError, match=said):
            SitlSession(calm, **{"binary": ardusub.path, **wrong})
