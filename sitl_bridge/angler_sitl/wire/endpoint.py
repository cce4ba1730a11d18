"""MAVLink endpoints that a user names: UDP, TCP or a serial line, with one or several vehicles.

Connection strings are those of pymavlink and MAVProxy (``--master``):

| string | meaning |
|---|---|
| `udp:HOST:PORT`, `udpin:HOST:PORT` | listen; vehicles send to this address |
| `udpout:HOST:PORT` | send to this address, and listen to its answers |
| `tcp:HOST:PORT` | connect |
| `/dev/NAME`, `/dev/NAME,BAUD` | serial line; 115200 baud if left out |

An endpoint sorts packets by the system number of their sender. A `VehicleChannel` holds those of
one vehicle, and stands in for a socket of datagrams at its `MavlinkLink`. The
first address that a vehicle sends from is kept: packets of that number from elsewhere are counted.
"""

import contextlib
import os
import socket
import termios
import tty
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, Protocol

from pymavlink.dialects.v20 import ardupilotmega as dialect

from angler_mjx.errors import ConfigError, RunError, format_value
from angler_sitl.wire.link import GROUND_STATION, MavlinkMessage

type EndpointKind = Literal["udpin", "udpout", "tcp", "serial"]
type Source = tuple[str, int]
"""Address that packets come from."""

DEFAULT_BAUD = 115_200
CONNECT_TIMEOUT_S = 5.0
"""Time limit of a TCP connection."""

_MAX_BYTES = 65_536
_MAX_READS = 1_000
"""Max reads of an endpoint at once: a sender that floods it must not hold up the caller."""
_MAX_QUEUE = 2_000
"""Max packets of a vehicle that wait; the oldest are dropped."""
_MAX_SOURCES = 64
"""Max addresses that are listened to: there are no more vehicles than that on an endpoint."""
_COMPONENT = dialect.MAV_COMP_ID_MISSIONPLANNER


@dataclass(frozen=True, kw_only=True)
class EndpointAddress:
    """Address of an endpoint."""

    text: str
    """As the user wrote it."""
    kind: EndpointKind
    host: str
    """Host, or device of a serial line."""
    port: int
    """Port, or baud."""


def parse_endpoint(text: str) -> EndpointAddress:
    """Parse a connection string.

    Raises:
        ConfigError: the text has another form.
    """
    kinds: dict[str, EndpointKind] = {"udp": "udpin", "udpin": "udpin", "udpout": "udpout"}
    kinds["tcp"] = "tcp"
    if text.startswith("/dev/"):
        device, _, baud = text.partition(",")
        number = _parse_number(baud, 10_000_000) if baud else DEFAULT_BAUD
        if number and device != "/dev/":
            return EndpointAddress(text=text, kind="serial", host=device, port=number)
    scheme, _, rest = text.partition(":")
    host, _, port = rest.rpartition(":")
    number = _parse_number(port, 65_535)
    if scheme not in kinds or not host or not number:
        raise ConfigError(
            f"--endpoint {format_value(text)}: give udp:HOST:PORT to listen, udpout:HOST:PORT, "
            "tcp:HOST:PORT, or /dev/NAME,BAUD, as in udp:127.0.0.1:14550"
        )
    return EndpointAddress(text=text, kind=kinds[scheme], host=host, port=number)


def _parse_number(text: str, maximum: int) -> int:
    """Return a number from 1 on; 0 if the text is none."""
    is_plain = text.isascii() and text.isdecimal() and len(text) <= 8
    number = int(text) if is_plain else 0
    return number if number <= maximum else 0


class _Transport(Protocol):
    """Bytes of an endpoint; nothing blocks."""

    destination: Source | None
    """Address to send to before anything is heard; None where nobody is there yet."""

    def read(self) -> tuple[bytes, Source] | None:
        """Return bytes and their source; None if there are none.

        Raises:
            OSError: the connection has ended.
        """
        ...

    def write(self, data: bytes, source: Source) -> None:
        """Send bytes to where others came from.

        Raises:
            OSError: they cannot be sent.
        """
        ...

    def close(self) -> None:
        """Release it."""
        ...


class _UdpTransport:
    def __init__(self, address: EndpointAddress) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.destination: Source | None = None
        try:
            if address.kind == "udpin":
                self._socket.bind((address.host, address.port))
            else:
                self.destination = (socket.gethostbyname(address.host), address.port)
            self._socket.setblocking(False)
        except OSError:
            self._socket.close()
            raise

    def read(self) -> tuple[bytes, Source] | None:
        while True:
            try:
                return self._socket.recvfrom(_MAX_BYTES)
            except BlockingIOError:
                return None
            except ConnectionError:  # a packet came to a port that is closed
                continue

    def write(self, data: bytes, source: Source) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionError):  # UDP gives no guarantee
            self._socket.sendto(data, source)

    def close(self) -> None:
        self._socket.close()


class _TcpTransport:
    def __init__(self, address: EndpointAddress) -> None:
        self.destination: Source | None = (address.host, address.port)
        self._socket = socket.create_connection(
            (address.host, address.port), timeout=CONNECT_TIMEOUT_S
        )
        self._socket.setblocking(False)

    def read(self) -> tuple[bytes, Source] | None:
        try:
            data = self._socket.recv(_MAX_BYTES)
        except BlockingIOError:
            return None
        if not data:
            raise ConnectionResetError("the other end closed the connection")
        return data, self._get_source()

    def write(self, data: bytes, source: Source) -> None:
        # Part of a packet would spoil the next ones: what does not fit is lost as a whole.
        with contextlib.suppress(BlockingIOError):
            if self._socket.send(data) < len(data):
                raise ConnectionResetError("the other end reads too slowly")

    def close(self) -> None:
        self._socket.close()

    def _get_source(self) -> Source:
        assert self.destination is not None
        return self.destination


class _SerialTransport:
    def __init__(self, address: EndpointAddress) -> None:
        speed = getattr(termios, f"B{address.port}", None)
        if speed is None:
            raise ConfigError(
                f"--endpoint {address.text}: no serial line has {address.port} baud; "
                "give 57600, 115200 or 921600, for instance"
            )
        self.destination: Source | None = (address.host, address.port)
        self._line = os.open(address.host, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            tty.setraw(self._line)
            modes = termios.tcgetattr(self._line)
            modes[2] = (modes[2] | termios.CLOCAL | termios.CREAD) & ~termios.CRTSCTS
            modes[4] = modes[5] = speed
            termios.tcsetattr(self._line, termios.TCSANOW, modes)
        except termios.error as error:
            os.close(self._line)
            raise OSError(f"no serial line: {error}") from error

    def read(self) -> tuple[bytes, Source] | None:
        assert self.destination is not None
        try:
            data = os.read(self._line, _MAX_BYTES)
        except BlockingIOError:
            return None
        return (data, self.destination) if data else None

    def write(self, data: bytes, source: Source) -> None:
        with contextlib.suppress(BlockingIOError):
            os.write(self._line, data)

    def close(self) -> None:
        os.close(self._line)


def _open_transport(address: EndpointAddress) -> _Transport:
    if address.kind == "tcp":
        return _TcpTransport(address)
    if address.kind == "serial":
        return _SerialTransport(address)
    return _UdpTransport(address)


class Endpoint:
    """Open endpoint.

    Attributes:
        address: its address.
        fault: why the connection ended; empty while it lives.
        heard: number of packets of each system, by its number.
        kinds: first heartbeat of the autopilot of each system.
        counts: ignored packets: ``bad`` could not be decoded, ``foreign`` are of systems without a
            channel, ``moved`` come from a second address.
    """

    def __init__(self, address: EndpointAddress) -> None:
        """Open the endpoint.

        Raises:
            ConfigError: it cannot be opened.
        """
        self.address, self.fault = address, ""
        self.heard: Counter[int] = Counter()
        self.counts: Counter[str] = Counter()
        self.kinds: dict[int, MavlinkMessage] = {}
        self._channels: dict[int, VehicleChannel] = {}
        self._sources: dict[int, Source] = {}
        self._parsers: dict[Source, dialect.MAVLink] = {}
        self._codec = dialect.MAVLink(None, srcSystem=GROUND_STATION, srcComponent=_COMPONENT)
        try:
            self._transport = _open_transport(address)
        except OSError as error:
            reason = error.strerror or str(error)
            raise ConfigError(f"--endpoint {address.text}: cannot be opened: {reason}") from error

    def open_channel(self, sysid: int) -> "VehicleChannel":
        """Return the channel of a vehicle, by its system number."""
        return self._channels.setdefault(sysid, VehicleChannel(self, sysid))

    def greet(self) -> None:
        """Send a heartbeat to where vehicles are expected, so that they answer to this address."""
        if self._transport.destination is None:
            return
        beat = dialect.MAVLink_heartbeat_message(
            dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID, 0, 0, dialect.MAV_STATE_ACTIVE, 3
        )
        self.write(bytes(beat.pack(self._codec)), self._transport.destination)

    def poll(self) -> None:
        """Take the packets that have arrived, and sort them."""
        for _ in range(_MAX_READS):
            try:
                arrived = None if self.fault else self._transport.read()
            except OSError as error:
                self.fault = error.strerror or str(error)
                return
            if arrived is None:
                return
            data, source = arrived
            for message in self._parse(data, source):
                self._sort(message, source)

    def write(self, data: bytes, source: Source) -> None:
        """Send a packet; it is lost where the connection has ended."""
        try:
            if not self.fault:
                self._transport.write(data, source)
        except OSError as error:
            self.fault = error.strerror or str(error)

    def close(self) -> None:
        """Close the endpoint."""
        self._transport.close()

    def _parse(self, data: bytes, source: Source) -> Iterator[MavlinkMessage]:
        """Yield the decoded messages of a source; streams are kept apart."""
        if source not in self._parsers:
            if len(self._parsers) >= _MAX_SOURCES:
                self.counts["moved"] += 1
                return
            self._parsers[source] = dialect.MAVLink(None)
            self._parsers[source].robust_parsing = True
        for message in self._parsers[source].parse_buffer(data) or ():
            if message.get_type() == "BAD_DATA":
                self.counts["bad"] += 1
            else:
                yield message

    def _sort(self, message: MavlinkMessage, source: Source) -> None:
        sysid = message.get_srcSystem()
        self.heard[sysid] += 1
        is_autopilot = message.get_srcComponent() == dialect.MAV_COMP_ID_AUTOPILOT1
        if message.get_type() == "HEARTBEAT" and is_autopilot:
            self.kinds.setdefault(sysid, message)
        channel = self._channels.get(sysid)
        if channel is None:
            self.counts["foreign"] += 1
        elif self._sources.setdefault(sysid, source) != source:
            self.counts["moved"] += 1
        else:
            channel.packets.append((bytes(message.get_msgbuf()), source))


class VehicleChannel:
    """Packets of one vehicle of an endpoint, in the form of a socket of datagrams.

    Attributes:
        packets: arrived packets with their source, oldest first.
    """

    def __init__(self, endpoint: Endpoint, sysid: int) -> None:
        """Create the channel of a system number."""
        self.endpoint, self.sysid = endpoint, sysid
        self.packets: deque[tuple[bytes, Source]] = deque(maxlen=_MAX_QUEUE)

    def setblocking(self, flag: bool, /) -> None:
        """Refuse to block."""
        if flag:
            raise RunError("a channel never blocks")

    def recvfrom(self, bufsize: int, /) -> tuple[bytes, Source]:
        """Return a packet and its source.

        Raises:
            BlockingIOError: there is none.
        """
        if not self.packets:
            self.endpoint.poll()
        if not self.packets:
            raise BlockingIOError
        return self.packets.popleft()

    def sendto(self, data: bytes, address: Source, /) -> int:
        """Send a packet to a source."""
        self.endpoint.write(bytes(data), address)
        return len(data)
