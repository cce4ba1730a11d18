"""Sockets of a process, as the kernel lists them: which of them other machines could reach."""

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
    """One socket that has an address.

    Attributes:
        protocol: "udp", "tcp" or "raw".
        address: It is bound to; unspecified (0.0.0.0) means every interface.
        port: Its number.
        peer: The only one whose packets reach it, if it is connected.
    """

    protocol: str
    address: IPv4Address | IPv6Address
    port: int
    peer: IPv4Address | IPv6Address | None

    @property
    def loopback(self) -> bool:
        """Whether only this machine can reach it."""
        return self.address.is_loopback or (self.peer is not None and self.peer.is_loopback)

    def __str__(self) -> str:
        """As in "udp 0.0.0.0:5501"."""
        return f"{self.protocol} {self.address}:{self.port}"


def of(pid: int) -> list[BoundSocket]:
    """Sockets with an address that a process of ours has; none if it has ended."""
    inodes = _inodes(pid)
    return [one for inode, one in _listed(pid) if inode in inodes]


def takers(pid: int, port: int) -> int:
    """UDP sockets, of whatever process, that take what anybody sends to a port.

    Args:
        pid: A process of ours: it is the network that this one is in.
        port: Its number.
    """
    here = [one for _, one in _listed(pid) if one.protocol == "udp" and one.port == port]
    return sum(one.peer is None for one in here)


def _listed(pid: int) -> Iterator[tuple[str, BoundSocket]]:
    """All sockets with an address in the network of a process, by inode."""
    for table in _TABLES:
        try:
            lines = Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]
        except OSError:
            continue
        for words in (line.split() for line in lines):
            one = _bound(table.rstrip("6"), words[1], words[2], words[3])
            if one is not None:
                yield words[9], one


def _inodes(pid: int) -> set[str]:
    found = set()
    try:
        for name in os.listdir(f"/proc/{pid}/fd"):
            target = os.readlink(f"/proc/{pid}/fd/{name}")
            if target.startswith("socket:["):
                found.add(target[len("socket:[") : -1])
    except OSError:
        # It has ended, or a file was closed while we looked: what was found so far is true.
        pass
    return found


def _bound(protocol: str, local: str, remote: str, state: str) -> BoundSocket | None:
    address, port = _parse(local)
    peer, peer_port = _parse(remote)
    listens = protocol == "tcp" and state == _LISTENING
    if port == 0:
        return None
    connected = peer_port != 0 and not listens
    return BoundSocket(
        protocol=protocol, address=address, port=port, peer=peer if connected else None
    )


def _parse(text: str) -> tuple[IPv4Address | IPv6Address, int]:
    """Address and port of the kernel's form: words of 32 bits in the machine's byte order."""
    digits, _, port = text.partition(":")
    words = [int(digits[i : i + 8], 16) for i in range(0, len(digits), 8)]
    packed = b"".join(socket.htonl(word).to_bytes(4, "big") for word in words)
    address = ip_address(packed)
    mapped = address.ipv4_mapped if isinstance(address, IPv6Address) else None
    return mapped or address, int(port, 16)
