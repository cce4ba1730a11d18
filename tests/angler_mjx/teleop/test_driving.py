"""Driving a simulated scene: hand-over while the others go on, recordings, and the command."""

import inspect
import os

import numpy as np
import pytest

from angler_mjx.cli.main import main
from angler_mjx.cli.teleop import teleop
from angler_mjx.errors import ConfigError, RunError, UnsupportedError
from angler_mjx.report.interop import mcap
from angler_mjx.report.plotting import scene
from angler_mjx.runs.storage.folder import Run, reopen_folder
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.sim.state import Outcome
from angler_mjx.teleop import live_view, opening
from angler_mjx.teleop.driving import KEYS_FILE, TeleopRecording, TeleopSettings, run_teleop
from angler_mjx.teleop.loop import drive_session
from angler_mjx.teleop.pilot import KEY_TIMEOUT_S, DriveMode, TeleopPilot
from angler_mjx.teleop.script import KeyScript, TimedKey, load_keys
from angler_mjx.teleop.signals import StopRequest

from .terminals import assert_given_back

SCENARIO = """
schema_version = 1
name = "three"
worlds = 2
seed = 5

[time]
horizon_s = 60.0
record_hz = 5.0

[world]
preset = "open"
placement = "parallel"

[world.obstacles.dynamic]
count = 2

[[fleet]]
vehicle = "bluerov2_heavy"
count = 3
"""

KEYS_TEXT = """
2-5 J        # to the side, for three seconds
7 <tab>
7.5 h        # robot 2 holds
9 <tab>
9.5 p        # robot 0 goes back to its plan
20 k
"""

WORLD = 1


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("teleop")
    (path / "three.toml").write_text(SCENARIO)
    (path / "keys.txt").write_text(KEYS_TEXT)
    return path


@pytest.fixture(scope="module")
def scenario(folder):
    return load_scenario(folder / "three.toml")


@pytest.fixture(scope="module")
def session(scenario):
    """One simulated scene for all tests here; each resets it."""
    opened = opening.open_simulated(scenario, WORLD).session
    yield opened
    opened.close()


class Track:
    """Keeps every observation, and what drove each robot then."""

    def __init__(self, pilot):
        self.pilot = pilot
        self.seen = []
        self.modes = []

    def after(self, observation):
        self.seen.append(observation)
        self.modes.append([self.pilot.mode(i) for i in range(3)])

    def at(self, time_s):
        return next(k for k, one in enumerate(self.seen) if one.time_s > time_s - 1e-6)

    def column(self, name):
        return np.stack([np.asarray(getattr(one.truth, name)) for one in self.seen])


def fly(session, timed, duration_s=None, watchers=()):
    session.reset()
    pilot = TeleopPilot(session.robots, (0, 2), speed_mps=0.4, turn_radps=0.4)
    track = Track(pilot)
    done = drive_session(
        session,
        pilot,
        KeyScript(timed),
        title="three",
        stop=StopRequest(),
        realtime=False,
        duration_s=duration_s,
        watchers=[track, *watchers],
    )
    return done, track


@pytest.fixture(scope="module")
def recorded(session, scenario, folder):
    """The scene driven by the file of keys, and its run folder."""
    with TeleopRecording(folder / "run", scenario, WORLD) as recording:
        session.reset()
        recording.begin(session)
        done, track = fly(session, load_keys(folder / "keys.txt"), watchers=[recording])
        made = recording.finish(done, 1.0)
    return made, done, track


@pytest.fixture(scope="module")
def alone(session):
    """The same scene with nobody at the keys."""
    return fly(session, [], duration_s=20.0)[1]


def test_robots_that_nobody_drives_go_on_as_if_nobody_drove(recorded, alone):
    driven = recorded[2]
    assert len(driven.seen) == len(alone.seen) == 400
    # The robots are too far apart to matter to each other, so the same numbers come out.
    np.testing.assert_array_equal(driven.column("p")[:, 1], alone.column("p")[:, 1])
    before = driven.at(7.5)
    np.testing.assert_array_equal(driven.column("p")[:before, 2], alone.column("p")[:before, 2])
    assert np.abs(driven.column("p")[-1, 0] - alone.column("p")[-1, 0]).max() > 0.3


def test_plan_teleop_hold_plan(recorded):
    track = recorded[2]
    mode = [track.modes[track.at(time)][0] for time in (1.9, 4.0, 6.0, 9.0, 10.0)]
    assert [mode[0], mode[1], mode[3], mode[4]] == [
        DriveMode.PLAN,
        DriveMode.TELEOP,
        DriveMode.HOLD,
        DriveMode.PLAN,
    ]
    assert mode[2] in (DriveMode.STOPPING, DriveMode.HOLD)
    assert track.seen[track.at(4.0)].status[0].command == "BodyTwist"
    assert track.seen[track.at(9.0)].status[0].command == "PoseTarget"
    assert track.seen[track.at(10.0)].status[0].command == "plan"
    assert not any(status.refused for one in track.seen for status in one.status)


def test_the_robot_does_what_the_key_says(recorded):
    track = recorded[2]
    # 2 s after the key, 5 % of 0.4 m/s: the velocity loop settles within a second.
    nu = track.column("nu")[track.at(4.5), 0]
    np.testing.assert_allclose(nu[:3], [0.0, 0.4, 0.0], atol=0.02)
    # Silent since 5 s: told to stop at 5.8 s, at rest and held by 9 s. 2 cm is what a hold may
    # wander while it settles.
    p = track.column("p")[:, 0]
    assert np.linalg.norm(p[track.at(9.4)] - p[track.at(8.4)]) < 0.02
    # In those 3 s to the side, 0.8 s of silence and the braking it made 0.4 m/s times 3.8 s, less
    # the start and plus the braking.
    assert 1.0 < np.linalg.norm(p[track.at(7.0)] - p[track.at(2.0)]) < 2.2


def test_going_back_to_the_plan_is_smooth_and_gets_there(recorded, session, alone):
    track = recorded[2]
    p = track.column("p")[:, 0]
    after = p[track.at(9.0) :]
    # What is aimed at goes on from where the robot was held: it moves by a step of the cruise speed
    # and by what the hold was off, 2 cm, never by the way that it was driven away.
    aims = np.stack([one.target_m for one in track.seen[track.at(9.0) :]])[:, 0]
    cruise = session.robots[0].cruise_speed_mps
    assert np.linalg.norm(np.diff(aims, axis=0), axis=1).max() < cruise * session.dt_s + 0.02
    # Overshoot of the velocity loop apart, it is not faster than its plan.
    assert np.linalg.norm(np.diff(after, axis=0), axis=1).max() < 1.5 * cruise * session.dt_s
    # On its way again: it comes nearer to the goal, and ends nearer to the line of its plan than
    # it was held.
    goal = np.asarray(session.inside().worlds.environment.goal_m)[0, 0]
    assert np.linalg.norm(after[-1] - goal) < np.linalg.norm(after[0] - goal) - 2.0
    line = alone.column("p")[:, 0]
    away = [np.linalg.norm(line - point, axis=1).min() for point in (after[0], after[-1])]
    assert away[1] < 0.5 * away[0]


def test_the_run_folder_reads_like_any_other(recorded, session, tmp_path):
    made, done, track = recorded
    again = Run(made.path)
    assert again.episodes.column("world").to_pylist() == [WORLD] * 3
    assert again.summary["complete"]
    assert again.summary["teleop"]["steps"] == done.steps == 400
    assert not again.summary["teleop"]["realtime"]
    assert again.scenario.worlds == WORLD + 1
    assert not list(made.path.parent.glob(".*"))
    held = scene.read_scene(again, WORLD)
    # 5 Hz of 20 s; sample k is the state at k / 5 s, the first at the reset.
    assert held.time_s.size == 100
    every = round(0.2 / session.dt_s)
    wanted = track.column("p")[every - 1 :: every]
    read = np.stack([robot.p_m for robot in held.robots], axis=1)
    np.testing.assert_array_equal(read[1:], wanted[: len(read) - 1].astype(np.float32))
    outcomes = again.episodes.column("outcome").to_pylist()
    ended = [status.outcome for status in done.last.status]
    assert outcomes == ["timeout" if one is Outcome.RUNNING else one.name.lower() for one in ended]
    mcap.export_bag(again, tmp_path / "out.mcap", [WORLD])
    assert (tmp_path / "out.mcap").stat().st_size > 10_000


def test_the_keys_of_a_run_drive_it_again(recorded, session):
    made, done, track = recorded
    timed = load_keys(made.path / KEYS_FILE)
    assert tuple(timed) == done.keys
    again = fly(session, timed)[1]
    np.testing.assert_array_equal(again.column("p"), track.column("p"))


def test_what_is_broken_off_leaves_nothing(session, scenario, tmp_path):
    class Breaks:
        def after(self, observation):
            if observation.time_s > 0.5:
                raise KeyboardInterrupt

    def broken():
        with TeleopRecording(tmp_path / "run", scenario, WORLD) as recording:
            assert sorted(os.listdir(tmp_path)) == [".run.partial", "run"]
            recording.begin(session)
            fly(session, [], duration_s=5.0, watchers=[recording, Breaks()])

    with pytest.raises(KeyboardInterrupt):
        broken()
    assert os.listdir(tmp_path) == []
    with TeleopRecording(tmp_path / "run", scenario, WORLD) as recording:
        recording.begin(session)
        assert recording.finish(fly(session, [TimedKey(0.0, "Q")])[0], 0.0) is None
    assert os.listdir(tmp_path) == []


def test_a_refusal_shows_and_others_go_on(session):
    # Robot 0 is told to go back to a plan that it never left: nothing happens to anybody.
    done, track = fly(session, [TimedKey(0.5, "p")], duration_s=1.0)
    assert done.steps == len(track.seen) == 20
    assert [status.command for status in done.last.status] == ["plan"] * 3


SETTINGS_FAULTS = {
    "speed": ({"speed_mps": 0.0}, "--speed 0"),
    "silence": ({"silence_s": -1.0}, "--silence -1"),
    "duration": ({"duration_s": float("nan")}, "--duration nan"),
    "robot": ({"robots": "0,7"}, "there is no robot 7; the scenario has 0 to 2"),
    "robots": ({"robots": "zero"}, "--robots zero"),
    "script": ({"script": "absent.txt"}, "cannot be read"),
}


@pytest.mark.parametrize("fault", SETTINGS_FAULTS)
def test_settings_that_cannot_be_used(scenario, folder, fault):
    given, message = SETTINGS_FAULTS[fault]
    script = folder / given.pop("script", "keys.txt")
    with pytest.raises(ConfigError, match=message):
        run_teleop(scenario, TeleopSettings(script=script, **given))


class Breaking:
    """A session whose driver is lost on the way."""

    def __init__(self, session):
        self._session = session

    def __getattr__(self, name):
        return getattr(self._session, name)

    def step(self, commands=None):
        if self._session.observe().time_s > 1.0:
            raise RunError("robot_1 is gone")
        return self._session.step(commands)

    def close(self):
        """It is shared."""


def test_what_was_driven_until_a_robot_is_lost_is_kept(scenario, session, folder, tmp_path):
    session.reset()
    settings = TeleopSettings(script=folder / "keys.txt", out=tmp_path / "run")
    opened = opening.OpenedSession(session=Breaking(session))
    with pytest.raises(RunError, match=r"robot_1 is gone.*is in .*run"):
        run_teleop(scenario, settings, opener=lambda *_: opened)
    kept = Run(tmp_path / "run")
    assert not kept.summary["complete"]
    assert kept.summary["interrupted"] == "robot_1 is gone"
    assert kept.trajectories["time_s"].shape == (6,)  # 1 s at 5 Hz, and its beginning
    assert os.listdir(tmp_path) == ["run"]
    with pytest.raises(ConfigError, match="run it anew"):
        reopen_folder(tmp_path / "run", print)


def test_autopilots_are_asked_for_by_name(folder, capsys):
    with pytest.raises(SystemExit) as left:
        main(["teleop", str(folder / "three.toml"), "--level", "guided"])
    assert left.value.code == 2
    assert "--level" in capsys.readouterr().err


def test_worlds_are_counted_from_0(scenario, folder):
    with pytest.raises(ConfigError, match="--world -1"):
        run_teleop(scenario, TeleopSettings(script=folder / "keys.txt", world=-1))


def test_a_run_without_samples_cannot_be_recorded(folder, tmp_path):
    bare = load_scenario(folder / "three.toml", time={"record_hz": 0.0})
    with pytest.raises(ConfigError, match="record_hz = 5"):
        TeleopRecording(tmp_path / "run", bare, 0)


def test_a_view_that_cannot_be_had_is_refused_first(monkeypatch, tmp_path):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(UnsupportedError, match="no display"):
        live_view.require_viewer(None)
    monkeypatch.setattr(live_view.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(UnsupportedError, match="install the extra `view`"):
        live_view.require_viewer(tmp_path)


def test_the_viewer_is_told_of_what_moves_and_who_drives(session, tmp_path):
    rr = pytest.importorskip("rerun", reason="the extra `view` is not installed")
    stream = rr.RecordingStream("test", recording_id="test")
    stream.save(tmp_path / "live.rrd")
    session.reset()
    pilot = TeleopPilot(session.robots, (0,), speed_mps=0.4, turn_radps=0.4)
    view = live_view.LiveView(stream, session, pilot, "world_1")
    for k in range(41):
        if k == 10:
            pilot.press("i", session.observe().time_s)
        view.after(session.step(pilot.build_commands(session.observe()).commands))
    stream.flush()
    stream.disconnect()
    held = {}
    for chunk in rr.chunk.RrdReader(tmp_path / "live.rrd").stream().to_chunks():
        held.setdefault(chunk.entity_path, []).append(chunk.to_record_batch())
    # 41 steps of 0.05 s: poses at every 0.1 s, pieces of trails at every second.
    space = "/world_1/space"
    for moving in ("robot_0/vehicle", "current", "obstacles/spheres", "../camera"):
        path = os.path.normpath(f"{space}/{moving}")
        assert sum("time" in batch.schema.names and batch.num_rows for batch in held[path]) == 21
    trail = [
        row[0]
        for batch in held[f"{space}/robot_2/trail"]
        if "LineStrips3D:strips" in batch.schema.names
        for row in batch.column("LineStrips3D:strips").to_pylist()
    ]
    assert [len(piece) for piece in trail] == [1, 11, 11]
    assert trail[2][0] == trail[1][-1]
    labels = [
        row[0]
        for batch in held[f"{space}/robot_0/vehicle/label"]
        if "Points3D:labels" in batch.schema.names
        for row in batch.column("Points3D:labels").to_pylist()
    ]
    # Only what is new is said again.
    assert labels[:3] == ["> 0: plan", "> 0: teleop", "> 0: stopping"]
    for still in ("floor", "bounds", "robot_1/goal", "robot_1/plan"):
        assert f"{space}/{still}" in held


COMMAND = "from angler_mjx.cli.main import main; main([{arguments}])"


@pytest.mark.nightly(
    by="test_terminal.py with real terminals, test_keys.py, test_pilot.py, and the scripts above"
)
def test_by_hand_in_a_terminal(start, folder, tmp_path):
    run_folder = str(tmp_path / "run")
    given = ["teleop", str(folder / "three.toml"), "--robots", "0,2", "--out", run_folder]
    terminal = start(COMMAND.format(arguments=", ".join(map(repr, given))))
    terminal.wait_for("robot_2")
    terminal.type("i")
    terminal.wait_for("teleop")
    terminal.type("\t?")
    terminal.wait_for("back to the plan")
    # The key was given once, so the robot stops by itself.
    terminal.wait_for("stopping")
    terminal.type("\x03")
    assert terminal.end() == 0
    assert_given_back(terminal)
    told = terminal.shown.rsplit(b"\x1b[?1049l", 1)[1].decode()
    assert "overrun" in told
    assert "robot_1: running" in told
    assert run_folder in told
    assert os.listdir(tmp_path) == ["run"]
    made = Run(tmp_path / "run")
    assert made.summary["teleop"]["realtime"]
    # Real time: the scene never runs ahead of the clock; 0.1 s is two periods.
    assert made.summary["teleop"]["scene_s"] < made.summary["timing"]["simulate_s"] + 0.1
    assert [one.key for one in load_keys(made.path / KEYS_FILE)] == ["i", "\t", "?"]


def test_without_a_terminal_the_command_asks_for_a_script(folder, capsys):
    with pytest.raises(SystemExit) as left:
        main(["teleop", str(folder / "three.toml")])
    assert left.value.code == 2
    assert "give --script FILE" in capsys.readouterr().err


def test_the_command_line_has_the_same_silence():
    assert inspect.signature(teleop).parameters["silence"].default == KEY_TIMEOUT_S
