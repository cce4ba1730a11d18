"""Probe: one autopilot, run for a few seconds in still water, to be queried.

Lock-step is held with the simplest physics: at rest, level, at the origin. It runs at the
autopilot's max speed, so a boot of seconds takes a fraction of one.
"""

import contextlib
import struct
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from angler_mjx.errors import AnglerError, ConfigError, RunError
from angler_sitl.firmware.binary import UNKNOWN_VERSION, Binary
from angler_sitl.firmware.process import AutopilotProcess, LaunchSpec
from angler_sitl.wire.ports import Ports, allocate_ports

_DT_S = 1 / 400
_SILENCE_S = 10.0
"""Wall time without a servo packet after which the autopilot counts as hanging.

It repeats a packet after 1.1 s, and a busy machine starts a program slowly."""
_LOOK_S = 0.1
"""Wall time between checks whether the process still runs."""
_BOOT_S = 2.0
"""Autopilot clock at which it answers all requests; its setup ends after 1.75 s."""
_LIMIT_S = 30.0
"""Limit of the autopilot clock for all answers: 1300 parameters take 2."""
_AT_REST = (
    '\n{{"timestamp":{:.6f},"imu":{{"gyro":[0,0,0],"accel_body":[0,0,-9.80665]}},'
    '"position":[0,0,0],"quaternion":[1,0,0,0],"velocity":[0,0,0],"no_time_sync":1}}\n'
)
_GCS, _COMPONENT = 255, 190
VERSION_MESSAGE_ID = 148
"""Number of the message AUTOPILOT_VERSION."""


@dataclass(frozen=True, kw_only=True)
class ProbeResult:
    """Answers of an autopilot.

    Attributes:
        version: As in "4.6.0-dev".
        git: First characters of the commit it was built from.
        parameters: All of them, by name.
        sysid: Its MAVLink system number.
        parameter_types: MAV_PARAM_TYPE of each parameter, by name.
    """

    version: str
    git: str
    parameters: Mapping[str, float]
    sysid: int
    parameter_types: Mapping[str, int] = field(default_factory=dict)


@dataclass
class StationaryAutopilot:
    """Stationary autopilot, with its received messages.

    Attributes:
        instance: The process.
        ports: Its sockets.
        time_s: Its clock.
        pwm: Values of the last servo packet.
        version: AUTOPILOT_VERSION, if received.
        parameters: Received parameters, by name.
        parameter_types: MAV_PARAM_TYPE of each.
        expected: Number of parameters; 0 while unknown.
        sysid: System number of the heartbeats; 0 while unknown.
    """

    instance: AutopilotProcess
    ports: Ports
    time_s: float = 0.0
    pwm: tuple[int, ...] = ()
    version: mavlink.MAVLink_message | None = None
    parameters: dict[str, float] = field(default_factory=dict)
    parameter_types: dict[str, int] = field(default_factory=dict)
    parameter_count: int = 0
    sysid: int = 0

    def __post_init__(self) -> None:
        self._mavlink = mavlink.MAVLink(None, srcSystem=_GCS, srcComponent=_COMPONENT)
        self._mavlink.robust_parsing = True
        self._peer: tuple[str, int] | None = None
        self.ports.fdm.settimeout(_LOOK_S)
        self.ports.mavlink.setblocking(False)

    def step_until(self, condition: Callable[[], bool], limit_s: float) -> bool:
        """Step until ``condition`` holds or the time limit of its clock; return whether it holds.

        Raises:
            RunError: the process ended or sends nothing.
        """
        end = self.time_s + limit_s
        while not condition():
            if self.time_s >= end:
                return False
            self._exchange_packets()
            self._receive_messages()
        return True

    def send(self, message: mavlink.MAVLink_message) -> None:
        """Send a MAVLink message, if the autopilot's address is known."""
        if self._peer is not None:
            data = message.pack(self._mavlink)
            self._mavlink.seq = (self._mavlink.seq + 1) % 256
            self.ports.mavlink.sendto(data, self._peer)

    def _exchange_packets(self) -> None:
        packet, peer = self._receive_packet()
        if len(packet) >= 40:
            self.pwm = struct.unpack_from("<16H", packet, 8)
        self.time_s += _DT_S
        self.ports.fdm.sendto(_AT_REST.format(self.time_s).encode(), peer)

    def _receive_packet(self) -> tuple[bytes, tuple[str, int]]:
        """Return the next servo packet and its source address."""
        for _ in range(round(_SILENCE_S / _LOOK_S)):
            with contextlib.suppress(TimeoutError):
                return self.ports.fdm.recvfrom(256)
            if fault := self.instance.fault():
                raise RunError(fault)
        raise RunError(f"no servo packet for {_SILENCE_S:g} s: {self.instance.condition()}")

    def _receive_messages(self) -> None:
        while True:
            try:
                data, self._peer = self.ports.mavlink.recvfrom(65536)
            except BlockingIOError:
                return
            for message in self._mavlink.parse_buffer(data) or ():
                self._handle_message(message)

    def _handle_message(self, message: mavlink.MAVLink_message) -> None:
        kind = message.get_type()
        if kind == "HEARTBEAT":
            self.sysid = message.get_srcSystem()
        elif kind == "AUTOPILOT_VERSION":
            self.version = message
        elif kind == "PARAM_VALUE":
            self.parameters[message.param_id] = message.param_value
            self.parameter_types[message.param_id] = int(message.param_type)
            self.parameter_count = message.param_count


@contextlib.contextmanager
def start_stationary(
    binary: Binary, folder: Path, parameters: Mapping[str, float]
) -> Iterator[StationaryAutopilot]:
    """Start an autopilot, step it until it has set up, and close it afterwards.

    Raises:
        RunError: it does not start, ends, hangs, or sends no heartbeat.
    """
    (ports,) = allocate_ports(1)
    launch = LaunchSpec(
        binary=binary, folder=folder, name="probe", sysid=1, ports=ports, parameters=parameters
    )
    try:
        with AutopilotProcess(launch) as instance:
            autopilot = StationaryAutopilot(instance, ports)
            autopilot.step_until(lambda: autopilot.time_s >= _BOOT_S, _LIMIT_S)
            if not autopilot.step_until(lambda: autopilot.sysid > 0, _LIMIT_S):
                raise RunError(f"no MAVLink heartbeat: {instance.condition()}")
            yield autopilot
    finally:
        ports.close()


def query_autopilot(autopilot: StationaryAutopilot, *, parameters: bool = True) -> ProbeResult:
    """Request the version and, if wanted, all parameters.

    Raises:
        RunError: it does not answer.
    """
    _request_until(
        autopilot, lambda: autopilot.version is not None, _request_version, "its version"
    )
    if parameters:
        _request_until(
            autopilot,
            lambda: 0 < autopilot.parameter_count <= len(autopilot.parameters),
            _request_parameters,
            "parameters",
        )
    version, git = read_version(autopilot.version)
    return ProbeResult(
        version=version,
        git=git,
        parameters=dict(autopilot.parameters),
        parameter_types=dict(autopilot.parameter_types),
        sysid=autopilot.sysid,
    )


def read_version(message: mavlink.MAVLink_message) -> tuple[str, str]:
    """Return version, as in "4.5.3" or "4.6.0-dev", and commit of an AUTOPILOT_VERSION message.

    ``flight_sw_version`` holds major, minor and patch number and ``FIRMWARE_VERSION_TYPE``, a byte
    each, ``flight_custom_version`` the first 8 characters of the commit.
    """
    number = int(message.flight_sw_version)
    parts = ".".join(str(number >> shift & 0xFF) for shift in (24, 16, 8))
    kind = {0: "-dev", 64: "-alpha", 128: "-beta", 192: "-rc", 255: ""}.get(number & 0xFF, "")
    git = bytes(message.flight_custom_version).decode("ascii", "replace").strip("\0")
    return parts + kind, git


def identify_version(binary: Binary) -> Binary:
    """Return a program with its reported version, where no record holds it.

    Raises:
        ConfigError: it does not answer as an ArduSub.
    """
    if binary.version != UNKNOWN_VERSION:
        return binary
    with tempfile.TemporaryDirectory(prefix="angler_sitl_") as folder:
        try:
            with start_stationary(binary, Path(folder), {}) as autopilot:
                return replace(binary, version=query_autopilot(autopilot, parameters=False).version)
        except AnglerError as error:
            raise ConfigError(
                f"{binary.path}: does not state its version as an ArduSub does: {error}"
            ) from error


def _request_until(
    autopilot: StationaryAutopilot,
    condition: Callable[[], bool],
    request: Callable[[StationaryAutopilot], None],
    subject: str,
) -> None:
    # UDP drops packets on a full buffer, so the request is repeated, by the autopilot's clock.
    for _ in range(3):
        request(autopilot)
        if autopilot.step_until(condition, _LIMIT_S / 3):
            return
    raise RunError(f"no answer to the question for {subject}: {autopilot.instance.condition()}")


def _request_version(autopilot: StationaryAutopilot) -> None:
    command = mavlink.MAV_CMD_REQUEST_MESSAGE
    autopilot.send(
        mavlink.MAVLink_command_long_message(
            autopilot.sysid, 1, command, 0, VERSION_MESSAGE_ID, *[0.0] * 6
        )
    )


def _request_parameters(autopilot: StationaryAutopilot) -> None:
    autopilot.send(mavlink.MAVLink_param_request_list_message(autopilot.sysid, 1))
