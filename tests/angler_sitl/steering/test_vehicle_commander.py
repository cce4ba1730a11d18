"""What counts of an autopilot's messages: wrong, late, duplicate and foreign ones do not."""

import math
from collections import deque

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from angler_sitl.steering.autopilot_commander import collect_motion
from angler_sitl.steering.vehicle_commander import MAX_DELAY_S, VehicleCommander, VehicleLink

GOOD = 831


class Line:
    """A channel in memory; what is sent is kept."""

    def __init__(self):
        self.arrived, self.sent = deque(), []
        self.codec = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        self.other = dialect.MAVLink(None, srcSystem=1, srcComponent=191)
        self.reader = dialect.MAVLink(None)

    def setblocking(self, flag):
        assert not flag

    def recvfrom(self, size):
        if not self.arrived:
            raise BlockingIOError
        return self.arrived.popleft(), ("vehicle", 1)

    def sendto(self, data, address):
        self.sent += self.reader.parse_buffer(bytes(data)) or ()
        return len(data)

    def say(self, message, codec=None):
        self.arrived.append(message.pack(codec or self.codec))


def position(stamp_s, x=1.0, y=2.0, z=3.0, vx=0.0, vy=0.0, vz=0.0):
    return dialect.MAVLink_local_position_ned_message(round(1e3 * stamp_s), x, y, z, vx, vy, vz)


def attitude(stamp_s, q=(1.0, 0.0, 0.0, 0.0), rates=(0.0, 0.0, 0.0)):
    return dialect.MAVLink_attitude_quaternion_message(round(1e3 * stamp_s), *q, *rates)


def filter_report(flags=GOOD):
    return dialect.MAVLink_ekf_status_report_message(flags, 0.1, 0.1, 0.1, 0.1, 0.1)


def heartbeat(mode=4, armed=True):
    return dialect.MAVLink_heartbeat_message(12, 3, 128 * armed, mode, 4, 3)


@pytest.fixture
def line():
    return Line()


@pytest.fixture
def pilot(line):
    return VehicleCommander(VehicleLink(line, name="robot_0", sysid=1))


def good_tick(line, pilot, time_s, stamp_s, **motion):
    for message in (heartbeat(), filter_report(), attitude(stamp_s), position(stamp_s, **motion)):
        line.say(message)
    pilot.tick(time_s)


def test_a_good_pose_counts(line, pilot):
    good_tick(line, pilot, 10.0, 100.0)
    assert pilot.position_good_s == 10.0
    assert pilot.link.heard_s == 10.0
    assert pilot.is_guided
    assert not pilot.link.counts


@pytest.mark.parametrize(
    "bad",
    [
        position(100.05, x=math.nan),
        position(100.05, vz=math.inf),
        position(100.05, z=1e6),
        attitude(100.05, q=(0.0, 0.0, 0.0, 0.0)),
        attitude(100.05, q=(math.nan, 0.0, 0.0, 1.0)),
        attitude(100.05, rates=(0.0, math.nan, 0.0)),
    ],
)
def test_numbers_that_cannot_be_are_ignored(line, pilot, bad):
    good_tick(line, pilot, 10.0, 100.0)
    before = pilot.estimate_state(10.0)
    line.say(bad)
    pilot.tick(10.05)
    assert pilot.link.counts == {"not_finite": 1}
    assert pilot.estimate_state(10.0) == before
    assert pilot.link.heard_s == 10.05  # the link lives
    assert pilot.position_good_s == 10.0


def test_duplicates_and_packets_out_of_order_are_ignored(line, pilot):
    good_tick(line, pilot, 10.0, 100.0, x=5.0)
    line.say(position(100.0, x=6.0))
    line.say(position(99.9, x=7.0))
    pilot.tick(10.05)
    assert pilot.link.counts == {"duplicate": 2}
    assert pilot.estimate_state(10.0)[0] == 5.0
    assert not pilot.link.has_restarted


def test_the_same_pose_again_and_again_is_no_position(line, pilot):
    good_tick(line, pilot, 10.0, 100.0)
    for step in range(1, 60):
        for message in (heartbeat(), filter_report(), attitude(100.0), position(100.0)):
            line.say(message)
        pilot.tick(10.0 + 0.05 * step)
    assert pilot.position_good_s == 10.0


def test_late_messages_are_ignored_until_the_delay_is_usual(line, pilot):
    good_tick(line, pilot, 10.0, 100.0)
    for message in (attitude(100.05), position(100.05)):
        line.say(message)
    pilot.tick(10.05 + MAX_DELAY_S + 0.2)
    assert pilot.link.counts == {"late": 2}
    assert pilot.position_good_s == 10.0
    for k in range(200):  # from now on all of them take as long
        time_s = 12.0 + 0.1 * k
        good_tick(line, pilot, time_s, 100.2 + 0.1 * k)
    assert pilot.position_good_s == pytest.approx(time_s)


def test_delays_up_to_the_limit_are_usual(line, pilot):
    good_tick(line, pilot, 10.0, 100.0)
    good_tick(line, pilot, 10.1 + MAX_DELAY_S - 0.05, 100.1)
    assert not pilot.link.counts


def test_a_clock_that_begins_anew_is_a_restart(line, pilot):
    good_tick(line, pilot, 10.0, 100.0)
    line.say(position(97.5))
    pilot.tick(10.05)
    assert not pilot.link.has_restarted
    line.say(position(2.0))
    pilot.tick(10.1)
    assert pilot.link.has_restarted


def test_other_components_of_the_vehicle_do_not_speak_for_its_autopilot(line, pilot):
    good_tick(line, pilot, 10.0, 100.0)
    line.say(heartbeat(mode=19, armed=False), line.other)
    line.say(position(100.1, x=50.0), line.other)
    pilot.tick(12.0)
    assert pilot.link.counts == {"component": 2}
    assert pilot.is_guided
    assert pilot.link.heard_s == 10.0
    assert pilot.estimate_state(10.0)[0] == 1.0


@pytest.mark.parametrize("flags", [167, 1024, GOOD | 128])
def test_a_filter_without_a_position_has_none(line, pilot, flags):
    line.say(filter_report(flags))
    for message in (heartbeat(), attitude(100.0), position(100.0)):
        line.say(message)
    pilot.tick(10.0)
    assert pilot.position_good_s == -math.inf


def test_a_filter_that_is_silent_has_no_position_either(line, pilot):
    good_tick(line, pilot, 10.0, 100.0)
    for step in range(1, 40):
        line.say(attitude(100.0 + 0.05 * step))
        line.say(position(100.0 + 0.05 * step))
        pilot.tick(10.0 + 0.05 * step)
    assert pilot.position_good_s == 10.0


def test_motion_is_in_w_and_carried_on_since_it_arrived(line, pilot):
    pilot.origin_ned_m = np.array([10.0, 20.0, 0.0])
    good_tick(line, pilot, 10.0, 500.0, x=1.0, y=2.0, z=3.0, vx=0.5, vy=-0.25, vz=0.1)
    motion = collect_motion([pilot], 10.2)
    # East, north, up of W: 0.2 s after the message.
    np.testing.assert_allclose(motion.p[0], [22.0 - 0.05, 11.0 + 0.1, -3.0 - 0.02], atol=1e-6)


def test_targets_are_in_the_frame_of_the_filter(line, pilot):
    pilot.origin_ned_m = np.array([10.0, 20.0, 0.0])
    good_tick(line, pilot, 10.0, 500.0)
    line.sent.clear()
    pilot.send_target(10.0, np.array([23.0, 11.0, -4.0]), np.array([0.1, 0.2, -0.3]), 0.0)
    (target,) = line.sent
    assert target.coordinate_frame == dialect.MAV_FRAME_LOCAL_NED
    np.testing.assert_allclose([target.x, target.y, target.z], [1.0, 3.0, 4.0], atol=1e-6)
    np.testing.assert_allclose([target.vx, target.vy, target.vz], [0.2, 0.1, 0.3], atol=1e-6)
    assert target.yaw == pytest.approx(math.pi / 2)  # east
    assert target.type_mask & 0b111 == 0  # the position counts
    assert target.target_system == 1


def test_sticks_are_centred(line, pilot):
    good_tick(line, pilot, 10.0, 500.0)
    line.sent.clear()
    pilot.send_centred_sticks()
    (sticks,) = line.sent
    assert (sticks.x, sticks.y, sticks.z, sticks.r, sticks.buttons) == (0, 0, 500, 0, 0)


def test_signals_of_the_outputs_are_read(line, pilot):
    assert pilot.read_pwm() == [0] * 16
    values = [1500 + n for n in range(16)]
    line.say(dialect.MAVLink_servo_output_raw_message(1, 0, *values))
    pilot.tick(1.0)
    assert pilot.read_pwm() == values
