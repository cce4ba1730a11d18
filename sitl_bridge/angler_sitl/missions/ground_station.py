"""Ground station that may join: every vehicle's MAVLink, both ways, over one UDP port.

Its traffic goes over the line on which the autopilots take external navigation, and not over the
session's: a ground station requests streams at its own rates, and the firmware keeps rates by line.
One socket serves all vehicles, because some ground stations answer only to the source of the last
packet; their packets go to the vehicle that they name, or to all.
"""

import socket
from typing import Self

from pymavlink.dialects.v20 import ardupilotmega as dialect

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.runs.session.interface import Observation
from angler_sitl.session import SitlSession

_MAX_PACKET_BYTES = 65_536


def parse_address(text: str) -> tuple[str, int]:
    """Return host and port of a ground station.

    Args:
        text: as in ``udp:127.0.0.1:14550``.

    Raises:
        ConfigError: the address is invalid.
    """
    kind, _, rest = text.partition(":")
    host, _, number = rest.rpartition(":")
    # int() accepts more than plain digits.
    plain = number.isascii() and number.isdecimal() and len(number) <= 5
    port = int(number) if plain else 0
    if kind != "udp" or not host or not 0 < port < 65_536:
        raise ConfigError(
            f"--gcs {format_value(text)}: give udp:HOST:PORT, as in udp:127.0.0.1:14550"
        )
    return host, port


class GroundStation:
    """Forwarder between a ground station and the autopilots of a session; a context manager.

    It runs after each control period; see `angler_mjx.teleop.loop.Watcher`.
    """

    def __init__(self, address: str) -> None:
        """Create the forwarder; nothing is sent before `join`.

        Args:
            address: as in ``udp:127.0.0.1:14550``.

        Raises:
            ConfigError: the address is invalid, or its host has no address.
        """
        host, port = parse_address(address)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.connect((host, port))  # only packets of this ground station are received
        except OSError as error:
            self._socket.close()
            raise ConfigError(f"--gcs {address}: {error.strerror or error}") from error
        self._parser = dialect.MAVLink(None)
        self._parser.robust_parsing = True

    def __enter__(self) -> Self:
        """Return the context manager itself."""
        return self

    def __exit__(self, *ended: object) -> None:
        """Close the socket."""
        self._socket.close()

    def join(self, session: SitlSession) -> None:
        """Forward the autopilots of a session, as they are since its last reset."""
        self._pilots = session.autopilots.pilots
        for pilot in self._pilots:
            pilot.vision.listeners.append(self._forward)

    def after(self, observation: Observation) -> None:
        """Forward the packets of the ground station."""
        while True:
            try:
                data = self._socket.recv(_MAX_PACKET_BYTES)
            except BlockingIOError:
                return
            except ConnectionError:  # no listener there yet
                continue
            for message in self._parser.parse_buffer(data) or ():
                target = getattr(message, "target_system", 0)
                for pilot in self._pilots:
                    if message.get_type() != "BAD_DATA" and target in (0, pilot.sysid):
                        pilot.vision.write(bytes(message.get_msgbuf()))

    def _forward(self, packet: bytes) -> None:
        try:
            self._socket.send(packet)
        except (BlockingIOError, ConnectionError):
            return  # as if lost in transit: UDP gives no guarantee
