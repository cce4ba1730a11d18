"""The version that an autopilot states in AUTOPILOT_VERSION, and where it is recorded."""

import dataclasses

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from angler_mjx.errors import ConfigError
from angler_sitl.firmware import binary, probe


def stated(number, commit):
    """The message as it comes out of the bytes that pymavlink packs."""
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    message = mavlink.MAVLink_autopilot_version_message(
        0, number, 0, 0, 0, commit, bytes(8), bytes(8), 0, 0, 0
    )
    (received,) = mavlink.MAVLink(None).parse_buffer(message.pack(sender))
    return received


@pytest.mark.parametrize(
    ("number", "commit", "version"),
    [
        (0x04_05_03_FF, b"d5c3d1b5", ("4.5.3", "d5c3d1b5")),
        (0x04_06_00_00, b"01234567", ("4.6.0-dev", "01234567")),
        (0x04_01_02_80, bytes(8), ("4.1.2-beta", "")),
    ],
)
def test_the_version_is_that_of_the_bytes(number, commit, version):
    assert probe.read_version(stated(number, commit)) == version


def test_a_program_without_a_record_states_its_version(stand_in, monkeypatch):
    monkeypatch.setenv(binary.ENVIRONMENT_VARIABLE, str(stand_in.path))
    named = binary.find_binary()
    assert named.version == binary.UNKNOWN_VERSION
    assert probe.identify_version(named) == dataclasses.replace(named, version="4.6.0-dev")


def test_what_states_no_version_is_refused(tmp_path):
    program = tmp_path / "ardusub"
    program.write_text("#!/bin/sh\nexit 3\n")
    program.chmod(0o755)
    with pytest.raises(ConfigError, match=r"ardusub: does not state its version"):
        probe.identify_version(binary.find_binary(program))


def test_a_recorded_version_is_kept(tmp_path):
    held = binary.Binary(path=tmp_path / "nothing", version="4.5.3", sha256="")
    assert probe.identify_version(held) is held
