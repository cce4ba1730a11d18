"""`angler serve --level` on a real ArduSub: the topics of a simulated robot drive it."""

import socket
import struct
import subprocess
import sys
import time

import pytest
from rosbags.typesys import Stores, get_typestore

pytestmark = pytest.mark.sitl

SCENE = """
schema_version = 1
name = "one"
seed = 3

[time]
horizon_s = 60.0

[world]
preset = "open"
placement = "given"
start_m = [[0.0, 0.0, -4.0]]
goal_m = [[0.0, 6.0, -4.0]]

[[fleet]]
vehicle = "bluerov2_heavy"
"""
START_S = 240.0


def test_a_real_autopilot_follows_cmd_vel(ardusub, tmp_path):
    zenoh = pytest.importorskip("zenoh")
    (tmp_path / "one.toml").write_text(SCENE)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    words = ["serve", "one.toml", "--level", "guided", "--backend", "zenoh", "--port", str(port)]
    door = subprocess.Popen(
        [sys.executable, "-m", "angler_mjx.cli.main", *words, "--duration", "12"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        text=True,
    )
    types, kind = get_typestore(Stores.ROS2_JAZZY), "nav_msgs/msg/Odometry"
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["tcp/127.0.0.1:{port}"]')
    config.insert_json5("connect/timeout_ms", "60000")
    config.insert_json5("scouting/multicast/enabled", "false")
    try:
        seen = []
        with zenoh.open(config) as client:
            client.declare_subscriber("0/robot_0/odometry/**", seen.append)
            digest = types.hash_rihs01("geometry_msgs/msg/Twist")
            publisher = client.declare_publisher(
                f"0/robot_0/cmd_vel/geometry_msgs::msg::dds_::Twist_/{digest}"
            )
            end = time.monotonic() + START_S
            while door.poll() is None and time.monotonic() < end:
                if seen:
                    data = b"\x00\x01\x00\x00" + struct.pack("<6d", 0.3, 0, 0, 0, 0, 0)
                    publisher.put(data)
                time.sleep(0.05)
        output, _ = door.communicate(timeout=60)
    finally:
        door.kill()
    assert door.returncode == 0
    assert "robot_0: running, BodyTwist" in output
    motions = [types.deserialize_cdr(sample.payload.to_bytes(), kind) for sample in seen]
    first, last = (motions[i].pose.pose.position for i in (0, -1))
    assert last.x - first.x > 1.0 or last.y - first.y > 1.0
    assert abs(last.z + 4.0) < 0.5
    assert motions[-1].twist.twist.linear.x > 0.1
