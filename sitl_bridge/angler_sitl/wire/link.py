"""MAVLink 2 with one autopilot over a UDP socket of our own, paced by the scene's clock.

The autopilot receives our port and sends first; replies go to the source of its packets, which may
be another port after a restart. Nothing here blocks: `MavlinkLink.receive` takes the packets that
have arrived, and the caller looks again one control period later. Every packet, in and out, goes
through a tap: a `TelemetryLog`, or a ground station that listens along.
"""

import struct
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from pymavlink.dialects.v20 import ardupilotmega as dialect

from angler_mjx.runs.storage.atomic_files import wrap_write_errors

type MavlinkMessage = dialect.MAVLink_message
"""Message of the dialect; its package has no types."""
type PacketTap = Callable[[bytes, float], None]
"""Receiver of each packet, in and out, with the scene's time, s."""

GROUND_STATION = 255
"""Our system number: commands of a pilot are accepted from no other."""
TLOG_NAME = "mavlink.tlog"
"""File name of a telemetry log."""

_COMPONENT = dialect.MAV_COMP_ID_MISSIONPLANNER
_AUTOPILOT = dialect.MAV_COMP_ID_AUTOPILOT1
_HEARTBEAT_S = 1.0
_MAX_PACKET_BYTES = 65_536
_MAX_TEXTS = 50
"""Max number of kept status texts of an autopilot."""


class DatagramSocket(Protocol):
    """Socket of datagrams, or what stands in for one; nothing blocks."""

    def setblocking(self, flag: bool, /) -> None:
        """Block in calls or not."""
        ...

    def recvfrom(self, bufsize: int, /) -> tuple[bytes, Any]:
        """Return a datagram and its source; BlockingIOError if there is none."""
        ...

    def sendto(self, data: bytes, address: Any, /) -> int:
        """Send a datagram."""
        ...


@dataclass(frozen=True, kw_only=True)
class StatusText:
    """Status text of an autopilot."""

    time_s: float
    severity: int
    """Severity as in syslog: 0 emergency to 7 debug."""
    text: str


class MavlinkLink:
    """MAVLink connection of one autopilot.

    Attributes:
        name: of the robot, for messages.
        sysid: its system number.
        latest: its latest message of each kind, by the message's name.
        texts: its status texts, oldest first.
        parameters: received values by name.
        parameter_count: number of its parameters; 0 until reported.
        parameter_indices: numbers of the received parameters.
        reached: numbers of mission items that it completed, in order, each with the scene's time.
        acks: result of the latest acknowledgement of each command, by the command's number.
        listeners: receivers of each packet of its autopilot.
    """

    def __init__(
        self, bound: DatagramSocket, *, name: str, sysid: int, tap: PacketTap | None = None
    ) -> None:
        """Take over a bound socket; it is not closed here."""
        bound.setblocking(False)
        self._socket, self._tap = bound, tap
        self._mav = dialect.MAVLink(self, srcSystem=GROUND_STATION, srcComponent=_COMPONENT)
        self._mav.robust_parsing = True
        self._peer: object | None = None
        self._time_s, self._beat_s = 0.0, -_HEARTBEAT_S
        self.name, self.sysid = name, sysid
        self.latest: dict[str, MavlinkMessage] = {}
        self.texts: deque[StatusText] = deque(maxlen=_MAX_TEXTS)
        self.parameters: dict[str, float] = {}
        self.parameter_count = 0
        self.parameter_indices: set[int] = set()
        self.reached: list[tuple[int, float]] = []
        self.acks: dict[int, int] = {}
        self.listeners: list[Callable[[bytes], None]] = []

    @property
    def has_peer(self) -> bool:
        """Whether a packet has come; before that the destination is unknown."""
        return self._peer is not None

    def tick(self, time_s: float) -> None:
        """Receive packets, and send a heartbeat if one is due by the scene's clock."""
        self.receive(time_s)
        if self.has_peer and time_s >= self._beat_s + _HEARTBEAT_S:
            self._beat_s = time_s
            self.send(
                dialect.MAVLink_heartbeat_message(
                    dialect.MAV_TYPE_GCS,
                    dialect.MAV_AUTOPILOT_INVALID,
                    base_mode=0,
                    custom_mode=0,
                    system_status=dialect.MAV_STATE_ACTIVE,
                    mavlink_version=3,
                )
            )

    def receive(self, time_s: float) -> None:
        """Receive the packets that have arrived.

        Args:
            time_s: current scene time; packets sent until the next call bear it in the log.
        """
        self._time_s = time_s
        while True:
            try:
                data, sender = self._socket.recvfrom(_MAX_PACKET_BYTES)
            except BlockingIOError:
                return
            except ConnectionError:  # a packet of ours came to a port that is closed
                continue
            for message in self._mav.parse_buffer(data) or ():
                if message.get_srcSystem() == self.sysid and self._is_accepted(message):
                    self._peer = sender
                    self._handle_message(message)

    def send(self, message: MavlinkMessage) -> None:
        """Send a message; it is lost if the autopilot has sent nothing yet."""
        self._mav.send(message)

    def write(self, packet: bytes) -> None:
        """Write an encoded packet; called by the codec."""
        if self._peer is None:
            return
        try:
            self._socket.sendto(packet, self._peer)
        except (BlockingIOError, ConnectionError):
            return  # as if lost in transit: UDP gives no guarantee
        if self._tap is not None:
            self._tap(bytes(packet), self._time_s)

    def command(self, number: int, *parameters: float) -> None:
        """Send a command and clear its earlier acknowledgement.

        Args:
            number: a ``MAV_CMD``.
            parameters: up to seven; 0 where left out.
        """
        self.acks.pop(number, None)
        padded = (*parameters, *(0.0,) * (7 - len(parameters)))
        self.send(dialect.MAVLink_command_long_message(self.sysid, _AUTOPILOT, number, 0, *padded))

    def request_stream(self, message: int, rate_hz: float) -> None:
        """Request a message type at a rate of the autopilot's clock."""
        self.command(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, message, 1e6 / rate_hz)

    def request_parameters(self) -> None:
        """Request all parameters."""
        self.send(dialect.MAVLink_param_request_list_message(self.sysid, _AUTOPILOT))

    def request_parameter(self, index: int) -> None:
        """Request one parameter by its number."""
        self.send(dialect.MAVLink_param_request_read_message(self.sysid, _AUTOPILOT, b"", index))

    def format_last_texts(self, count: int = 3) -> str:
        """Return the last status texts, for the report of a failure."""
        return "; ".join(text.text for text in list(self.texts)[-count:])

    def _is_accepted(self, message: MavlinkMessage) -> bool:
        """Return whether to handle a message of the vehicle."""
        return True

    def _handle_message(self, message: MavlinkMessage) -> None:
        if self._tap is not None:
            self._tap(bytes(message.get_msgbuf()), self._time_s)
        for listener in self.listeners:
            listener(bytes(message.get_msgbuf()))
        kind = message.get_type()
        if kind == "HEARTBEAT" and message.get_srcComponent() != _AUTOPILOT:
            return
        self.latest[kind] = message
        if kind == "PARAM_VALUE":
            self.parameters[message.param_id] = float(message.param_value)
            self.parameter_count = message.param_count
            self.parameter_indices.add(message.param_index)
        elif kind == "STATUSTEXT":
            status_text = StatusText(
                time_s=self._time_s, severity=message.severity, text=message.text
            )
            self.texts.append(status_text)
        elif kind == "MISSION_ITEM_REACHED":
            self.reached.append((int(message.seq), self._time_s))
        elif kind == "COMMAND_ACK":
            self.acks[message.command] = message.result


class TelemetryLog:
    """Telemetry log in the format of ground stations: MAVProxy and Mission Planner replay it.

    Each packet stands behind its time: microseconds since 1970, 8 bytes, big-endian. The clock is
    that of the scene, started with the log: it plays at the pace of the scene, at any speed of the
    run. Its `log_packet` is the tap of a link.
    """

    def __init__(self, path: Path) -> None:
        """Create a new file.

        Raises:
            RunError: it cannot be written.
        """
        self._path, self._began_us = path, time.time_ns() // 1000
        with wrap_write_errors(path):
            self._file = path.open("wb")

    def log_packet(self, packet: bytes, time_s: float) -> None:
        """Write a packet at its scene time."""
        self._file.write(struct.pack(">Q", self._began_us + round(time_s * 1e6)) + packet)

    def close(self) -> None:
        """Flush and close the log; a second call has no effect."""
        self._file.close()
