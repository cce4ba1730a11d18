"""A vehicle in a thread that speaks MAVLink over UDP: pymavlink's codec, and a point that moves.

It follows position targets in GUIDED at once, and knows nothing of the package. Faults are played
by its attributes.
"""

import math
import socket
import threading
import time

from pymavlink.dialects.v20 import ardupilotmega as mav

PERIOD_S = 0.02
GOOD, NO_POSITION = 831, 167
LAT_E7, LON_E7 = 476_000_000, -1_223_000_000


class FakeVehicle:
    """One vehicle that sends to a port.

    Attributes:
        silent, blind, frozen, no_numbers, stuck: faults, from now on.
        refuses: commands that it refuses.
        heard: messages that it received, by name.
    """

    def __init__(self, port, sysid=1, kind=12, autopilot=3, start=(0.0, 0.0, 3.0), lon=LON_E7):
        self.sysid, self.kind, self.autopilot = sysid, kind, autopilot
        self.position, self.lon = list(start), lon
        self.mode, self.armed, self.origin = 19, False, True
        self.silent = self.blind = self.frozen = self.no_numbers = self.stuck = False
        self.refuses, self.heard = set(), {}
        self._stamp_ms, self._began_s = 10_000, time.monotonic() - 10.0
        self.codec = mav.MAVLink(None, srcSystem=sysid, srcComponent=1)
        self.codec.robust_parsing = True
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(("127.0.0.1", port))
        self.socket.settimeout(PERIOD_S)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self):
        self._ended.set()
        self._thread.join(5.0)
        self.socket.close()

    def reboot(self):
        self._began_s = time.monotonic()

    def count(self, name):
        return len(self.heard.get(name, []))

    def say(self, message):
        if not self.silent:
            try:
                self.socket.send(message.pack(self.codec))
            except ConnectionError:
                return

    def _run(self):
        due = time.monotonic()
        while not self._ended.is_set():
            try:
                data = self.socket.recv(65536)
            except (TimeoutError, ConnectionError):
                data = b""
            for message in self.codec.parse_buffer(data) or ():
                self._hear(message)
            if time.monotonic() >= due:
                due = time.monotonic() + PERIOD_S
                self._speak()

    def _speak(self):
        if not self.frozen:
            self._stamp_ms = round(1e3 * (time.monotonic() - self._began_s))
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
