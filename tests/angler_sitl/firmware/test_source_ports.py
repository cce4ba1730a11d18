"""Ports that autopilots send from: shared ones are given up before anything is answered."""

import os
import socket
from contextlib import contextmanager
from pathlib import Path

import pytest

from angler_mjx.errors import RunError
from angler_sitl.firmware import sockets, source_ports
from angler_sitl.firmware.binary import Binary
from angler_sitl.firmware.process import AutopilotProcess, LaunchSpec, kill_processes
from angler_sitl.wire import packets


@contextmanager
def another(port=0):
    """A program that others may share its port with, as every ArduSub is."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        one.bind(("0.0.0.0", port))
        yield one.getsockname()[1]


@contextmanager
def started(binary, ports, folder, **parameters):
    launch = LaunchSpec(
        binary=binary, folder=folder, ports=ports, name="robot_3", sysid=4, parameters=parameters
    )
    instances = [AutopilotProcess(launch)]
    try:
        yield instances
    finally:
        kill_processes(instances)


def test_who_takes_what_is_sent_to_a_port():
    here = os.getpid()
    with another() as port:
        assert sockets.count_receivers(here, port) == 1
        with another(port), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as connected:
            connected.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            connected.bind(("127.0.0.1", port))
            assert sockets.count_receivers(here, port) == 3
            # It hears its peer alone from now on.
            connected.connect(("127.0.0.1", 9))
            assert sockets.count_receivers(here, port) == 2
    assert sockets.count_receivers(here, port) == 0


def test_one_that_shares_its_port_is_started_anew(stand_in, ports, tmp_path):
    with another() as port:
        wish = {"STANDIN_PORT": port, "STANDIN_PORT_STARTS": 2}
        with started(stand_in, ports, tmp_path, **wish) as instances:
            first = instances[0].pid
            source_ports.restart_shared_ports(instances)
            assert instances[0].pid != first
            assert (tmp_path / "starts").read_text() == "xxx"
            assert sockets.count_receivers(instances[0].pid, port) == 1
            # Nothing of those before is left: the packet that waits is the first of the last.
            packet, source = ports.fdm.recvfrom(256)
            assert source[1] != port
            assert packets.read_servo(packet)[0] == 0
            assert sockets.count_receivers(instances[0].pid, source[1]) == 1


def test_one_that_always_shares_it_is_refused(stand_in, ports, tmp_path):
    with another() as port:
        wish = {"STANDIN_PORT": port, "STANDIN_PORT_STARTS": 99}
        with (
            started(stand_in, ports, tmp_path, **wish) as instances,
            pytest.raises(RunError, match="robot_3: the port that its ArduSub sends from"),
        ):
            source_ports.restart_shared_ports(instances)
        assert instances[0].fault() is None


def test_one_of_its_own_is_left_alone(stand_in, ports, tmp_path):
    with started(stand_in, ports, tmp_path) as instances:
        first = instances[0].pid
        source_ports.restart_shared_ports(instances)
        assert instances[0].pid == first


def test_one_that_ends_is_told_of_by_others(ports, tmp_path):
    ending = Binary(path=Path("/bin/false"), version="", sha256="")
    with started(ending, ports, tmp_path) as instances:
        source_ports.restart_shared_ports(instances)
        assert "exit code 1" in instances[0].fault()


@pytest.mark.sitl
def test_the_real_one_lets_others_have_its_port(ardusub, ports, tmp_path):
    """Why all this: the day it does not, the module can go."""
    with started(ardusub, ports, tmp_path) as instances:
        source_ports.restart_shared_ports(instances)
        port = ports.fdm.recvfrom(256)[1][1]
        with another(port):
            assert sockets.count_receivers(instances[0].pid, port) == 2
