"""`angler serve --endpoint` on real ArduSub processes that somebody else started.

They fly in the firmware's own physics with GPS, by the wall clock: nothing of the simulator moves
them.
"""

import json
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav
from rosbags.typesys import Stores, get_typestore

from angler_mjx.runs.storage.folder import Run

from ..external import ExternalArduSub, Station, free_port

pytestmark = pytest.mark.sitl

SCENE = """
schema_version = 1
name = "pool"
seed = 3

[time]
horizon_s = 600.0
record_hz = 5.0

[world]
preset = "open"
depth_m = 0.0
placement = "given"
start_m = STARTS
goal_m = GOALS

[[fleet]]
vehicle = "bluerov2_heavy"
count = COUNT
"""
FENCE = "-8,-8,-3,8,8,0"
START_S = 240.0
DIVE = (0.0, 0.0, -0.25, 0.0, 0.0, 0.0)
AHEAD = (0.25, 0.0, 0.0, 0.0, 0.0, 0.0)


class Door:
    """`angler serve --endpoint` as a process, armed by its confirmation, driven over Zenoh."""

    def __init__(self, folder, endpoints, *words, count=1):
        self.zenoh = pytest.importorskip("zenoh")
        self.folder, port = folder, free_port()
        values = {"COUNT": count, "STARTS": [[3.0 * i, 0.0, -2.0] for i in range(count)]}
        values["GOALS"] = [[3.0 * i, 6.0, -2.0] for i in range(count)]
        text = SCENE
        for word, value in values.items():
            text = text.replace(word, str(value))
        (folder / "pool.toml").write_text(text)
        command = [sys.executable, "-m", "angler_mjx.cli.main", "serve", "pool.toml"]
        command += ["--backend", "zenoh", "--port", str(port), "--out", "run", "--arm"]
        command += ["--endpoint", *endpoints, "--fence", FENCE, "--max-speed", "0.4", *words]
        self.process = subprocess.Popen(
            command,
            cwd=folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=(folder / "stderr.txt").open("w"),
            text=True,
        )
        self.process.stdin.write("arm\n")
        self.process.stdin.flush()
        config = self.zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", f'["tcp/127.0.0.1:{port}"]')
        config.insert_json5("connect/timeout_ms", "240000")
        config.insert_json5("scouting/multicast/enabled", "false")
        self._config, self.seen = config, {i: [] for i in range(count)}

    def __enter__(self):
        end = time.monotonic() + START_S
        while "armed in GUIDED" not in self.errors() and time.monotonic() < end:
            assert self.process.poll() is None, self.errors()
            time.sleep(0.1)
        assert "armed in GUIDED" in self.errors()
        self.client = self.zenoh.open(self._config)
        self.types = get_typestore(Stores.ROS2_JAZZY)
        digest = self.types.hash_rihs01("geometry_msgs/msg/Twist")
        self.publishers = {
            i: self.client.declare_publisher(
                f"0/robot_{i}/cmd_vel/geometry_msgs::msg::dds_::Twist_/{digest}"
            )
            for i in self.seen
        }
        for i, seen in self.seen.items():
            self.client.declare_subscriber(f"0/robot_{i}/odometry/**", seen.append)
        return self

    def __exit__(self, *ended):
        self.client.close()
        self.process.kill()
        self.process.wait()

    def errors(self):
        return (self.folder / "stderr.txt").read_text()

    def drive(self, seconds, nu):
        end = time.monotonic() + seconds
        while time.monotonic() < end and self.process.poll() is None:
            for publisher in self.publishers.values():
                publisher.put(b"\x00\x01\x00\x00" + struct.pack("<6d", *nu))
            time.sleep(0.05)

    def positions(self, robot=0):
        kind = "nav_msgs/msg/Odometry"
        messages = [
            self.types.deserialize_cdr(sample.payload.to_bytes(), kind)
            for sample in list(self.seen[robot])
        ]
        points = [message.pose.pose.position for message in messages]
        return np.array([[point.x, point.y, point.z] for point in points])

    def end(self):
        self.process.send_signal(signal.SIGINT)
        return self.wait()

    def wait(self):
        self.process.communicate(timeout=60)
        return self.process.returncode, Run(self.folder / "run")


@pytest.fixture
def start(ardusub, tmp_path):
    """A function: an ArduSub of somebody else."""
    processes = []

    def launch(**options):
        folder = tmp_path / f"sub_{len(processes)}"
        processes.append(ExternalArduSub(ardusub.path, folder, **options))
        return processes[-1]

    yield launch
    for process in processes:
        process.close()


def endpoint(process):
    return f"udp:127.0.0.1:{process.port}"


def test_it_dives_drives_and_is_recorded(start, tmp_path):
    process = start()
    with Door(tmp_path, [endpoint(process)]) as door:
        door.drive(8.0, DIVE)
        door.drive(6.0, AHEAD)
        code, run = door.end()
        seen = door.positions()
    assert code == 0, door.errors()
    depth = -seen[:, 2]
    assert depth[0] < 0.3
    assert depth[-1] == pytest.approx(8 * 0.25, abs=0.7)
    assert depth.max() < 3.3  # the fence ends at 3 m
    assert np.linalg.norm(seen[-1, :2] - seen[0, :2]) > 0.7
    flown = np.asarray(run.trajectories["p_m"])[0, :, 0]
    np.testing.assert_allclose(flown[-1], seen[-1], atol=0.3)
    vehicles = run.summary["vehicles"]
    assert vehicles["outcomes"] == {"robot_0": "flown"}
    assert "confirms: POSHOLD, armed" in vehicles["end"]
    log = run.path / "robots" / "robot_0" / "mavlink.tlog"
    assert log.stat().st_size > 50_000


def test_a_frozen_vehicle_is_a_lost_link(start, tmp_path):
    process = start()
    with Door(tmp_path, [endpoint(process)]) as door:
        door.drive(3.0, DIVE)
        process.freeze()
        frozen_s = time.monotonic()
        code, run = door.wait()
        assert time.monotonic() - frozen_s < 20.0
    assert code == 2
    assert "link_lost: robot_0: no message for 2." in door.errors()
    assert run.summary["vehicles"]["outcomes"] == {"robot_0": "link_lost"}
    assert run.summary["interrupted"].startswith("link_lost")
    process.thaw()
    # Nobody sends heartbeats any more: its own failsafe acts, after 5 s.
    with Station(process.port) as station:
        station.wait(lambda: not station.latest["HEARTBEAT"].base_mode & 128, 30.0)
        assert station.latest["HEARTBEAT"].custom_mode == 16  # POSHOLD: the command arrived


def test_a_vehicle_without_gps_has_lost_its_position(start, tmp_path):
    process = start()
    with Door(tmp_path, [endpoint(process)]) as door, Station(process.second_port) as other:
        door.drive(3.0, DIVE)
        other.wait(lambda: other.peer, 5.0)
        other.set_parameter("SIM_GPS1_ENABLE", 0.0)
        code, run = door.wait()
        other.renew()
        other.wait(lambda: other.latest["HEARTBEAT"], 5.0)
        assert other.latest["HEARTBEAT"].custom_mode == 2  # ALT_HOLD needs no position
    assert code == 2
    assert "position_lost: robot_0" in door.errors()
    assert run.summary["vehicles"]["outcomes"] == {"robot_0": "position_lost"}


def test_a_pilot_takes_over(start, tmp_path):
    process = start()
    with Door(tmp_path, [endpoint(process)]) as door, Station(process.second_port) as pilot:
        door.drive(3.0, DIVE)
        pilot.wait(lambda: pilot.peer, 5.0)
        pilot.command(mav.MAV_CMD_DO_SET_MODE, 1, 19)
        door.drive(2.0, AHEAD)
        assert "takes no commands, it is MANUAL" in door.errors()
        code, run = door.end()
        pilot.renew()
        pilot.wait(lambda: pilot.latest["HEARTBEAT"], 5.0)
        assert pilot.latest["HEARTBEAT"].custom_mode == 19  # left alone
    assert code == 0
    assert run.summary["vehicles"]["end"] == ""


def test_two_vehicles_on_one_port(start, tmp_path):
    port = free_port()
    first = start(port=port, sysid=1)
    first.freeze()  # so that the second boots on the same port
    second = start(port=port, sysid=2)
    first.thaw()
    with Door(tmp_path, [endpoint(second)], count=2) as door:
        door.drive(6.0, DIVE)
        code, run = door.end()
        seen = [door.positions(robot) for robot in (0, 1)]
    assert code == 0, door.errors()
    for track in seen:
        assert track[0, 2] - track[-1, 2] > 0.8
    assert run.summary["vehicles"]["outcomes"] == {"robot_0": "flown", "robot_1": "flown"}
    assert json.loads(Path(run.path / "summary.json").read_text())["vehicles"]["system_ids"] == {
        "robot_0": 1,
        "robot_1": 2,
    }
