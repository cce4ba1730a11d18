"""A vehicle that speaks MAVLink over UDP: pymavlink's codec, and a point that moves.

It follows position targets in GUIDED at once, and knows nothing of the package. Faults are played
by its attributes. It lives by a clock of the tests, which goes on while somebody sleeps: no result
depends on how busy the machine is.
"""

import math
import socket

from pymavlink.dialects.v20 import ardupilotmega as mav

PERIOD_S = 0.02
GOOD, NO_POSITION = 831, 167
LAT_E7, LON_E7 = 476_000_000, -1_223_000_000


class PlayedClock:
    """A clock that goes on by sleeping, and the vehicles that live meanwhile."""

    def __init__(self):
        self.time_s, self.vehicles = 50.0, []

    def __call__(self):
        return self.time_s

    def sleep(self, seconds):
        end_s = self.time_s + seconds
        while self.time_s < end_s:
            self.time_s = min(self.time_s + PERIOD_S / 2, end_s)
            for vehicle in self.vehicles:
                vehicle.live()


class FakeVehicle:
    """One vehicle that sends to a port.

    Attributes:
        silent, blind, frozen, no_numbers, stuck: faults, from now on.
        refuses: commands that it refuses.
        heard: messages that it received, by name.
    """

    def __init__(
        self, port, clock, sysid=1, kind=12, autopilot=3, start=(0.0, 0.0, 3.0), lon=LON_E7
    ):
        self.sysid, self.kind, self.autopilot = sysid, kind, autopilot
        self.position, self.lon = list(start), lon
        self.mode, self.armed, self.origin = 19, False, True
        self.silent = self.blind = self.frozen = self.no_numbers = self.stuck = False
        self.refuses, self.heard = set(), {}
        self.clock, self._due_s = clock, clock()
        self._stamp_ms, self._began_s = 10_000, clock() - 10.0
        self.codec = mav.MAVLink(None, srcSystem=sysid, srcComponent=1)
        self.codec.robust_parsing = True
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", port))
        self.socket.setblocking(False)

    def close(self):
        self.socket.close()

    def reboot(self):
        self._began_s = self.clock()

    def count(self, name):
        return len(self.heard.get(name, []))

    def say(self, message):
        if not self.silent:
            try:
                self.socket.send(message.pack(self.codec))
            except ConnectionError:
                return

    def live(self):
        """Receive what has come, and speak if it is time."""
        try:
            while True:
                for message in self.codec.parse_buffer(self.socket.recv(65536)) or ():
                    self._hear(message)
        except (BlockingIOError, ConnectionError):
            pass
        if self.clock() >= self._due_s:
            self._due_s = self.clock() + PERIOD_S
            self._speak()

    def _speak(self):
        if not self.frozen:
            self._stamp_ms = round(1e3 * (self.clock() - self._began_s))
        self.say(
            mav.MAVLink_heartbeat_message(
                self.kind, self.autopilot, 128 * self.armed, self.mode, 4, 3
            )
        )
        self.say(
            mav.MAVLink_ekf_status_report_message(
                NO_POSITION if self.blind else GOOD, 0.1, 0.1, 0.1, 0.1, 0.1
            )
        )
        x, y, z = [math.nan] * 3 if self.no_numbers else self.position
        self.say(mav.MAVLink_local_position_ned_message(self._stamp_ms, x, y, z, 0, 0, 0))
        self.say(mav.MAVLink_attitude_quaternion_message(self._stamp_ms, 1, 0, 0, 0, 0, 0, 0))
        self.say(mav.MAVLink_servo_output_raw_message(0, 0, *[1500] * 8))

    def _hear(self, message):
        name = message.get_type()
        self.heard.setdefault(name, []).append(message)
        if name == "SET_POSITION_TARGET_LOCAL_NED":
            if self.armed and self.mode == 4 and not self.stuck:
                self.position = [message.x, message.y, message.z]
        elif name == "SET_GPS_GLOBAL_ORIGIN":
            self.origin = True
        elif name == "COMMAND_LONG":
            self._obey(message)

    def _obey(self, message):
        command = message.command
        if command in self.refuses:
            self.say(mav.MAVLink_statustext_message(2, b"PreArm: water in the hull"))
            self.say(mav.MAVLink_command_ack_message(command, mav.MAV_RESULT_FAILED))
            return
        if command == mav.MAV_CMD_DO_SET_MODE:
            self.mode = round(message.param2)
        elif command == mav.MAV_CMD_COMPONENT_ARM_DISARM:
            self.armed = bool(message.param1)
        elif command == mav.MAV_CMD_REQUEST_MESSAGE and self.origin and message.param1 == 49:
            self.say(mav.MAVLink_gps_global_origin_message(LAT_E7, self.lon, 0))
        self.say(mav.MAVLink_command_ack_message(command, mav.MAV_RESULT_ACCEPTED))
