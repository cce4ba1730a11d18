"""Flights from boot to run folder: what is kept, what breaks them off, and who may join.

One scene is compiled; it is flown by the stand-in and, where there is one, by a real ArduSub.
"""

import json
import os
import signal
import socket
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from angler_mjx.cli.main import main
from angler_mjx.errors import ConfigError, RunError
from angler_mjx.report.interop import joint_trajectory_file, mcap
from angler_mjx.robot.control.commands.joint_goal import JointGoal, JointPoint
from angler_mjx.runs.storage.folder import Run
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.teleop import driving, opening
from angler_mjx.testing import referee
from angler_sitl.missions import mission
from angler_sitl.missions.firmware_mission import build_upload
from angler_sitl.missions.mission import MissionSettings
from angler_sitl.session import SitlSession

SCENARIO = """
schema_version = 1
name = "pair"

[time]
horizon_s = 60.0
record_hz = 10.0

[world]
preset = "open"
placement = "given"
start_m = [[-2.0, -2.0, -5.0], [-2.0, 2.0, -5.0]]
goal_m = [[4.0, -2.0, -5.0], [4.0, 2.0, -5.0]]

[[fleet]]
vehicle = "bluerov2_heavy"
count = 2
"""

both = pytest.mark.parametrize(
    "program", ["stand_in", pytest.param("ardusub", marks=pytest.mark.sitl)]
)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("mission") / "pair.toml"
    path.write_text(SCENARIO)
    return path


@pytest.fixture(scope="module")
def scenario(file):
    return load_scenario(file)


@pytest.fixture(scope="module")
def compiled(scenario, stand_in):
    with SitlSession(scenario, binary=stand_in.path) as session:
        yield session


@pytest.fixture
def session(compiled, request, monkeypatch):
    """The compiled session, flown by the program that a test asks for."""
    name = getattr(request.node, "callspec", None)
    program = "stand_in" if name is None else name.params.get("program", "stand_in")
    before = compiled.settings
    compiled.settings = replace(before, binary=request.getfixturevalue(program))

    def opened(scenario, settings, given, building, missions=()):
        compiled.settings = replace(
            compiled.settings,
            on_crash=settings.on_crash,
            folder=building / "robots",
            parameters=dict(given),
            missions=[build_upload(mission) for mission in missions],
            **({"home": missions[0].home} if missions else {}),
        )
        compiled.reset()
        return compiled

    monkeypatch.setattr(mission, "_open_session", opened)
    monkeypatch.setattr(mission.binaries, "find_binary", lambda _: compiled.settings.binary)
    yield compiled
    compiled.settings = before


class Board:
    """Stands where the live table does; does something at a time of the scene."""

    def __init__(self, at_s=1.0, act=lambda: None):
        self.at_s, self.act, self.done_at, self.pids = at_s, act, None, []

    @contextmanager
    def __call__(self, session):
        self.session, self.pids = session, [one.pid for one in session.autopilots.instances]
        yield self

    def after(self, observation):
        if self.done_at is None and observation.time_s >= self.at_s:
            self.done_at = time.perf_counter()
            self.act()

    def kill_first(self):
        os.kill(self.pids[0], signal.SIGKILL)


def killer():
    board = Board()
    board.act = board.kill_first
    return board


def gone(pids):
    return pids and not any(Path(f"/proc/{pid}").exists() for pid in pids)


def fly(scenario, out, board, **given):
    return mission.run_mission(scenario, MissionSettings(out=out, **given), lambda _: None, board)


@both
def test_a_flight_is_a_run_like_any_other(session, scenario, tmp_path, program):
    board = Board()
    flight, run = fly(scenario, tmp_path / "run", board, duration_s=2.0)
    assert flight.scene_s == pytest.approx(2.0)
    assert gone(board.pids)
    assert os.listdir(tmp_path) == ["run"]
    again = Run(run.path)
    assert again.summary["complete"]
    assert again.summary["sitl"]["level"] == "guided"
    stated = again.summary["sitl"]["ardusub"]["version"]
    assert stated == "4.6.0-dev" if program == "stand_in" else stated[0].isdigit()
    truth, known = (np.asarray(again.trajectories[name])[0] for name in ("p_m", "estimate/p_m"))
    assert truth.shape == (20, 2, 3)
    np.testing.assert_allclose(truth[0], [[-2, -2, -5], [-2, 2, -5]], atol=1e-6)
    # Told every 20 ms, and carried on from then.
    np.testing.assert_allclose(known, truth, atol=0.02)
    mcap.export_bag(again, tmp_path / "out.mcap", [0])
    for name in ("robot_0", "robot_1"):
        logs = run.path / "robots" / name
        # A telemetry log begins with a time and a packet of the second version.
        assert (logs / "mavlink.tlog").read_bytes()[8] == dialect.PROTOCOL_MARKER_V2
        assert (logs / "ardusub.log").stat().st_size > 0
        if program == "ardusub":
            (own,) = (logs / "logs").glob("*.BIN")
            assert own.stat().st_size > 20_000  # 45 kB for each second


@both
def test_the_referee_agrees_with_what_was_judged(session, scenario, tmp_path, program):
    timing = scenario.time.model_copy(update={"record_hz": 20.0})
    fine = scenario.model_copy(update={"time": timing})
    _, run = fly(fine, tmp_path / "run", Board(), duration_s=2.0)
    verdict = referee.judge(run.path)
    assert [one.format_line() for one in verdict.differences] == []
    assert {count.exact for count in verdict.counts.values()} == {2}
    assert verdict.counts["energy_j"].largest < 1e-5
    if program == "ardusub":
        assert min(run.episodes["energy_j"].to_pylist()) > 1.0


@both
def test_a_lost_autopilot_ends_the_run(session, scenario, tmp_path, program):
    board = killer()
    with pytest.raises(RunError, match=r"robot_0: .*SIGKILL(.|\n)*is in .*run") as caught:
        fly(scenario, tmp_path / "run", board, duration_s=30.0)
    assert time.perf_counter() - board.done_at < 15.0  # half of what it was to fly
    assert "robot_1:" not in str(caught.value)
    assert gone(board.pids)
    kept = Run(tmp_path / "run")
    assert not kept.summary["complete"]
    assert kept.summary["interrupted"].startswith("robot_0: ")
    p = np.asarray(kept.trajectories["p_m"])[0]
    assert p.shape[0] in (10, 11)  # 1 s at 10 Hz
    assert np.isfinite(p).all()
    assert os.listdir(tmp_path) == ["run"]


@both
def test_the_others_go_on_where_that_is_asked_for(session, scenario, tmp_path, program):
    flight, run = fly(scenario, tmp_path / "run", killer(), duration_s=2.0, on_crash="hold")
    assert flight.scene_s == pytest.approx(2.0)
    assert flight.last.status[0].note.startswith("lost: robot_0: ")
    assert "armed" in flight.last.status[1].note
    assert list(run.summary["sitl"]["lost"]) == ["robot_0"]
    assert run.summary["complete"]


def test_a_signal_ends_the_flight_and_what_was_flown_is_kept(session, scenario, tmp_path):
    board = Board(act=lambda: os.kill(os.getpid(), signal.SIGINT))
    flight, run = fly(scenario, tmp_path / "run", board)
    assert flight.by_signal
    assert gone(board.pids)
    assert run.summary["interrupted"] == "interrupted by a signal"
    assert run.trajectories["time_s"].shape[0] in (10, 11)


def test_an_autopilot_that_does_not_come_up_leaves_nothing(session, scenario, tmp_path):
    given = tmp_path / "given.param"
    given.write_text("STANDIN_NO_ARM,1\n", encoding="utf-8")
    with pytest.raises(RunError, match=r"robot_\d: refuses to arm.*Battery 1 unhealthy"):
        fly(scenario, tmp_path / "run", Board(), parameters=given)
    assert os.listdir(tmp_path) == ["given.param"]


def goal(*points, joints=("x", "y", "z")):
    return JointGoal(
        joint_names=joints,
        points=tuple(JointPoint(time_s=time_s, positions=at) for time_s, at in points),
    )


HERE = goal((0.5, (-2.0, -2.0, -5.0)), (1.0, (-2.0, -2.0, -5.0)))
STEP = goal((4.0, (-2.0, 2.5, -5.0)))


@both
def test_trajectories_of_files_are_flown_and_their_end_is_the_end(
    session, scenario, tmp_path, program
):
    first, second = tmp_path / "first.json", tmp_path / "second.json"
    joint_trajectory_file.write_trajectories(first, {0: HERE})
    # The stand-in does not move: it could follow no other.
    still = goal((1.0, (-2.0, 2.0, -5.0)))
    joint_trajectory_file.write_trajectories(second, {1: STEP if program == "ardusub" else still})
    plan = (str(first), str(second))
    flight, run = fly(scenario, tmp_path / "run", Board(), plan=plan)
    assert flight.scene_s < 20.0  # of 60
    notes = run.summary["sitl"]["trajectories"].values()
    assert all(note.startswith("SUCCESSFUL") for note in notes)
    plan = np.asarray(run.trajectories["plan_m"])[0, 1]
    end = [-2.0, 2.5 if program == "ardusub" else 2.0, -5.0]
    np.testing.assert_allclose(plan[[0, -1]], [[-2.0, 2.0, -5.0], end], atol=0.01)
    if program == "ardusub":
        # Tolerance of a trajectory's end: 0.15 m for each joint.
        np.testing.assert_allclose(flight.last.truth.p[1], [-2.0, 2.5, -5.0], atol=0.15)


PLANS = {
    "a robot twice": ([{0: HERE}, {0: HERE}], "robot 0 is in an earlier file"),
    "no such robot": ([{5: HERE}], "there are 0 to 1"),
    "too far away": ([{0: goal((0.0, (3.0, 0.0, -5.0)))}], "start tolerance"),
    "no such joint": ([{0: goal((1.0, (3.0,)), joints=("w",))}], "'w' is no joint"),
}


@pytest.mark.parametrize("fault", PLANS)
def test_trajectories_that_cannot_be_flown_are_named(session, scenario, tmp_path, fault):
    given, message = PLANS[fault]
    files = []
    for i, goals in enumerate(given):
        files.append(str(tmp_path / f"{i}.json"))
        joint_trajectory_file.write_trajectories(Path(files[-1]), goals)
    with pytest.raises(ConfigError, match=message):
        fly(scenario, tmp_path / "run", Board(), plan=files)
    assert sorted(os.listdir(tmp_path)) == sorted(Path(name).name for name in files)


class Ground:
    """A ground station as far as a test needs one."""

    def __init__(self):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        self.address = f"udp:127.0.0.1:{self.socket.getsockname()[1]}"
        self.mav = dialect.MAVLink(self, srcSystem=255, srcComponent=190)
        self.heard, self.asked, self.peer = [], False, None

    def write(self, packet):
        self.socket.sendto(packet, self.peer)

    @contextmanager
    def __call__(self, session):
        self.session = session
        yield self

    def after(self, observation):
        while True:
            try:
                data, self.peer = self.socket.recvfrom(65536)
            except BlockingIOError:
                break
            self.heard += self.mav.parse_buffer(data) or ()
        if {1, 2} <= {one.get_srcSystem() for one in self.heard} and not self.asked:
            self.asked = True
            set_mode, hold_depth = dialect.MAV_CMD_DO_SET_MODE, 2
            self.mav.command_long_send(2, 1, set_mode, 0, 1, hold_depth, 0, 0, 0, 0, 0)
            self.mav.param_request_read_send(1, 1, b"SYSID_THISMAV", -1)


@both
def test_a_ground_station_joins(session, scenario, tmp_path, program):
    ground = Ground()
    with ground.socket:
        flight, _ = fly(scenario, tmp_path / "run", ground, duration_s=2.5, gcs=ground.address)
    beats = {one.get_srcSystem() for one in ground.heard if one.get_type() == "HEARTBEAT"}
    assert beats == {1, 2}
    assert "GUIDED" in flight.last.status[0].note
    assert "ALT_HOLD" in flight.last.status[1].note
    if program == "ardusub":  # the stand-in answers on its other line
        values = [one for one in ground.heard if one.get_type() == "PARAM_VALUE"]
        assert [(one.get_srcSystem(), one.param_value) for one in values] == [(1, 1.0)]


def test_the_command_shows_lines_and_its_folder(session, file, tmp_path, capsys):
    out = tmp_path / "run"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        nobody = free.getsockname()[1]  # listens there: that harms nothing
    gcs = f"udp:127.0.0.1:{nobody}"
    main(["sitl", "run", str(file), "--out", str(out), "--duration", "1.0", "--gcs", gcs])
    shown = capsys.readouterr()
    assert shown.out.splitlines()[-1] == str(out)
    assert "robot_1: running, GUIDED, armed" in shown.out
    assert "0.00 s  robot_0: GUIDED, armed, EKF good, off 0.00 m" in shown.err
    assert json.loads((out / "summary.json").read_text())["sitl"]["scene_s"] == pytest.approx(1.0)


class Shared:
    """A session that driving may close without ending it for the tests that follow."""

    def __init__(self, session):
        self._session = session

    def __getattr__(self, name):
        return getattr(self._session, name)

    def close(self):
        self._session.__exit__(None, None, None)


@pytest.mark.sitl
def test_keys_drive_a_real_autopilot(session, scenario, tmp_path, ardusub):
    session.settings = replace(session.settings, binary=ardusub, folder=None)
    (tmp_path / "keys.txt").write_text("0-4 i\n9 Q\n")

    def opened(scenario, world, logs, tell):
        session.settings = replace(session.settings, folder=logs)
        session.reset()
        return opening.OpenedSession(session=Shared(session))

    settings = driving.TeleopSettings(
        script=tmp_path / "keys.txt", realtime=False, out=tmp_path / "run", speed_mps=0.3
    )
    _, run = driving.run_teleop(scenario, settings, opener=opened)
    p = np.asarray(run.trajectories["p_m"])[0]
    q = np.asarray(run.trajectories["q"])[0, 0, 0]
    ahead = np.array([1 - 2 * (q[2] ** 2 + q[3] ** 2), 2 * (q[1] * q[2] + q[0] * q[3]), 0.0])
    way = p[-1, 0] - p[0, 0]
    # Four seconds at 0.3 m/s; the firmware takes some of them to get there, and to stop.
    assert way @ ahead == pytest.approx(1.2, abs=0.4)
    assert (run.path / "robots" / "robot_0" / "mavlink.tlog").stat().st_size > 0
