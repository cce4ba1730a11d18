"""Real transports over loopback: Zenoh, the WebSocket of Foxglove, and rclpy where there is one."""

import asyncio
import contextlib
import json
import os
import socket
import struct
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import psutil
import pytest

from angler_mjx.errors import ConfigError

from .memory_backend import TRIGGER, TYPES, read_answer, served, twist

needs_zenoh = pytest.mark.skipif(find_spec("zenoh") is None, reason="eclipse-zenoh is missing")
needs_foxglove = pytest.mark.skipif(
    find_spec("foxglove") is None or find_spec("websockets") is None,
    reason="foxglove-sdk or websockets is missing",
)
needs_rclpy = pytest.mark.skipif(
    find_spec("rclpy") is None,
    reason="rclpy is missing; it comes with ROS 2, or with ros-kilted-rclpy in a Python of its own",
)
needs_control_msgs = pytest.mark.skipif(
    find_spec("rclpy") is None or find_spec("control_msgs") is None,
    reason="rclpy or control_msgs is missing; both come with ROS 2",
)
WAIT_S = 20.0


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def wait_for(condition, what):
    end = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < end, f"no {what} within {WAIT_S:g} s"
        time.sleep(0.01)


def key(topic, message):
    """The key of rmw_zenoh_cpp, with the hash that rosbags computes."""
    package, kind, short = message.split("/")
    digest = TYPES.hash_rihs01(message)
    return f"0/{topic}/{package}::{kind}::dds_::{short}_/{digest}"


def open_listener(port):
    """A session of Zenoh that knows nothing but the address."""
    import zenoh

    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["tcp/127.0.0.1:{port}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


@contextlib.contextmanager
def zenoh_door(session, scene, **settings):
    from angler_mjx.serve.backends.zenoh_backend import ZenohBackend

    port = free_port()
    backend = ZenohBackend("127.0.0.1", port, domain=0)
    try:
        with served(session, scene, backends=[backend], **settings) as door:
            yield door, port
    finally:
        backend.close()


@needs_zenoh
def test_over_zenoh_a_client_reads_drives_and_steps(session, scene):
    with zenoh_door(session, scene) as (_, port), open_listener(port) as client:
        odometry, kind = [], "nav_msgs/msg/Odometry"
        subscriber = client.declare_subscriber(
            key("robot_1/odometry", kind), lambda sample: odometry.append(sample)
        )
        publisher = client.declare_publisher(key("robot_1/cmd_vel", "geometry_msgs/msg/Twist"))

        def step():
            # The hash is that of the official generator of ROS 2 Kilted.
            hashed = "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
            selector = f"0/step/std_srvs::srv::dds_::Trigger_/{hashed}"
            attachment = struct.pack("<qqB", 7, 0, 16) + bytes(range(16))
            (reply,) = client.get(selector, payload=TRIGGER, attachment=attachment)
            answered = reply.ok.attachment.to_bytes()
            assert struct.unpack_from("<q", answered)[0] == 7  # the number of the request
            assert answered[17:] == bytes(range(16))
            return read_answer(reply.ok.payload.to_bytes())

        wait_for(lambda: step()[0] and odometry, "odometry")
        for _ in range(30):
            publisher.put(twist(0.4))
            assert step()[0]
        wait_for(lambda: len(odometry) > 30, "odometry of each step")
        last = TYPES.deserialize_cdr(odometry[-1].payload.to_bytes(), kind)
        assert last.twist.twist.linear.x == pytest.approx(0.4, abs=0.05)
        count, _, size = struct.unpack_from("<qqB", odometry[-1].attachment.to_bytes())
        before = struct.unpack_from("<q", odometry[-2].attachment.to_bytes())[0]
        assert (count, size) == (before + 1, 16)
        subscriber.undeclare()


@needs_zenoh
def test_the_graph_of_ros_is_announced(session, scene):
    with zenoh_door(session, scene) as (_, port), open_listener(port) as client:
        tokens = [str(reply.ok.key_expr) for reply in client.liveliness().get("@ros2_lv/0/**")]
    parts = [token.split("/") for token in tokens]
    assert {token[5] for token in parts} == {"NN", "MP", "MS", "SS"}
    assert all(token[6:9] == ["%", "%", "angler"] for token in parts)
    published = {token[9]: token[10:] for token in parts if token[5] == "MP"}
    kind, digest, quality = published["%robot_0%odometry"]
    assert kind == "nav_msgs::msg::dds_::Odometry_"
    assert digest == TYPES.hash_rihs01("nav_msgs/msg/Odometry")
    assert quality == "::,10:,:,:,,"
    assert published["%robot_0%plan"][2] == ":1:,1:,:,:,,"  # transient local
    assert {"%robot_1%cmd_vel"} <= {token[9] for token in parts if token[5] == "MS"}


@needs_zenoh
def test_who_comes_late_receives_the_plan(session, scene):
    import zenoh.ext

    with zenoh_door(session, scene) as (_, port), open_listener(port) as client:
        plans, kind = [], "nav_msgs/msg/Path"
        subscriber = zenoh.ext.declare_advanced_subscriber(
            client,
            key("robot_0/plan", kind),
            lambda sample: plans.append(sample.payload.to_bytes()),
            history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
        )
        wait_for(lambda: plans, "plan")
        assert len(TYPES.deserialize_cdr(plans[0], kind).poses) > 1
        subscriber.undeclare()


@needs_zenoh
def test_a_second_door_is_refused_and_only_loopback_is_open(session, scene):
    from angler_mjx.serve.backends.zenoh_backend import ZenohBackend

    with zenoh_door(session, scene) as (_, port):
        with pytest.raises(ConfigError, match=rf"--port {port}: .*in use"):
            ZenohBackend("127.0.0.1", port)
        listening = {
            (entry.laddr.ip, entry.laddr.port)
            for entry in psutil.Process().net_connections("inet")
            if entry.status == psutil.CONN_LISTEN or entry.type == socket.SOCK_DGRAM
        }
        assert listening == {("127.0.0.1", port)}


VANISH = """
import os, sys, time, zenoh

def die(sample):
    print("seen", flush=True)
    os.kill(os.getpid(), 9)

config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", f'["tcp/127.0.0.1:{sys.argv[1]}"]')
client = zenoh.open(config)
subscriber = client.declare_subscriber("0/**", die)
time.sleep(60)
"""


@needs_zenoh
def test_a_client_that_vanishes_stops_nothing(session, scene):
    with zenoh_door(session, scene, pace="max") as (door, port):
        client = subprocess.run(
            [sys.executable, "-c", VANISH, str(port)], capture_output=True, timeout=60, check=False
        )
        assert client.stdout.startswith(b"seen")
        assert client.returncode == -9
        with open_listener(port) as other:
            clocks = []
            other.declare_subscriber("0/clock/**", lambda sample: clocks.append(sample))
            wait_for(lambda: len(clocks) > 50, "clock")
        assert door.thread.is_alive()


async def read_channels(socket_, wanted):
    """Channels and services by name, once all wanted ones are announced."""
    channels, services = {}, {}
    while not wanted <= channels.keys() or not services:
        message = await asyncio.wait_for(socket_.recv(), WAIT_S)
        if isinstance(message, str):
            table = json.loads(message)
            for channel in table.get("channels", ()):
                channels[channel["topic"]] = channel
            for service in table.get("services", ()):
                services[service["name"]] = service
    return channels, services


async def watch(port, topics, steps):
    """Drive robot 0 and step by a plain WebSocket; returns the messages by topic."""
    import websockets

    async with websockets.connect(
        f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"], max_size=None
    ) as link:
        channels, services = await read_channels(link, set(topics))
        listed = [{"id": i, "channelId": channels[topic]["id"]} for i, topic in enumerate(topics)]
        await link.send(json.dumps({"op": "subscribe", "subscriptions": listed}))
        channel = {"id": 3, "topic": "/robot_0/cmd_vel", "encoding": "json"}
        channel["schemaName"] = "geometry_msgs/msg/Twist"
        await link.send(json.dumps({"op": "advertise", "channels": [channel]}))
        await asyncio.sleep(0.5)  # subscriptions are taken on the way
        received = {topic: [] for topic in topics}
        number = services["/step"]["id"]
        for call in range(steps):
            command = json.dumps({"linear": {"x": 0.4}}).encode()
            await link.send(b"\x01" + struct.pack("<I", 3) + command)
            head = struct.pack("<BIII", 2, number, call, 3) + b"cdr"
            await link.send(head + TRIGGER)
            answered = False
            while not answered:
                message = await asyncio.wait_for(link.recv(), WAIT_S)
                if isinstance(message, bytes) and message[0] == 1:
                    identity = struct.unpack_from("<I", message, 1)[0]
                    received[topics[identity]].append(message[13:])
                answered = isinstance(message, bytes) and message[0] == 3
        return received, channels


@needs_foxglove
def test_a_plain_websocket_client_sees_drives_and_steps(session, scene):
    from angler_mjx.serve.backends.foxglove_backend import FoxgloveBackend

    port = free_port()
    backend = FoxgloveBackend("127.0.0.1", port)
    try:
        with served(session, scene, backends=[backend]):
            with pytest.raises(ConfigError, match=f"--foxglove-port {port}"):
                FoxgloveBackend("127.0.0.1", port)
            topics = ["/robot_0/odometry", "/scenery", "/tf"]
            received, channels = asyncio.run(watch(port, topics, steps=40))
    finally:
        backend.close()
    assert channels["/robot_0/odometry"]["schemaName"] == "nav_msgs/msg/Odometry"
    assert len(received["/robot_0/odometry"]) >= 38
    last = TYPES.deserialize_cdr(received["/robot_0/odometry"][-1], "nav_msgs/msg/Odometry")
    assert last.twist.twist.linear.x == pytest.approx(0.4, abs=0.1)
    assert received["/scenery"]  # sent before it came
    assert len(received["/tf"]) >= 38


def test_the_layout_names_topics_that_there_are():
    from angler_mjx import serve
    from angler_mjx.serve.topics import list_published, velocity_topic

    from ..teleop.by_hand import robot_info

    text = (Path(serve.__file__).parent / "layouts" / "fleet.json").read_text()
    layout = json.loads(text)
    robots = [robot_info(i) for i in range(8)]
    there = {topic.name for topic in list_published(robots)}
    there |= {velocity_topic(robot).name for robot in robots}
    panel = layout["configById"]["3D!fleet"]
    assert panel["followTf"] == "map"
    named = set(panel["topics"]) | {layout["configById"]["Teleop!robot_0"]["topic"]}
    named |= {
        path["value"].partition(".")[0] for path in layout["configById"]["Plot!depth"]["paths"]
    }
    assert named <= there


@needs_rclpy
def test_a_node_of_ros_reads_drives_and_steps(session, scene):
    os.environ["ROS_DOMAIN_ID"] = str(100 + os.getpid() % 100)
    import rclpy
    from geometry_msgs.msg import Twist
    from nav_msgs.msg import Odometry
    from nav_msgs.msg import Path as Plan
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from std_srvs.srv import SetBool, Trigger

    from angler_mjx.serve.backends.rclpy_backend import RclpyBackend

    backend = RclpyBackend()
    context = rclpy.Context()
    try:
        with served(session, scene, backends=[backend]):
            with pytest.raises(ConfigError, match="already"):
                RclpyBackend()
            bound = {
                entry.laddr.ip
                for entry in psutil.Process().net_connections("inet")
                if entry.type == socket.SOCK_DGRAM
            }
            # The last is a group of multicast on the interface of loopback.
            assert bound <= {"127.0.0.1", "239.255.0.1"}
            context.init()
            node = rclpy.create_node("driver", context=context)
            executor = rclpy.executors.SingleThreadedExecutor(context=context)
            executor.add_node(node)
            odometry, plans = [], []
            node.create_subscription(Odometry, "/robot_1/odometry", odometry.append, 10)
            late = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            node.create_subscription(Plan, "/robot_1/plan", plans.append, late)
            publisher = node.create_publisher(Twist, "/robot_1/cmd_vel", 10)

            def call(kind, name, request):
                client = node.create_client(kind, name)
                assert client.wait_for_service(WAIT_S), name
                future = client.call_async(request)
                executor.spin_until_future_complete(future, timeout_sec=WAIT_S)
                node.destroy_client(client)
                return future.result()

            def spin_until(condition):
                end = time.monotonic() + WAIT_S
                while not condition() and time.monotonic() < end:
                    executor.spin_once(timeout_sec=0.01)
                assert condition()

            spin_until(lambda: publisher.get_subscription_count() > 0 and plans)
            assert len(plans[0].poses) > 1
            message = Twist()
            message.linear.x = 0.4
            for _ in range(40):
                publisher.publish(message)
                assert call(Trigger, "/step", Trigger.Request()).success
            spin_until(lambda: len(odometry) > 30)
            assert odometry[-1].twist.twist.linear.x == pytest.approx(0.4, abs=0.1)
            assert odometry[-1].header.frame_id == "map"
            assert call(SetBool, "/pause", SetBool.Request(data=True)).message == "paused"
            assert call(Trigger, "/reset", Trigger.Request()).message == "seed 3"
    finally:
        context.try_shutdown()
        backend.close()


def make_goal(kind, point, x, seconds):
    """A goal: robot_0 goes east to x in a time."""
    goal = kind.Goal()
    goal.trajectory.joint_names = ["x"]
    goal.trajectory.points = [point(positions=[x])]
    goal.trajectory.points[0].time_from_start.sec = seconds
    return goal


@needs_control_msgs
def test_an_action_client_of_ros_sends_watches_and_cancels(session, scene):
    os.environ["ROS_DOMAIN_ID"] = str(100 + os.getpid() % 100)
    import rclpy
    from action_msgs.msg import GoalStatus
    from control_msgs.action import FollowJointTrajectory
    from rclpy.action import ActionClient
    from trajectory_msgs.msg import JointTrajectoryPoint

    from angler_mjx.serve.backends.interface import ACTION
    from angler_mjx.serve.backends.rclpy_backend import RclpyBackend

    backend = RclpyBackend()
    assert ACTION not in backend.missing
    context = rclpy.Context()
    try:
        with served(session, scene, backends=[backend], pace=4.0) as door:
            context.init()
            node = rclpy.create_node("planner", context=context)
            executor = rclpy.executors.SingleThreadedExecutor(context=context)
            executor.add_node(node)
            name = "/robot_0/joint_trajectory_controller/follow_joint_trajectory"
            client = ActionClient(node, FollowJointTrajectory, name)
            assert client.wait_for_server(WAIT_S)
            feedback = []

            def finish(future):
                executor.spin_until_future_complete(future, timeout_sec=WAIT_S)
                assert future.done()
                return future.result()

            def send(x, seconds):
                goal = make_goal(FollowJointTrajectory, JointTrajectoryPoint, x, seconds)
                return finish(client.send_goal_async(goal, lambda m: feedback.append(m.feedback)))

            start = float(session.observe().estimate.p[0, 0])  # it is on its plan meanwhile
            handle = send(start + 1.0, 8)
            assert handle.accepted
            done = finish(handle.get_result_async())
            assert done.status == GoalStatus.STATUS_SUCCEEDED
            assert done.result.error_code == FollowJointTrajectory.Result.SUCCESSFUL
            assert len(feedback) > 20
            column = list(feedback[0].joint_names).index("x")
            assert feedback[0].actual.positions[column] == pytest.approx(start, abs=0.6)
            assert feedback[-1].actual.positions[column] == pytest.approx(start + 1.0, abs=0.2)
            away = send(40.0, 400)
            assert away.accepted
            before = len(feedback)
            while len(feedback) < before + 10:
                executor.spin_once(timeout_sec=0.1)
            assert finish(away.cancel_goal_async()).goals_canceling
            ended = finish(away.get_result_async())
            assert ended.status == GoalStatus.STATUS_CANCELED
            assert not send(90.0, 1).accepted  # 92 m in a second
            assert "PoseTarget" in session.observe().status[0].command
            assert not door.reports or "refusals" in door.reports[-1]
    finally:
        context.try_shutdown()
        backend.close()
