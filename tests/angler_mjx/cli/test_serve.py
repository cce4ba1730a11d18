"""`angler serve` and `angler doctor` as a person meets them: one message for a fault, sockets."""

import importlib.util
import os
import signal
import socket
import subprocess
import sys
import time

import pytest

from angler_mjx.cli import doctor
from angler_mjx.cli.main import main
from angler_mjx.cli.serve import choose_backend

needs_zenoh = pytest.mark.skipif(
    importlib.util.find_spec("zenoh") is None, reason="eclipse-zenoh is missing"
)


@pytest.fixture
def port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--backend", "none"], "--foxglove"),
        (["--port", "0"], "--port 0"),
        (["--foxglove-port", "70000"], "--foxglove-port 70000"),
        (["--pace", "fast"], "--pace fast"),
        (["--silence", "-1"], "--silence -1"),
        (["--source", "gps"], "--source"),
        (["--control-dt-s", "0.013"], "control_dt_s"),
        (["--world", "-1"], "--world -1"),
    ],
)
def test_a_wrong_flag_is_one_message(words, message, capsys):
    with pytest.raises(SystemExit) as left:
        main(["serve", "reef_fleet", "--backend", "zenoh", *words])
    assert left.value.code == 2
    text = capsys.readouterr().err
    assert message.replace("_", "-") in text.replace("_", "-")
    assert "Traceback" not in text


ENDPOINT = ["--endpoint", "udp:127.0.0.1:14550"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--endpoint", "14550"], "--endpoint '14550': give udp:HOST:PORT"),
        (["--arm"], "--arm: is of vehicles that run already; add --endpoint"),
        (["--system-id", "1"], "--system-id: is of vehicles"),
        (["--max-speed", "0.2"], "--max-speed: is of vehicles"),
        (["--at-end", "disarm"], "--at-end: is of vehicles"),
        ([*ENDPOINT, "--level", "guided"], "--level guided: vehicles at endpoints"),
        ([*ENDPOINT, "--pace", "max"], "--pace max: vehicles at endpoints run by the clock"),
        ([*ENDPOINT, "--follow-plans"], "--follow-plans: nothing moves that is not armed"),
        ([*ENDPOINT, "--fence", "1,2"], "--fence '1,2': give XMIN"),
        ([*ENDPOINT, "--max-speed", "0"], "--max-speed 0: give a number above 0"),
        ([*ENDPOINT, "--link-timeout", "0"], "--link-timeout 0: give at least 0.1"),
        ([*ENDPOINT, "--position-timeout", "nan"], "--position-timeout nan: give at least"),
        ([*ENDPOINT, "--origin", "47"], "--origin '47'"),
        ([*ENDPOINT, "--system-id", "1", "2"], "--system-id: 2 numbers for"),
    ],
)
def test_a_wrong_flag_of_vehicles_is_one_message(words, message, port, capsys):
    pytest.importorskip("pymavlink")
    with pytest.raises(SystemExit) as left:
        main(["serve", "reef_fleet", "--backend", "zenoh", "--port", str(port), *words])
    assert left.value.code == 2
    text = capsys.readouterr().err
    assert message in text
    assert "Traceback" not in text


def test_a_missing_library_is_one_message(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "zenoh", None)
    with pytest.raises(SystemExit) as left:
        main(["serve", "reef_fleet", "--backend", "zenoh"])
    assert left.value.code == 2
    assert "angler-mjx[live]" in capsys.readouterr().err


def test_zenoh_serves_where_there_is_no_ros(monkeypatch):
    monkeypatch.setattr("angler_mjx.cli.serve.find_spec", lambda name: None)
    assert choose_backend("auto") == "zenoh"
    monkeypatch.setattr("angler_mjx.cli.serve.find_spec", lambda name: object())
    assert choose_backend("auto") == "rclpy"
    assert choose_backend("zenoh") == "zenoh"


@needs_zenoh
def test_an_open_door_is_listed_and_ends_at_a_signal(port, scenario_file, tmp_path):
    words = ["serve", str(scenario_file), "--backend", "zenoh", "--port", str(port), "--out", "run"]
    door = subprocess.Popen(
        [sys.executable, "-m", "angler_mjx.cli.main", *words],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    try:
        for line in door.stderr:
            if f"tcp/127.0.0.1:{port}" in line:
                break
        time.sleep(1.0)
        entries = [entry for entry in doctor.list_sockets() if entry.pid == door.pid]
        assert [(entry.protocol, entry.address, entry.port) for entry in entries] == [
            ("tcp", "127.0.0.1", port)
        ]
        assert entries[0].is_loopback
        door.send_signal(signal.SIGINT)
        output, _ = door.communicate(timeout=120)
    finally:
        door.kill()
    assert door.returncode == 0
    assert "messages sent" in output
    assert (tmp_path / "run" / "episodes.parquet").is_file()


def test_doctor_prints_a_table(capsys):
    main(["doctor"])
    text = capsys.readouterr().out
    assert all(module in text for module in doctor.TRANSPORTS)
