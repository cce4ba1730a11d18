"""Real ArduSub as another person starts it: the firmware's own physics and GPS, no lock-step.

Nothing of the package is used here. A process boots ten times faster than the clock, and is handed
over once its filter has a position and its speed is that of the clock.
"""

import math
import signal
import socket
import subprocess
import time

from pymavlink.dialects.v20 import ardupilotmega as mav

LOOPBACK = "127.0.0.1"
BOOT_SPEED = 10
BOOT_S = 60.0
LAT, LON = 47.6, -122.3

PARAMETERS = """
FRAME_CONFIG 2
EK3_SRC1_POSZ 3
EK3_SRC1_VELZ 3
FS_GCS_ENABLE 2
LOG_BACKEND_TYPE 0
"""


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((LOOPBACK, 0))
        return probe.getsockname()[1]


class ExternalArduSub:
    """A process that sends MAVLink to a port, which is free once it is handed over."""

    def __init__(self, binary, folder, sysid=1, port=None, parameters=""):
        folder.mkdir(parents=True, exist_ok=True)
        self.port, self.sysid = port or free_port(), sysid
        self.second_port = free_port()  # of somebody else's ground station
        (folder / "its.parm").write_text(PARAMETERS + parameters)
        self._held = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)  # its radio control port
        self._held.bind((LOOPBACK, 0))
        words = ["--model", "vectored_6dof", "--home", f"{LAT},{LON},0,0", "--wipe"]
        words += ["--defaults", "its.parm", "--speedup", str(BOOT_SPEED), "--sysid", str(sysid)]
        words += ["--sim-address", LOOPBACK, "--rc-in-port", str(self._held.getsockname()[1])]
        words += ["--serial0", f"udpclient:{LOOPBACK}:{self.port}"]
        words += ["--serial1", f"udpclient:{LOOPBACK}:{self.second_port}", "--serial2", "none:"]
        with (folder / "output.log").open("w") as log:
            self.process = subprocess.Popen(
                [str(binary), *words], cwd=folder, stdout=log, stderr=subprocess.STDOUT
            )
        try:
            self._hand_over()
        except BaseException:
            self.close()
            raise

    def freeze(self):
        self.process.send_signal(signal.SIGSTOP)

    def thaw(self):
        self.process.send_signal(signal.SIGCONT)

    def close(self):
        self.process.kill()
        self.process.wait()
        self._held.close()

    def _hand_over(self):
        with Station(self.port, self.sysid) as station:
            station.ask_for("LOCAL_POSITION_NED")
            station.ask_for("EKF_STATUS_REPORT")
            station.wait(lambda: station.latest["EKF_STATUS_REPORT"].flags & 16, BOOT_S)
            station.set_parameter("SIM_SPEEDUP", 1.0)


class Station:
    """A ground station: pymavlink's codec on a UDP port that vehicles send to."""

    def __init__(self, port, sysid=1, number=255):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((LOOPBACK, port))
        self.socket.settimeout(0.05)
        self.codec = mav.MAVLink(None, srcSystem=number, srcComponent=190)
        self.codec.robust_parsing = True
        self.sysid, self.peer, self.latest = sysid, None, {}

    def __enter__(self):
        return self

    def __exit__(self, *ended):
        self.socket.close()

    def take(self):
        try:
            data, source = self.socket.recvfrom(65536)
        except TimeoutError:
            return
        for message in self.codec.parse_buffer(data) or ():
            if message.get_srcSystem() == self.sysid:
                self.peer = source
                self.latest[message.get_type()] = message

    def renew(self):
        """Forget everything that was sent so far."""
        self.socket.setblocking(False)
        try:
            while True:
                self.socket.recvfrom(65536)
        except BlockingIOError:
            self.socket.settimeout(0.05)
        self.latest.clear()

    def send(self, message):
        self.socket.sendto(message.pack(self.codec), self.peer)

    def wait(self, condition, limit_s, each=lambda: None):
        end = time.monotonic() + limit_s
        while time.monotonic() < end:
            self.take()
            each()
            try:
                if condition():
                    return
            except KeyError:
                continue
        raise AssertionError(f"not within {limit_s:g} s; heard {sorted(self.latest)}")

    def command(self, number, *parameters):
        padded = (*parameters, *[0.0] * (7 - len(parameters)))
        self.send(mav.MAVLink_command_long_message(self.sysid, 1, number, 0, *padded))

    def ask_for(self, name, rate_hz=10.0):
        self.wait(lambda: self.peer, BOOT_S)
        number = getattr(mav, f"MAVLINK_MSG_ID_{name}")
        self.command(mav.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 / rate_hz)

    def set_parameter(self, name, value):
        def send():
            self.send(
                mav.MAVLink_param_set_message(
                    self.sysid, 1, name.encode(), value, mav.MAV_PARAM_TYPE_REAL32
                )
            )

        def is_set():
            answer = self.latest["PARAM_VALUE"]
            return answer.param_id == name and math.isclose(answer.param_value, value)

        self.wait(is_set, 5.0, send)
