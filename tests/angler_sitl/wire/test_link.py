"""MAVLink over a socket: who is heard, who is answered, what is sent when, and what is logged."""

import socket
import struct

import numpy as np
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as dialect
from scipy.spatial.transform import Rotation

from angler_sitl.wire import messages
from angler_sitl.wire.link import MavlinkLink, TelemetryLog

LOOPBACK = "127.0.0.1"


class Far:
    """The other end: a socket with pymavlink's codec."""

    def __init__(self, to, sysid=3):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((LOOPBACK, 0))
        self.socket.settimeout(2.0)  # wall time, for a test that fails
        self._to = to
        self._codec = dialect.MAVLink(None, srcSystem=sysid, srcComponent=1)

    def say(self, message):
        self.socket.sendto(message.pack(self._codec), self._to)

    def beat(self, mode=4):
        self.say(dialect.MAVLink_heartbeat_message(12, 3, 128, mode, 4, 3))

    def hear(self):
        return self._codec.parse_buffer(self.socket.recv(65536))

    def hears_nothing(self):
        self.socket.setblocking(False)
        with pytest.raises(BlockingIOError):
            self.socket.recv(65536)
        self.socket.settimeout(2.0)


@pytest.fixture
def ends():
    bound = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    bound.bind((LOOPBACK, 0))
    far = Far(bound.getsockname())
    yield bound, far
    bound.close()
    far.socket.close()


def test_answers_go_to_where_its_packets_come_from(ends):
    bound, far = ends
    link = MavlinkLink(bound, name="robot_0", sysid=3)
    link.tick(0.0)
    assert not link.has_peer
    far.beat()
    link.tick(0.05)
    assert link.has_peer
    assert [one.get_type() for one in far.hear()] == ["HEARTBEAT"]
    moved = Far(bound.getsockname())  # it began anew: another port
    moved.beat(mode=19)
    link.receive(0.1)
    link.command(400, 1)
    (command,) = moved.hear()
    assert (command.command, command.param1, command.target_system) == (400, 1.0, 3)
    far.hears_nothing()
    assert link.latest["HEARTBEAT"].custom_mode == 19
    moved.socket.close()


def test_others_are_not_heard(ends):
    bound, _ = ends
    link = MavlinkLink(bound, name="robot_0", sysid=3)
    stranger = Far(bound.getsockname(), sysid=4)
    stranger.beat()
    stranger.socket.sendto(b"no MAVLink at all", bound.getsockname())
    link.tick(0.0)
    assert not link.has_peer
    assert not link.latest
    stranger.hears_nothing()
    stranger.socket.close()


def test_heartbeats_are_paced_by_the_clock_of_the_scene(ends):
    bound, far = ends
    link = MavlinkLink(bound, name="robot_0", sysid=3)
    far.beat()
    for period in range(101):  # 5 s of the scene in no time at all
        link.tick(0.05 * period)
    beats = 0
    far.socket.setblocking(False)
    while True:
        try:
            beats += len(far.hear())
        except BlockingIOError:
            break
    assert beats == 6  # at 0, 1, 2, 3, 4 and 5 s


def test_parameters_texts_and_answers_are_kept(ends):
    bound, far = ends
    link = MavlinkLink(bound, name="robot_0", sysid=3)
    far.say(dialect.MAVLink_param_value_message(b"SIM_RATE_HZ", 400.0, 9, 2, 1))
    far.say(dialect.MAVLink_statustext_message(3, b"PreArm: no"))
    far.say(dialect.MAVLink_command_ack_message(400, 4))
    link.receive(7.5)
    assert link.parameters == {"SIM_RATE_HZ": 400.0}
    assert (link.parameter_count, link.parameter_indices) == (2, {1})
    assert [(text.time_s, text.text) for text in link.texts] == [(7.5, "PreArm: no")]
    assert link.acks == {400: 4}
    link.command(400, 1)
    assert link.acks == {}


def test_a_ground_station_reads_the_log(ends, tmp_path):
    bound, far = ends
    log = TelemetryLog(tmp_path / "mavlink.tlog")
    link = MavlinkLink(bound, name="robot_0", sysid=3, tap=log.log_packet)
    far.beat()
    link.tick(0.0)  # its heartbeat, and ours
    far.say(dialect.MAVLink_local_position_ned_message(12000, 1, 2, 3, 4, 5, 6))
    link.receive(12.25)
    log.close()
    stored = (tmp_path / "mavlink.tlog").read_bytes()
    first = struct.unpack(">Q", stored[:8])[0]
    # The reader that MAVProxy has.
    read = mavutil.mavlink_connection(str(tmp_path / "mavlink.tlog"), dialect="ardupilotmega")
    seen = [read.recv_match() for _ in range(3)]
    kinds = [(one.get_type(), one.get_srcSystem()) for one in seen]
    assert kinds == [("HEARTBEAT", 3), ("HEARTBEAT", 255), ("LOCAL_POSITION_NED", 3)]
    # The reader keeps times as float64 of seconds since 1970: half a microsecond.
    assert seen[2]._timestamp - first * 1e-6 == pytest.approx(12.25, abs=2e-6)
    assert read.recv_match() is None


def sent(message):
    """A message as it arrives."""
    codec = dialect.MAVLink(None)
    (arrived,) = dialect.MAVLink(None).parse_buffer(message.pack(codec))
    return arrived


def test_targets_are_told_in_north_east_down():
    target = sent(
        messages.build_position_target(
            5, 2.5, np.array([1.0, 2.0, -3.0]), np.array([0.1, 0.2, 0.3]), np.pi / 2
        )
    )
    assert (target.target_system, target.coordinate_frame, target.time_boot_ms) == (5, 1, 2500)
    place = [target.x, target.y, target.z, target.vx, target.vy, target.vz]
    # float32 on the wire.
    np.testing.assert_allclose(place, [2.0, 1.0, 3.0, 0.2, 0.1, -0.3], rtol=1e-6)
    assert target.yaw == pytest.approx(0.0, abs=1e-6)  # north
    assert target.type_mask == 0b100111000000  # accelerations and yaw rate left out
    assert messages.heading_to_ned(0.0) == pytest.approx(np.pi / 2)  # east
    assert messages.heading_to_ned(-np.pi / 2) == pytest.approx(np.pi)  # south


def test_signals_are_radio_channels():
    override = sent(
        messages.build_override(2, np.array([1100.4, 1500.0, 1899.6, 1500, 1500, 1500]))
    )
    channels = [getattr(override, f"chan{i}_raw") for i in range(1, 19)]
    assert channels == [1100, 1500, 1900, 1500, 1500, 1500, *[0] * 12]


def test_external_navigation_has_the_attitude_and_its_spread():
    # From roll, pitch and yaw by an independent library.
    turned = Rotation.from_euler("ZYX", [2.0, -0.4, 0.3])
    x, y, z, w = turned.as_quat()
    position, spread = np.array([4.0, 5.0, 6.0]), np.array([0.1, 0.2, 0.3])
    told = sent(
        messages.vision_position(1.5, position, np.array([w, x, y, z]), spread, 2.0 * spread)
    )
    assert told.usec == 1_500_000
    np.testing.assert_allclose([told.roll, told.pitch, told.yaw], [0.3, -0.4, 2.0], atol=1e-6)
    square = np.zeros((6, 6))
    square[np.triu_indices(6)] = told.covariance
    wanted = np.diag(np.square([*spread, *(2.0 * spread)]))
    np.testing.assert_allclose(square, wanted, rtol=1e-6)
    speed = sent(messages.vision_speed(1.5, np.array([0.1, 0.2, 0.3]), spread))
    np.testing.assert_allclose([speed.x, speed.y, speed.z], [0.1, 0.2, 0.3], rtol=1e-6)
    matrix = np.reshape(speed.covariance, (3, 3))
    np.testing.assert_allclose(matrix, np.diag(spread**2), rtol=1e-6)
