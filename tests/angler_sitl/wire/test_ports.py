"""Ports: ours alone from the moment they are known, and given back."""

import os
import resource
import socket

import pytest

from angler_mjx.errors import ConfigError, RunError
from angler_sitl.wire.ports import allocate_ports, port_number


def sockets_of(ports):
    return (ports.fdm, ports.mavlink, ports.vision, ports.rc)


def test_two_fleets_at_once_share_no_port_and_are_on_loopback():
    fleets = allocate_ports(5) + allocate_ports(3)
    bound = [one for ports in fleets for one in sockets_of(ports)]
    assert len({port_number(one) for one in bound}) == 4 * 8
    assert {one.getsockname()[0] for one in bound} == {"127.0.0.1"}
    for ports in fleets:
        ports.close()
    assert all(one.fileno() == -1 for one in bound)


@pytest.mark.parametrize("address", ["0.0.0.0", "127.0.0.1"])
def test_a_held_port_is_nobody_elses(ports, address):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        # ArduSub asks for its radio control port in this way.
        other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with pytest.raises(OSError, match="in use"):
            other.bind((address, ports.rc_port))


@pytest.mark.parametrize("count", [0, -1, 255])
def test_more_robots_than_system_numbers(count):
    with pytest.raises(ConfigError, match=f"{count} robots.*254.*--robots"):
        allocate_ports(count)


def test_no_sockets_left_is_said_and_leaves_none_behind():
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    before = set(os.listdir("/proc/self/fd"))
    # Descriptors are given lowest first, so a limit 10 above the highest leaves 10 to some more.
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(map(int, before)) + 10, hard))
    try:
        with pytest.raises(RunError, match=r"of 254.*ulimit -n"):
            allocate_ports(254)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert set(os.listdir("/proc/self/fd")) == before
