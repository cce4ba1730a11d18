"""`angler doctor`: transports of `angler serve`, and the sockets that are open."""

from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from ipaddress import ip_address

TRANSPORTS = {"rclpy": None, "zenoh": "eclipse-zenoh", "foxglove": "foxglove-sdk"}
"""Modules of the transports, and the distributions that bring them."""


@dataclass(frozen=True, kw_only=True)
class OpenSocket:
    """Socket of a door."""

    pid: int
    protocol: str
    address: str
    port: int

    @property
    def is_loopback(self) -> bool:
        """Return whether only this machine can reach it."""
        return ip_address(self.address).is_loopback


def run_doctor() -> None:
    """List the transports of angler serve that are installed, and the sockets of open doors.

    angler sitl doctor checks real autopilots.
    """
    from rich.console import Console

    from angler_mjx.cli.serve import choose_backend
    from angler_mjx.cli.shared.text_table import build_text_table

    table = build_text_table("", "looked at", "found")
    chosen = choose_backend("auto")
    for module in TRANSPORTS:
        found = find_transport(module)
        mark = "[green]good" if found else "[yellow]note"
        suffix = ", taken by --backend auto" if module == chosen else ""
        table.add_row(mark, module, (found or "not installed") + suffix)
    sockets = list(list_sockets())
    for entry in sockets:
        mark = "[green]good" if entry.is_loopback else "[yellow]note"
        reach = "this machine alone" if entry.is_loopback else "reachable from outside"
        if ip_address(entry.address).is_multicast:
            reach = "a multicast group"
        where = f"{entry.protocol} {entry.address}:{entry.port}"
        table.add_row(mark, f"socket of process {entry.pid}", f"{where}, {reach}")
    if not sockets:
        table.add_row("[green]good", "sockets", "no door is open")
    Console().print(table)


def find_transport(module: str) -> str | None:
    """Return the version of a transport; None if it is not installed."""
    if find_spec(module) is None:
        return None
    try:
        return version(TRANSPORTS[module] or module)
    except PackageNotFoundError:
        return "installed"


def list_sockets() -> Iterator[OpenSocket]:
    """Yield the sockets that doors listen at: processes of `angler serve`."""
    import socket

    import psutil

    for process in psutil.process_iter():
        try:
            words = process.cmdline()
            if "serve" not in words or not any("angler" in word for word in words):
                continue
            connections = process.net_connections("inet")
        except psutil.Error:  # it has ended, or is another user's
            continue
        for entry in connections:
            is_datagram = entry.type == socket.SOCK_DGRAM
            if entry.laddr and (is_datagram or entry.status == psutil.CONN_LISTEN):
                yield OpenSocket(
                    pid=process.pid,
                    protocol="udp" if is_datagram else "tcp",
                    address=entry.laddr.ip,
                    port=entry.laddr.port,
                )
