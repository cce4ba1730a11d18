"""What angler sitl doctor looks at: programs, sockets that others can reach, and shutting them."""

import contextlib
import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from angler_mjx.cli.main import main
from angler_mjx.robot.vehicles.library import list_rovs
from angler_sitl.firmware import binary, sockets
from angler_sitl.firmware.doctor import run_checks


def rows(path=None):
    return {check.name: check for check in run_checks(path)}


def test_an_autopilot_that_is_well(stand_in):
    found = rows(stand_in.path)
    assert all(check.good for check in found.values()), found
    assert {f"parameters, {name}" for name in list_rovs()} <= set(found)
    assert found["version"].text == "4.6.0-dev (standin0)"
    assert found["open sockets"].text == "none but on loopback"


def test_no_autopilot(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv(binary.ENVIRONMENT_VARIABLE, raising=False)
    found = rows()
    assert found["ports"].good
    assert found["binary"].good is False
    with pytest.raises(SystemExit) as left:
        main(["sitl", "doctor"])
    assert left.value.code == 2
    assert "at fault: binary" in capsys.readouterr().err


def test_another_program():
    found = rows(Path(shutil.which("true")))
    assert found["version"].good is False
    assert "ended with exit code 0" in found["version"].text


def test_sockets_of_a_process_are_listed_with_who_can_reach_them():
    with contextlib.ExitStack() as stack:
        udp = [
            stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(4)
        ]
        everywhere, here, connected, _ = udp
        everywhere.bind(("0.0.0.0", 0))
        here.bind(("127.0.0.1", 0))
        connected.connect(here.getsockname())
        server = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        found = {str(one): one.is_loopback for one in sockets.list_sockets(os.getpid())}
        wanted = {"udp": (everywhere, here, connected), "tcp": (server,)}
        names = [
            "{} {}:{}".format(protocol, *bound.getsockname())
            for protocol, many in wanted.items()
            for bound in many
        ]
    assert [found[name] for name in names] == [False, True, True, True]


ISOLATED = """
import os, socket
from angler_mjx.errors import UnsupportedError
from angler_sitl.firmware import isolation
before = os.getuid(), os.getgid()
try:
    isolation.isolate_network()
except UnsupportedError as error:
    print("unsupported", error)
    raise SystemExit
from angler_sitl.wire.ports import allocate_ports, port_number
one, two = allocate_ports(2)
two.fdm.sendto(b"here", ("127.0.0.1", port_number(one.fdm)))
one.fdm.settimeout(20)
names = [line.split(":")[0].strip() for line in open("/proc/self/net/dev").readlines()[2:]]
print(names == ["lo"], one.fdm.recv(9) == b"here", before == (os.getuid(), os.getgid()))
"""


def test_alone_on_a_network_of_its_own():
    done = subprocess.run(
        [sys.executable, "-c", ISOLATED], capture_output=True, text=True, timeout=60, check=False
    )
    if done.stdout.startswith("unsupported"):
        pytest.skip(f"no network namespace here: {done.stdout}")
    assert done.stdout.split() == ["True"] * 3, done.stderr


@pytest.mark.sitl
def test_the_real_one_is_well(ardusub, capsys):
    main(["sitl", "doctor", "--ardusub", str(ardusub.path)])
    shown = capsys.readouterr().out
    assert "fault" not in shown
    # The one socket that has no option; which number it has is the kernel's choice.
    assert shown.count("0.0.0.0:") == 1
    assert all(f"parameters, {name}" in shown for name in list_rovs())
