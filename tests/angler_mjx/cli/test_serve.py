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
