"""MAVLink 2 with one autopilot over a UDP socket of our own, paced by the scene's clock.

The autopilot is told our port and speaks first; answers go to where its packets come from, which
another port may be after it restarted. Nothing here waits: `MavlinkLink.receive` takes what is
there, and whoever steps the scene looks again one control period later. Every packet, in and out,
goes through
a tap: a log (`angler_sitl.wire.tlog`), or a ground station that listens along.
"""

import socket
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

type MavlinkMessage = Any
"""A message of the dialect; its package tells a type checker nothing."""
type PacketTap = Callable[[bytes, float], None]
"""Given each packet, in and out, and the scene's time, s."""

GROUND_STATION = 255
"""Our system number: commands of a pilot are taken from no other."""
_COMPONENT = dialect.MAV_COMP_ID_MISSIONPLANNER
_AUTOPILOT = dialect.MAV_COMP_ID_AUTOPILOT1
_HEARTBEAT_S = 1.0
_MAX_PACKET_BYTES = 65_536
_MAX_TEXTS = 50
"""Last words of an autopilot that are kept."""


@dataclass(frozen=True, kw_only=True)
class StatusText:
    """Something that an autopilot said in words."""

    time_s: float
    severity: int
    """As in syslog: 0 emergency to 7 debug."""
    text: str


class MavlinkLink:
    """One autopilot's MAVLink.

    Attributes:
        name: of the robot, for messages.
        sysid: its system number.
        latest: its latest message of each kind, by the message's name.
        texts: what it said in words, oldest first.
        parameters: values by name, as far as they have come.
        parameter_count: how many it has; 0 until it says.
        parameter_indices: numbers of those that have come.
        acks: result of the latest answer to each command, by the command's number.
        listeners: told of each packet that its autopilot sends.
    """

    def __init__(
        self, bound: socket.socket, *, name: str, sysid: int, tap: PacketTap | None = None
    ) -> None:
        """Take over a socket that is bound already; it is not closed here."""
        bound.setblocking(False)
        self._socket, self._tap = bound, tap
        self._mav = dialect.MAVLink(self, srcSystem=GROUND_STATION, srcComponent=_COMPONENT)
        self._mav.robust_parsing = True
        self._peer: tuple[str, int] | None = None
        self._time_s, self._beat_s = 0.0, -_HEARTBEAT_S
        self.name, self.sysid = name, sysid
        self.latest: dict[str, MavlinkMessage] = {}
        self.texts: deque[StatusText] = deque(maxlen=_MAX_TEXTS)
        self.parameters: dict[str, float] = {}
        self.parameter_count = 0
        self.parameter_indices: set[int] = set()
        self.acks: dict[int, int] = {}
        self.listeners: list[Callable[[bytes], None]] = []

    @property
    def has_peer(self) -> bool:
        """Whether it has sent anything; before that nobody knows where to send to."""
        return self._peer is not None

    def tick(self, time_s: float) -> None:
        """Take what has come, and send a heartbeat if one is due by the scene's clock."""
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
        """Take what has come.

        Args:
            time_s: of the scene, now; what is sent until the next call bears it in the log.
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
                if message.get_srcSystem() == self.sysid:
                    self._peer = sender
                    self._handle_message(message)

    def send(self, message: MavlinkMessage) -> None:
        """Send a message; to an autopilot that was not heard of yet it is lost."""
        self._mav.send(message)

    def write(self, packet: bytes) -> None:
        """What the codec calls with a packet that is ready."""
        if self._peer is None:
            return
        try:
            self._socket.sendto(packet, self._peer)
        except (BlockingIOError, ConnectionError):
            return  # as if it were lost on its way: UDP promises nothing
        if self._tap is not None:
            self._tap(bytes(packet), self._time_s)

    def command(self, number: int, *parameters: float) -> None:
        """Send a command and forget its earlier answer.

        Args:
            number: a ``MAV_CMD``.
            parameters: up to seven; 0 where left out.
        """
        self.acks.pop(number, None)
        padded = (*parameters, *(0.0,) * (7 - len(parameters)))
        self.send(dialect.MAVLink_command_long_message(self.sysid, _AUTOPILOT, number, 0, *padded))

    def request_stream(self, message: int, rate_hz: float) -> None:
        """Ask for a kind of message at a rate of its clock."""
        self.command(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, message, 1e6 / rate_hz)

    def request_parameters(self) -> None:
        """Ask for all of its parameters."""
        self.send(dialect.MAVLink_param_request_list_message(self.sysid, _AUTOPILOT))

    def request_parameter(self, index: int) -> None:
        """Ask for one of its parameters by its number."""
        self.send(dialect.MAVLink_param_request_read_message(self.sysid, _AUTOPILOT, b"", index))

    def format_last_texts(self, count: int = 3) -> str:
        """The last things that it said in words, for the report of a failure."""
        return "; ".join(text.text for text in list(self.texts)[-count:])

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
        elif kind == "COMMAND_ACK":
            self.acks[message.command] = message.result
