"""Missions in AUTO: what is uploaded, when they are completed, and the gap to the batch."""

import json
import math

import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.runs.storage.folder import Run
from angler_mjx.scenario.scenario import load_scenario
from angler_sitl.missions import firmware_mission, mission, mission_gap
from angler_sitl.missions.mission import MissionSettings

from .test_mission import Board, both

HOME = (47.6, -122.3)
# Of 0.0001 degrees, see tests/angler_mjx/report/interop/test_mission_files.py.
NORTH_M, EAST_M = 11.118, 7.520


def item(command, params, frame=3):
    return {"command": command, "frame": frame, "params": params, "type": "SimpleItem"}


def waypoint(north, east, altitude, hold=0, frame=3):
    latitude, longitude = HOME[0] + 1e-4 * north, HOME[1] + 1e-4 * east
    return item(16, [hold, 0, 0, None, latitude, longitude, altitude], frame)


RETURN = item(20, [0] * 7, frame=2)
SLOW = item(178, [1, 0.3, -1, 0, 0, 0, 0], frame=2)


@pytest.fixture
def write(tmp_path):
    def write(items, name="dive.plan", home=(*HOME, 0)):
        table = {"items": items, "plannedHomePosition": list(home), "version": 2}
        path = tmp_path / name
        path.write_text(json.dumps({"fileType": "Plan", "version": 1, "mission": table}))
        return path

    return write


@pytest.fixture(scope="module")
def scenario(tmp_path_factory):
    """A scenario of one robot that starts below home."""
    path = tmp_path_factory.mktemp("auto") / "one.toml"
    path.write_text(
        'schema_version = 1\nname = "one"\n[time]\nhorizon_s = 120.0\n'
        '[world]\npreset = "open"\nshape = [40, 40, 10]\ncell_m = 1.0\ndepth_m = 0.0\n'
        'placement = "given"\nstart_m = [[0.0, 0.0, -0.5]]\n'
        f"goal_m = [[{EAST_M}, 0.0, -4.0]]\n"
        '[[fleet]]\nvehicle = "bluerov2_heavy"\n'
    )
    return load_scenario(path)


def load(scenario, *files, origin=None, parameters=None):
    return firmware_mission.load_missions(files, scenario.fleet, origin, parameters or {})


def test_positions_are_uploaded_as_they_are_and_altitudes_above_home(scenario, write):
    path = write([waypoint(1, 2, -4.5, hold=3), waypoint(0, 0, 195.0, frame=0)], home=(*HOME, 200))
    (loaded,) = load(scenario, path)
    home, first, second = firmware_mission.build_upload(loaded)
    assert (home.latitude_deg, home.longitude_deg, home.altitude_m) == (*HOME, 0.0)
    assert (first.command, first.frame, first.parameters[0]) == (16, 3, 3.0)
    assert first.latitude_deg == pytest.approx(HOME[0] + 1e-4)
    assert first.altitude_m == -4.5
    assert (second.frame, second.altitude_m) == (3, pytest.approx(-5.0))


def test_the_return_is_uploaded_as_a_waypoint_and_named(scenario, write):
    (loaded,) = load(scenario, write([waypoint(1, 0, -4), RETURN]))
    last = firmware_mission.build_upload(loaded)[-1]
    assert (last.command, last.frame, last.altitude_m) == (16, 3, -0.5)
    assert (last.latitude_deg, last.longitude_deg) == HOME
    assert any("uploaded as a way-point" in str(note) for note in loaded.notes)


def test_speeds_are_those_of_the_vehicle(scenario, write):
    fast = item(178, [1, 5.0, -1, 0, 0, 0, 0], frame=2)
    (loaded,) = load(scenario, write([fast, waypoint(1, 0, -4)]))
    limit = loaded.limits.max_speed_mps
    assert 0.3 < limit < 1.0
    assert firmware_mission.build_upload(loaded)[1].parameters[1] == pytest.approx(limit)
    assert loaded.parameters["WPNAV_SPEED"] == pytest.approx(100 * limit, abs=1e-3)
    (slow,) = load(scenario, write([waypoint(1, 0, -4)]), parameters={"WPNAV_SPEED": 20.0})
    assert slow.parameters["WPNAV_SPEED"] == 20.0


def test_completed_items_are_counted_through_jumps_and_gaps(scenario, write):
    back = item(177, [1, 1, 0, 0, 0, 0, 0], frame=2)
    items = [waypoint(1, 0, -4), waypoint(2, 0, -4), SLOW, back, waypoint(3, 0, -4)]
    (loaded,) = load(scenario, write(items))
    assert [entry.number for entry in loaded.order] == [1, 2, 3, 1, 2, 3, 5]
    assert loaded.moves == 5
    # Of item 2 and the speed behind it, completed at once, the firmware reports the speed alone.
    assert loaded.count_moves([1]) == 1
    assert loaded.count_moves([1, 3]) == 2
    assert loaded.count_moves([1, 3, 1, 2, 3, 5]) == 5
    assert loaded.count_moves([1, 9]) == 1


@pytest.mark.parametrize(
    ("settings", "part"),
    [
        ({"plan": ("a.json",)}, "--plan"),
        ({"level": "thrusters"}, "--level thrusters"),
    ],
)
def test_what_does_not_go_with_a_mission_is_refused(tmp_path, settings, part):
    with pytest.raises(ConfigError, match=part):
        MissionSettings(out=tmp_path / "run", missions=[tmp_path / "dive.plan"], **settings)


def test_robots_and_missions_have_to_match(scenario, write):
    path = write([waypoint(1, 0, -4)])
    with pytest.raises(ConfigError, match="2 files for 1 robots"):
        load(scenario, path, path)


class TestPassing:
    """Times at which a path passes its stops."""

    def find(self, path, stops):
        time_s = np.arange(len(path), dtype=float)
        return mission_gap._find_passing(time_s, np.asarray(path, float), np.asarray(stops, float))

    def test_there_and_back(self):
        path = [[x, 0, 0] for x in (0, 1, 2, 3, 2, 1, 0)]
        times, off = self.find(path, [[2, 0.1, 0], [3, 0, 0], [0, 0.2, 0]])
        assert times.tolist() == [2.0, 3.0, 6.0]
        assert off == pytest.approx([0.1, 0.0, 0.2])

    def test_a_stop_that_is_never_passed(self):
        times, off = self.find([[0, 0, 0], [1, 0, 0]], [[1, 0, 0], [5, 0, 0]])
        assert times[0] == 1.0
        assert math.isnan(times[1])
        assert off[1] == pytest.approx(4.0)


@both
def test_a_mission_is_flown_to_its_end(scenario, write, tmp_path, program, request, monkeypatch):
    binary = request.getfixturevalue(program)
    monkeypatch.setattr("angler_sitl.firmware.binary.find_binary", lambda *_: binary)
    path = write([SLOW, waypoint(0.5, 0, -2, hold=2), waypoint(0.5, 1, -4), waypoint(0, 1, -4)])
    lines = []
    settings = MissionSettings(out=tmp_path / "run", missions=[path])
    flight, run = mission.run_mission(scenario, settings, lines.append, Board())
    assert flight.broken == ""
    (gap,) = Run(run.path).summary["sitl"]["mission"]
    # 5.8, 7.8 and 5.6 m at 0.3 m/s, each with 1.1 s of speeding up, and 2 s at the first.
    assert gap["plan_s"] == pytest.approx(68.9, abs=1.5)
    assert any("ArduSub in AUTO against the batch" in line for line in lines)
    assert (run.path / "inputs").exists()
    if program == "stand_in":
        assert flight.scene_s == pytest.approx(3.0, abs=1.5)  # it completes an item each second
        return
    assert flight.last.status[0].outcome.name == "REACHED"
    truth = np.asarray(run.trajectories["p_m"])[0, :, 0]
    stops = [(0, NORTH_M / 2, -2), (EAST_M, NORTH_M / 2, -4), (EAST_M, 0, -4)]
    for stop in stops:
        assert np.linalg.norm(truth - stop, axis=1).min() < 0.2
    assert max(gap["off_stop_m"]) < 0.2
    assert gap["path_rms_m"] < 0.5
    # It waits for a vehicle that lags behind, and is never early.
    assert 0.0 < gap["end_s"] < 0.5 * gap["plan_s"]


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """A scenario of two robots side by side, the first below home."""
    path = tmp_path_factory.mktemp("auto") / "two.toml"
    path.write_text(
        'schema_version = 1\nname = "two"\n[time]\nhorizon_s = 120.0\n'
        '[world]\npreset = "open"\nshape = [40, 40, 10]\ncell_m = 1.0\ndepth_m = 0.0\n'
        'placement = "given"\nstart_m = [[0.0, 0.0, -0.5], [0.0, -4.0, -0.5]]\n'
        f"goal_m = [[{EAST_M}, 0.0, -4.0], [0.0, {-NORTH_M}, -3.0]]\n"
        '[[fleet]]\nvehicle = "bluerov2_heavy"\ncount = 2\n'
    )
    return load_scenario(path)


@pytest.mark.sitl
def test_each_robot_flies_the_mission_of_its_file(pair, write, tmp_path, ardusub, monkeypatch):
    monkeypatch.setattr("angler_sitl.firmware.binary.find_binary", lambda *_: ardusub)
    east = write([waypoint(0, 1, -4)], "east.plan")
    south = write([waypoint(-1, 0, -3)], "south.plan")
    settings = MissionSettings(out=tmp_path / "run", missions=[east, south])
    flight, run = mission.run_mission(pair, settings, lambda _: None, Board())
    assert flight.broken == ""
    truth = np.asarray(run.trajectories["p_m"])[0]
    for robot, stop in enumerate([(EAST_M, 0, -4), (0, -NORTH_M, -3)]):
        assert np.linalg.norm(truth[:, robot] - stop, axis=1).min() < 0.2
        assert np.linalg.norm(truth[:, 1 - robot] - stop, axis=1).min() > 3.0
    gaps = run.summary["sitl"]["mission"]
    assert len(gaps) == 2
    assert all(max(gap["off_stop_m"]) < 0.2 and gap["path_rms_m"] < 0.5 for gap in gaps)
    assert sorted(file.name for file in (run.path / "inputs").rglob("*.plan")) == [
        "east.plan",
        "south.plan",
    ]
