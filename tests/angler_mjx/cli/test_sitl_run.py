"""Bad input of `angler sitl run`, known before anything is compiled: one message, exit code 2."""

import os

import pytest

from angler_mjx.cli.main import main
from angler_mjx.cli.sitl import run as sitl_run
from angler_sitl.firmware import parameters

SCENARIO = """
schema_version = 1
name = "few"

[time]
horizon_s = 10.0

[world]
preset = "open"

[[fleet]]
vehicle = "bluerov2"
count = 2
"""

FAULTS = {
    "no binary": (["--ardusub", "absent"], "absent"),
    "wrong binary": (["--ardusub", "few.toml"], "few.toml"),
    "no permission": (["--ardusub", "locked"], "locked"),
    "too many robots": (["--robots", "255"], "1 to 254"),
    "no robots": (["--robots", "0"], "robots = 0"),
    "no such world": (["--world", "-1"], "--world -1"),
    "sticks": (["--level", "manual"], "angler teleop"),
    "no plan": (["--plan", "absent.json"], "absent.json"),
    "two kinds of plan": (["--plan", "grid", "absent.json"], "--plan grid"),
    "standing still": (["--speed", "0"], "--speed 0"),
    "no time": (["--duration", "-3"], "--duration -3"),
    "taken": (["--out", "few.toml"], "exists"),
    "another line": (["--gcs", "tcp:127.0.0.1:14550"], "udp:HOST:PORT"),
    "no port": (["--gcs", "udp:127.0.0.1"], "udp:HOST:PORT"),
    "no such port": (["--gcs", "udp:127.0.0.1:99999"], "udp:HOST:PORT"),
    "nobody can join": (["--gcs", "udp:127.0.0.1:14550", "--isolate"], "--isolate"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_cannot_be_flown_is_one_message(fault, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ANGLER_ARDUSUB", "program")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    (tmp_path / "program").write_text("#!/bin/sh\n")
    (tmp_path / "program").chmod(0o755)
    (tmp_path / "few.toml").write_text(SCENARIO)
    (tmp_path / "locked").write_text("no program")
    (tmp_path / "locked").chmod(0o600)
    given, word = FAULTS[fault]
    with pytest.raises(SystemExit) as left:
        main(["sitl", "run", "few.toml", *given])
    assert left.value.code == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.count("angler:") == 1
    assert word in shown.err
    assert sorted(os.listdir(tmp_path)) == ["few.toml", "locked", "program"]


def test_without_an_ardusub_it_says_how_to_get_one(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("ANGLER_ARDUSUB", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    with pytest.raises(SystemExit) as left:
        main(["sitl", "run", "sitl_hold"])
    assert left.value.code == 2
    assert "angler sitl install" in capsys.readouterr().err
    assert os.listdir(tmp_path) == []


def test_the_command_names_all_levels_and_sources():
    assert sitl_run.CommandLevel.__value__ == parameters.CommandLevel.__value__
    assert sitl_run.PositionSource.__value__ == parameters.PositionSource.__value__
