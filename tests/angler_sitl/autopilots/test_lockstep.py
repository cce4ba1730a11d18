import os
import signal
import socket
import struct

import numpy as np
import pytest

from angler_mjx.errors import RunError
from angler_sitl.autopilots import lockstep
from angler_sitl.autopilots.lockstep import LockStep
from angler_sitl.firmware import process
from angler_sitl.scene.scene import SensorStates
from angler_sitl.wire.packets import STATE_NUMBERS
from angler_sitl.wire.ports import allocate_ports

DT_S = 1 / 400


class Rest:
    """A scene in which nothing moves; it remembers what it was given."""

    def __init__(self, count):
        self.dt_s, self.ticks, self.given = DT_S, 0, []
        self._states = SensorStates(numbers=np.zeros((count, STATE_NUMBERS)))
        self._states.numbers[:, 5], self._states.numbers[:, 9] = -9.80665, 1.0

    @property
    def time_s(self):
        return self.ticks * self.dt_s

    def step(self, pwm):
        self.ticks += 1
        self.given.append(pwm.copy())
        return self._states


class Peer:
    """An autopilot as far as the socket goes."""

    def __init__(self, port):
        self.port, self.frame = port, -1
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.0)

    def ask(self, frame=None, pulse=1500):
        self.frame = self.frame + 1 if frame is None else frame
        data = struct.pack("<HHI16H", 18458, 400, self.frame, *[pulse] * 16)
        self.socket.sendto(data, ("127.0.0.1", self.port))

    def answers(self):
        got = []
        try:
            while True:
                got.append(self.socket.recv(4096))
        except BlockingIOError:
            return got


class Rig:
    """Two peers and their lock-step."""

    def __init__(self, **options):
        self.ports = allocate_ports(2)
        self.scene, self.faults = Rest(2), {}
        self.peers = [Peer(one.fdm.getsockname()[1]) for one in self.ports]
        self.lockstep = LockStep(
            [one.fdm for one in self.ports],
            self.scene,
            names=["robot_0", "robot_1"],
            fault=self.faults.get,
            condition=lambda i: f"robot_{i} was stopped",
            **options,
        )

    def ask(self, **what):
        for peer in self.peers:
            peer.ask(**what)

    def close(self):
        for one in self.ports:
            one.close()
        for peer in self.peers:
            peer.socket.close()


@pytest.fixture
def rig(request):
    made = Rig(**getattr(request, "param", {}))
    yield made
    made.close()


def clock(text):
    return float(text.split(b'"timestamp":')[1].split(b",")[0])


def test_all_are_answered_once_with_one_clock(rig):
    for k in range(1, 4):
        rig.ask(pulse=1500 + k)
        rig.lockstep.advance(1)
        answers = [peer.answers() for peer in rig.peers]
        assert [len(one) for one in answers] == [1, 1]
        assert [clock(one[0]) for one in answers] == [pytest.approx(k * DT_S, abs=1e-9)] * 2
        assert (rig.lockstep.pwm == 1500 + k).all()
    # Taken while the peers would work: with what they sent before.
    assert [one[0, 0] for one in rig.scene.given] == [0, 1501, 1502]
    assert rig.lockstep.time_s == 3 * DT_S
    assert rig.lockstep.spent.barriers == 3


def test_a_packet_sent_again_gets_the_same_answer_and_no_step(rig):
    rig.ask()
    rig.lockstep.advance(1)
    (first,) = rig.peers[0].answers()
    rig.peers[0].ask(frame=0, pulse=1700)  # it did not get the answer
    rig.ask(frame=1)
    rig.lockstep.advance(1)
    again, second = rig.peers[0].answers()
    assert again == first
    assert clock(second) == pytest.approx(2 * DT_S, abs=1e-9)
    assert rig.scene.ticks == 2


def test_what_came_again_during_a_pause_is_answered_once(rig, monkeypatch):
    monkeypatch.setattr(lockstep, "RESEND_S", 0.0)
    rig.ask()
    rig.ask(frame=0)
    rig.ask(frame=0)
    rig.lockstep.advance(1)
    assert [len(peer.answers()) for peer in rig.peers] == [1, 1]
    # Nor later: what gathered is gone, and the next packet gets the next answer, once.
    rig.ask(frame=1)
    rig.lockstep.advance(1)
    answers = [peer.answers() for peer in rig.peers]
    assert [[clock(text) for text in got] for got in answers] == [[pytest.approx(2 * DT_S)]] * 2


def test_what_is_no_servo_packet_is_passed_over(rig):
    for peer in rig.peers:
        peer.socket.sendto(b"hello", ("127.0.0.1", peer.port))
    rig.ask()
    rig.lockstep.advance(1)
    assert [len(peer.answers()) for peer in rig.peers] == [1, 1]


def test_the_end_of_an_autopilot_is_named(rig):
    rig.faults[1] = "robot_1: its ArduSub (pid 1) ended by SIGSEGV"
    rig.peers[0].ask()
    with pytest.raises(RunError, match=r"robot_1: .*SIGSEGV"):
        rig.lockstep.advance(1)
    # Who asked was answered; the next step is not taken without the other.
    assert len(rig.peers[0].answers()) == 1
    assert rig.scene.ticks == 1


@pytest.mark.parametrize("rig", [{"hang_s": 0.2}], indirect=True)
def test_a_hang_is_named(rig):
    rig.peers[1].ask()
    with pytest.raises(RunError, match=r"robot_0: .*hangs.*robot_0 was stopped"):
        rig.lockstep.advance(1)


def reboot(rig, port_too):
    rig.ask()
    rig.lockstep.advance(1)
    rig.ask()
    rig.lockstep.advance(1)
    if port_too:
        rig.peers[1].socket.close()
        rig.peers[1] = Peer(rig.peers[1].port)
    rig.peers[0].ask()
    rig.peers[1].ask(frame=0)


@pytest.mark.parametrize("port_too", [False, True])
def test_a_reboot_is_named(rig, port_too):
    reboot(rig, port_too)
    with pytest.raises(RunError, match=r"robot_1: .*began anew"):
        rig.lockstep.advance(1)


def test_a_second_sender_is_named(rig):
    rig.ask()
    rig.lockstep.advance(1)
    stranger = Peer(rig.peers[0].port)
    stranger.ask(frame=7)
    with pytest.raises(RunError, match=r"robot_0: .*two programs"):
        rig.lockstep.advance(1)
    stranger.socket.close()


@pytest.mark.parametrize("rig", [{"on_crash": "hold"}], indirect=True)
def test_the_others_go_on_where_that_was_asked_for(rig):
    rig.ask(pulse=1600)
    rig.lockstep.advance(1)
    rig.faults[1] = "robot_1: ended"
    for _ in range(3):
        rig.peers[0].ask(pulse=1600)
        rig.lockstep.advance(1)
    assert rig.lockstep.lost == {1: "robot_1: ended"}
    assert (rig.scene.given[-1][0] == 1600).all()
    assert (rig.scene.given[-1][1] == 0).all()
    assert len(rig.peers[0].answers()) == 4
    rig.faults[0] = "robot_0: ended"
    with pytest.raises(RunError, match=r"no autopilot is left: .*robot_1: ended; robot_0: ended"):
        rig.lockstep.advance(1)


def fly(binary, folder, parameters, misdeed):
    """Two processes and a scene at rest: a second of it, a misdeed, and what is said of it."""
    ports = allocate_ports(2)
    names = ["robot_0", "robot_1"]
    instances = []
    try:
        for i, (name, one) in enumerate(zip(names, ports, strict=True)):
            launch = process.LaunchSpec(
                binary=binary,
                folder=folder / name,
                name=name,
                sysid=i + 1,
                ports=one,
                parameters={"SIM_RATE_HZ": 400.0, **parameters.get(i, {})},
            )
            instances.append(process.AutopilotProcess(launch))
        steps = LockStep(
            [one.fdm for one in ports],
            Rest(2),
            names=names,
            fault=lambda i: instances[i].fault(),
            condition=lambda i: instances[i].condition(),
            hang_s=5.0,
        )
        steps.advance(400)
        early = steps.pwm.copy()
        steps.advance(600)
        misdeed(instances)
        with pytest.raises(RunError) as said:
            steps.advance(2000)
        return early, steps.pwm, str(said.value)
    finally:
        process.kill_processes(instances)
        for one in ports:
            one.close()


def killed(instances):
    os.kill(instances[1].pid, signal.SIGKILL)


def left(instances):
    pass


def test_a_killed_stand_in_is_named(stand_in, tmp_path):
    early, _, said = fly(stand_in, tmp_path, {}, killed)
    assert not early[:, :8].any()  # no pulses while it boots
    assert said.startswith("robot_1: ")
    assert "SIGKILL" in said


def test_a_stand_in_that_reboots_is_named(stand_in, tmp_path):
    _, _, said = fly(stand_in, tmp_path, {0: {"STANDIN_REBOOT_S": 3.0}}, left)
    assert "robot_0: its autopilot began anew" in said


@pytest.mark.sitl
def test_a_killed_ardusub_is_named(ardusub, tmp_path):
    early, late, said = fly(ardusub, tmp_path, {}, killed)
    assert not early[:, :6].any()  # the motors have no pulses while it boots
    assert (late[0, :6] == 1500).all()
    assert said.startswith("robot_1: ")
    assert "SIGKILL" in said
