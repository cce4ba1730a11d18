"""The MAVLink half of the stand-in autopilot: parameters, modes, arming, streams, EKF origin."""

import contextlib
import math
import socket

from pymavlink.dialects.v20 import ardupilotmega as mav

ARMABLE_S, ORIGIN_S, POSITION_S = 2.1, 3.0, 4.8
AUTO = 3
NEEDS_POSITION = (3, 4, 7, 9, 16)
STREAMS = (
    "EKF_STATUS_REPORT",
    "LOCAL_POSITION_NED",
    "ATTITUDE",
    "ATTITUDE_QUATERNION",
    "SYS_STATUS",
)


class Line:
    """A serial line: `udpclient:HOST:PORT`, or TCP that waits for somebody to connect."""

    def __init__(self, device, port):
        kind, *rest = device.split(":")
        self._tcp, self.parser = kind == "tcp", mav.MAVLink(None)
        self.parser.robust_parsing = True
        self.socket = None
        if kind == "udpclient":
            self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self.socket.connect((rest[0], int(rest[1])))
        elif self._tcp:
            with socket.create_server(("127.0.0.1", port)) as server:
                print(f"Waiting for connection on port {port} ....", flush=True)
                self.socket, _ = server.accept()
        if self.socket is not None:
            self.socket.setblocking(False)

    def send(self, data):
        with contextlib.suppress(OSError):  # nobody listens: to UDP that is all the same
            self.socket.send(data)

    def messages(self):
        while self.socket is not None:
            try:
                data = self.socket.recv(65536)
            except OSError:
                return
            if not data:
                return
            yield from self.parser.parse_buffer(data) or ()


class Talk:
    """What it says and hears on its two serial lines.

    Args:
        parameters: By name; PARAM_SET changes them.
        lines: SERIAL0 and SERIAL1.
        reboot: Called when it is told to reboot.
    """

    def __init__(self, parameters, lines, reboot):
        self.parameters, (self.serial0, self.serial1), self.reboot = parameters, lines, reboot
        self.armed, self.mode, self.origin, self.saw_vision_s = False, 19, None, None
        self.override, self.asked, self.due, self.to_send = [0] * 18, {}, {}, []
        self.mission, self.mission_count, self.home, self.reached = [], 0, None, 0
        self.age_s = self.time_s = 0.0
        self.state = {}
        self.out = mav.MAVLink(None, srcSystem=int(parameters["SYSID_THISMAV"]), srcComponent=1)

    def step(self, age_s, time_s, state):
        """One step of its clock: since it booted, and physics'."""
        self.age_s, self.time_s, self.state = age_s, time_s, state
        for message in self.serial1.messages():
            self._receive(message)
        for message in self.serial0.messages():
            self._receive(message)
        self._every("HEARTBEAT", 1.0, self._heartbeat)
        for name, interval_s in list(self.asked.items()):
            self._every(name, interval_s, lambda name=name: self._stream(name))
        if self.mode == AUTO and 0 < self.reached < len(self.mission):
            self._every("MISSION", 1.0, self._reach)
        for _ in range(min(20, len(self.to_send))):
            self._send(self.to_send.pop(0))
        # The second line says where it is to be found, as ArduSub's does.
        if self.serial1.socket is not None:
            hello = self._heartbeat_message().pack(self.out)
            self._every("SERIAL1", 1.0, lambda: self.serial1.send(hello))

    def _every(self, name, interval_s, act):
        if self.age_s >= self.due.get(name, 0.0):
            self.due[name] = self.age_s + interval_s
            act()

    def _send(self, message):
        self.serial0.send(message.pack(self.out))
        self.out.seq = (self.out.seq + 1) % 256

    def _say(self, text, severity=2):
        self._send(mav.MAVLink_statustext_message(severity, text.encode()))

    def _heartbeat_message(self):
        base = mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (128 if self.armed else 0)
        return mav.MAVLink_heartbeat_message(mav.MAV_TYPE_SUBMARINE, 3, base, self.mode, 4, 3)

    def _heartbeat(self):
        self._send(self._heartbeat_message())

    @property
    def ready(self):
        if self.parameters.get("STANDIN_NO_EKF") or self.origin is None or self.age_s < POSITION_S:
            return False
        return self.saw_vision_s is not None and self.age_s - self.saw_vision_s < 1.0

    def _stream(self, name):
        p, v, q = (self.state[key] for key in ("position", "velocity", "quaternion"))
        now = int(self.time_s * 1e3) & 0xFFFFFFFF
        rates, angles = self.state["gyro"], _euler(q)
        if name == "EKF_STATUS_REPORT":
            flags = 831 if self.ready else (167 if self.age_s > ARMABLE_S else 1024)
            self._send(mav.MAVLink_ekf_status_report_message(flags, 0.01, 0.01, 0.01, 0.01, 0.0))
        elif name == "LOCAL_POSITION_NED" and self.ready:
            self._send(mav.MAVLink_local_position_ned_message(now, *p[:3], *v[:3]))
        elif name == "ATTITUDE":
            self._send(mav.MAVLink_attitude_message(now, *angles, *rates))
        elif name == "ATTITUDE_QUATERNION":
            self._send(mav.MAVLink_attitude_quaternion_message(now, *q, *rates))
        elif name == "SYS_STATUS":
            self._send(mav.MAVLink_sys_status_message(0, 0, 0, 0, 12600, 0, 100, 0, 0, 0, 0, 0, 0))

    def _receive(self, message):
        kind = message.get_type()
        if kind == "PARAM_REQUEST_LIST":
            self.to_send += [self._parameter(i) for i in range(len(self.parameters))]
        elif kind == "PARAM_REQUEST_READ":
            names = list(self.parameters)
            name = message.param_id if message.param_index < 0 else names[message.param_index]
            if name in names:
                self.to_send.append(self._parameter(names.index(name)))
        elif kind == "PARAM_SET" and message.param_id in self.parameters:
            self.parameters[message.param_id] = message.param_value
            self.to_send.append(self._parameter(list(self.parameters).index(message.param_id)))
        elif kind == "COMMAND_LONG":
            self._send(mav.MAVLink_command_ack_message(message.command, self._command(message)))
        elif kind == "COMMAND_INT" and message.command == mav.MAV_CMD_DO_SET_HOME:
            self.home = (message.x, message.y, message.z)
            self._send(mav.MAVLink_command_ack_message(message.command, 0))
        elif kind == "MISSION_COUNT":
            self.mission, self.mission_count, self.reached = [], message.count, 1
            self._send(mav.MAVLink_mission_request_int_message(255, 190, 0))
        elif kind == "MISSION_ITEM_INT" and message.seq == len(self.mission):
            self.mission.append(message)
            if len(self.mission) < self.mission_count:
                next_request = mav.MAVLink_mission_request_int_message(255, 190, len(self.mission))
                self._send(next_request)
            else:
                self._send(mav.MAVLink_mission_ack_message(255, 190, 0))
        elif kind == "SET_GPS_GLOBAL_ORIGIN" and self.age_s >= ORIGIN_S and self.origin is None:
            self.origin = (message.latitude, message.longitude, message.altitude)
            self._send(mav.MAVLink_gps_global_origin_message(*self.origin))
        elif kind == "VISION_POSITION_ESTIMATE":
            self.saw_vision_s = self.age_s
        elif kind == "RC_CHANNELS_OVERRIDE" and message.get_srcSystem() == 255:
            self.override = [getattr(message, f"chan{n}_raw") for n in range(1, 19)]

    def _reach(self):
        self._send(mav.MAVLink_mission_item_reached_message(self.reached))
        self.reached += 1

    def _parameter(self, index):
        name, value = list(self.parameters.items())[index]
        return mav.MAVLink_param_value_message(
            name.encode(), value, mav.MAV_PARAM_TYPE_REAL32, len(self.parameters), index
        )

    def _command(self, message):
        accepted, failed, unsupported = 0, 4, 3
        if message.command == mav.MAV_CMD_COMPONENT_ARM_DISARM:
            return self._arm(message.param1 > 0.5)
        if message.command == mav.MAV_CMD_DO_SET_MODE:
            if int(message.param2) in NEEDS_POSITION and not self.ready:
                self._say("Mode change failed: requires position")
                return failed
            self.mode = int(message.param2)
            self._heartbeat()
            return accepted
        if message.command == mav.MAV_CMD_SET_MESSAGE_INTERVAL:
            names = {mav.mavlink_map[i].msgname: i for i in mav.mavlink_map}
            for name in STREAMS:
                if names[name] == int(message.param1):
                    self.asked[name] = message.param2 * 1e-6
                    return accepted
            return failed
        if message.command == mav.MAV_CMD_REQUEST_MESSAGE and int(message.param1) == 148:
            version = (4 << 24) | (6 << 16)
            self._send(
                mav.MAVLink_autopilot_version_message(
                    0, version, 0, 0, 0, b"standin0", bytes(8), bytes(8), 0, 0, 0
                )
            )
            return accepted
        if message.command == mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN:
            self._send(mav.MAVLink_command_ack_message(message.command, accepted))
            self.reboot()
        return unsupported

    def _arm(self, wanted):
        if wanted and (self.age_s < ARMABLE_S or self.parameters.get("STANDIN_NO_ARM")):
            self._say("Arm: Battery 1 unhealthy")
            return 4
        self.armed = wanted
        self._heartbeat()
        return 0


def _euler(q):
    w, x, y, z = q
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    return roll, pitch, math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
