"""The recorder beside the disk: what a row says follows from what was written."""

import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.studies.speed.measured import recording
from angler_mjx.studies.speed.measured.recording import break_even_hz

SCENARIO = """
schema_version = 1
name = "short"
engine = "fused"
kernels = "xla"

[time]
horizon_s = 26.0
record_hz = 10.0

[world]
preset = "open"
placement = "random"

[[fleet]]
vehicle = "bluerov2"
cruise_speed_mps = 1.0
count = 2
"""


@pytest.fixture
def scenario(tmp_path):
    path = tmp_path / "short.toml"
    path.write_text(SCENARIO)
    return load_scenario(path)


def test_the_rate_at_which_the_disk_keeps_up():
    # 2e6 steps of 10 ms are 2e4 robot-seconds in a second; at 50 Hz and 100 bytes they are 100 MB.
    assert break_even_hz(100.0, 100.0, 2e6, 0.01) == pytest.approx(50.0)


@pytest.mark.nightly(by="test_the_command_says_what_recording_found")
def test_a_row_of_recording(scenario, tmp_path):
    folder = tmp_path / "disk"
    sized = {"label": "recording/short", "worlds": 2, "repeats": 10}
    row = recording.measure(scenario, **sized, folder=folder, min_bytes=60_000)
    assert (row.workload, row.unit, row.robots) == ("recording/short", "MB/s", 2)
    assert 0 < row.low <= row.median <= row.high
    assert row.repeats == 10
    x = row.extra
    assert x["disk_ratio"] == pytest.approx(row.median / x["disk_mbps"])
    # A sample of a robot: 19 floats, eight words of commands, a byte; a few bytes of metadata more
    # than nothing at the least, and with all files of so short a run not ten times as much.
    assert 10 < x["bytes_per_robot_sample"] < 10 * (19 * 4 + 8 * 2 + 1)
    assert x["break_even_hz"] == pytest.approx(
        break_even_hz(row.median, x["bytes_per_robot_sample"], x["vehicle_steps_per_s"], 0.01)
    )
    assert "10 Hz" in row.inside
    # What was written is gone.
    assert list(folder.iterdir()) == []


def test_nothing_recorded_or_no_place_is_refused(scenario, tmp_path):
    sized = {"label": "x", "worlds": 2, "repeats": 10}
    silent = scenario.model_copy(update={"time": scenario.time.model_copy(update={"record_hz": 0})})
    with pytest.raises(ConfigError, match="nothing to record"):
        recording.measure(silent, **sized, folder=tmp_path)


def test_a_folder_that_cannot_be_made_is_named_before_anything_is_compiled(scenario, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="deeper: cannot be written"):
        recording.measure(
            scenario, label="x", worlds=2, repeats=10, folder=tmp_path / "file" / "deeper"
        )
