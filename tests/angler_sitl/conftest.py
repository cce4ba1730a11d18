"""The stand-in autopilot, the real one where there is one, and ways to run them."""

import sys
from pathlib import Path

import pytest

from angler_mjx.errors import AnglerError
from angler_sitl.firmware import binary
from angler_sitl.firmware.binary import Binary
from angler_sitl.wire.ports import allocate_ports

STAND_IN = Path(__file__).parent / "stand_in.py"


@pytest.fixture(scope="session")
def stand_in(tmp_path_factory):
    """The stand-in autopilot as a program that can be run like ArduSub."""
    path = tmp_path_factory.mktemp("stand_in") / "ardusub"
    path.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{STAND_IN}" "$@"\n')
    path.chmod(0o755)
    return Binary(path=path, version="stand-in", sha256="")


@pytest.fixture(scope="session")
def ardusub():
    """A real ArduSub."""
    try:
        return binary.find_binary()
    except AnglerError as error:
        pytest.skip(f"no real ArduSub here: {error}")


@pytest.fixture
def ports():
    """Sockets of one vehicle."""
    (given,) = allocate_ports(1)
    yield given
    given.close()
