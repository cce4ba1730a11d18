"""Sockets of a process, as the kernel lists them, and their reach from other machines."""

import os
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from ipaddress import IPv4Address, IPv6Address, ip_address
from pathlib import Path

_TABLES = ("udp", "udp6", "tcp", "tcp6", "raw", "raw6")
_LISTENING = "0A"


@dataclass(frozen=True, kw_only=True)
class BoundSocket:
    """One socket with an address.

    Attributes:
        protocol: "udp", "tcp" or "raw".
        address: Its bound address; unspecified (0.0.0.0) means every interface.
        port: Its number.
        peer: Its only accepted sender, if it is connected.
    """

    protocol: str
    address: IPv4Address | IPv6Address
    port: int
    peer: IPv4Address | IPv6Address | None

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can reach it."""
        return self.address.is_loopback or (self.peer is not None and self.peer.is_loopback)

    def __str__(self) -> str:
        """Return the socket as in "udp 0.0.0.0:5501"."""
        return f"{self.protocol} {self.address}:{self.port}"


def list_sockets(pid: int) -> list[BoundSocket]:
    """Return the sockets with an address of a process of ours; none if it has ended."""
    inodes = _list_inodes(pid)
    return [entry for inode, entry in _read_tables(pid) if inode in inodes]


def count_receivers(pid: int, port: int) -> int:
    """Count the UDP sockets of all processes that receive the packets sent to a port.

    Args:
        pid: A process of ours, in the network of interest.
        port: Its number.
    """
    receivers = [
        entry for _, entry in _read_tables(pid) if entry.protocol == "udp" and entry.port == port
    ]
    return sum(entry.peer is None for entry in receivers)


def _read_tables(pid: int) -> Iterator[tuple[str, BoundSocket]]:
    """Yield all sockets with an address in the network of a process, by inode."""
    for table in _TABLES:
        try:
            lines = Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]
        except OSError:
            continue
        for columns in (line.split() for line in lines):
            entry = _parse_row(table.rstrip("6"), columns[1], columns[2], columns[3])
            if entry is not None:
                yield columns[9], entry


def _list_inodes(pid: int) -> set[str]:
    inodes = set()
    try:
        for name in os.listdir(f"/proc/{pid}/fd"):
            target = os.readlink(f"/proc/{pid}/fd/{name}")
            if target.startswith("socket:["):
                inodes.add(target[len("socket:[") : -1])
    except OSError:
        # The process ended, or a file was closed during the scan: the sockets so far are valid.
        pass
    return inodes


def _parse_row(protocol: str, local: str, remote: str, state: str) -> BoundSocket | None:
    address, port = _parse_address(local)
    peer, peer_port = _parse_address(remote)
    is_listening = protocol == "tcp" and state == _LISTENING
    if port == 0:
        return None
    is_connected = peer_port != 0 and not is_listening
    return BoundSocket(
        protocol=protocol, address=address, port=port, peer=peer if is_connected else None
    )


def _parse_address(text: str) -> tuple[IPv4Address | IPv6Address, int]:
    """Parse address and port of the kernel's form: 32-bit words in the machine's byte order."""
    digits, _, port = text.partition(":")
    chunks = [int(digits[i : i + 8], 16) for i in range(0, len(digits), 8)]
    packed = b"".join(socket.htonl(chunk).to_bytes(4, "big") for chunk in chunks)
    address = ip_address(packed)
    mapped = address.ipv4_mapped if isinstance(address, IPv6Address) else None
    return mapped or address, int(port, 16)
