"""Sockets of a fleet of autopilots: our ends are bound before any autopilot starts.

The kernel chooses every number, so several fleets run on one machine and no list of ports has to
be kept free. A port is held from its allocation until `Ports.close`, so no other process can take
it in between.
"""

import socket
from dataclasses import dataclass, fields

from angler_mjx.errors import ConfigError, RunError

LOOPBACK = "127.0.0.1"
MAX_VEHICLES = 254
"""Max number of vehicles: MAVLink system numbers are 1 to 255, and 255 is the ground station."""


@dataclass(frozen=True, kw_only=True)
class Ports:
    """Sockets of one vehicle, all UDP, all bound to loopback.

    Attributes:
        fdm: Receives servo packets, ``--sim-port-out``. The replies go to their sender.
        mavlink: ``--serial0 udpclient:``, for commands and telemetry.
        vision: ``--serial1 udpclient:``, for external navigation.
        rc: Holds the autopilot's port of radio control packets, ``--rc-in-port``. The autopilot
            would bind it on all interfaces and has no option against that; as the port is taken,
            it goes without. Nothing is ever read from this socket.
    """

    fdm: socket.socket
    mavlink: socket.socket
    vision: socket.socket
    rc: socket.socket

    @property
    def rc_port(self) -> int:
        """Number of the port that is held against the autopilot's own radio control socket."""
        return port_number(self.rc)

    def close(self) -> None:
        """Close all sockets; a second call has no effect."""
        for field in fields(self):
            getattr(self, field.name).close()


def port_number(bound: socket.socket) -> int:
    """Return the port number of a bound socket."""
    return int(bound.getsockname()[1])


def allocate_ports(count: int) -> list[Ports]:
    """Bind the sockets of a number of vehicles.

    Raises:
        ConfigError: fewer than one vehicle, or more than MAVLink has numbers for.
        RunError: the machine has no more sockets; those already bound are closed.
    """
    if not 1 <= count <= MAX_VEHICLES:
        raise ConfigError(
            f"{count} robots: real autopilots can be 1 to {MAX_VEHICLES}, for MAVLink has no more "
            "system numbers; choose fewer with --robots"
        )
    allocated: list[Ports] = []
    try:
        for _ in range(count):
            allocated.append(_bind_ports())
    except OSError as error:
        for ports in allocated:
            ports.close()
        raise RunError(
            f"no UDP port of {LOOPBACK} for autopilot {len(allocated)} of {count} ({error}); close "
            "other programs, or raise the limit of open files (ulimit -n)"
        ) from error
    return allocated


def _bind_ports() -> Ports:
    sockets: list[socket.socket] = []
    try:
        for _ in fields(Ports):
            sockets.append(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            # Without SO_REUSEADDR: so no other process can bind the port.
            sockets[-1].bind((LOOPBACK, 0))
    except OSError:
        for bound_socket in sockets:
            bound_socket.close()
        raise
    fdm, mavlink, vision, rc = sockets
    return Ports(fdm=fdm, mavlink=mavlink, vision=vision, rc=rc)
