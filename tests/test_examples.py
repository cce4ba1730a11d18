"""Examples of docs/examples run, are short, and do what they say."""

import importlib.util
import math
import os
import sys
import time
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).parents[1] / "docs" / "examples"
MAX_LINES = 60
WAIT_S = 20.0
"""Longest wait for messages of ROS 2."""


def load(name, monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    spec = importlib.util.spec_from_file_location(f"example_{name}", FOLDER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("file", sorted(FOLDER.glob("*.py")), ids=lambda file: file.stem)
def test_an_example_is_short_and_tested(file):
    lines = file.read_text(encoding="utf-8").splitlines()
    assert len(lines) < MAX_LINES
    assert f'load("{file.stem}"' in Path(__file__).read_text("utf-8")


def test_rollout(tmp_path, monkeypatch):
    run = load("rollout", monkeypatch).main(tmp_path / "run")
    assert run.episodes.num_rows == 8 * 4
    assert (tmp_path / "run" / "summary.json").is_file()


def test_policy_a_faster_one_comes_nearer(monkeypatch):
    slow, middle, fast = load("policy", monkeypatch).main()
    assert fast < middle < slow


def test_planner_keeps_its_contract_and_answers_for_each_robot(monkeypatch):
    answers = load("planner", monkeypatch).main()  # raises where the contract is broken
    assert len(answers) == 4
    assert any(answer.endswith(" s") for answer in answers)


def test_current_costs_power(monkeypatch):
    power_w = load("current", monkeypatch).main()
    assert 0 < power_w["slow"] < power_w["fast"]


def test_vehicle_a_heavier_one_needs_more_energy(tmp_path, monkeypatch):
    energy_j = load("vehicle", monkeypatch).main(tmp_path)
    assert (tmp_path / "heavier.toml").is_file()
    # 2 kg that nothing bears up: its thrusters hold 20 N all the time.
    assert 0 < 1.02 * energy_j["bluerov2_heavy"] < energy_j["heavier"]


def test_task_a_larger_team_has_seen_more(tmp_path, monkeypatch):
    seen = load("task", monkeypatch).main(tmp_path)
    assert 0 < seen[3] < seen[4] <= 1


def test_gradient_is_the_difference_of_flights(monkeypatch):
    slope, difference = load("gradient", monkeypatch).main()
    assert slope < 0  # faster is nearer
    np.testing.assert_allclose(slope, difference, rtol=0.02)


def test_session_a_robot_rises_and_goes_back_to_its_plan(monkeypatch):
    rose_m, commands = load("session", monkeypatch).main()
    # 2 s at 0.2 m/s, less the time it takes to get there
    assert 0.2 < rose_m < 0.42
    assert commands == ["BodyTwist", "plan", "plan", "plan", "plan"]


@pytest.fixture
def ros(monkeypatch):
    """A network of ROS 2, and a node of the test in it."""
    rclpy = pytest.importorskip(
        "rclpy", reason="rclpy is missing; it comes with ROS 2, or ros-kilted-rclpy"
    )
    monkeypatch.setenv("ROS_DOMAIN_ID", str(100 + os.getpid() % 100))
    rclpy.init()
    try:
        yield rclpy.create_node("fleet")
    finally:
        rclpy.shutdown()


def spin_until(condition, *nodes):
    from rclpy.executors import SingleThreadedExecutor

    executor = SingleThreadedExecutor()
    for node in nodes:
        executor.add_node(node)
    end = time.monotonic() + WAIT_S
    while not condition() and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.05)
    assert condition()


def test_ros2_listener_keeps_positions_and_least_clearances(ros, monkeypatch):
    from nav_msgs.msg import Odometry
    from sensor_msgs.msg import Range

    listener = load("ros2_listener", monkeypatch).Listener(2)
    positions = ros.create_publisher(Odometry, "/robot_1/odometry", 10)
    clearances = ros.create_publisher(Range, "/robot_1/clearance", 10)
    odometry = Odometry()
    odometry.pose.pose.position.z = -5.0

    publishers = (positions, clearances)
    spin_until(lambda: all(each.get_subscription_count() for each in publishers), ros, listener)
    positions.publish(odometry)
    for clearance_m in (0.75, 0.25, 0.5):
        clearances.publish(Range(range=clearance_m))
    spin_until(lambda: listener.position_m and listener.least_m[1] == 0.25, ros, listener)
    assert listener.position_m == {1: (0.0, 0.0, -5.0)}
    assert listener.least_m[0] == math.inf
    listener.report()


def test_ros2_node_turns_each_robot_its_way_and_back_to_its_depth(ros, monkeypatch):
    from geometry_msgs.msg import Twist
    from nav_msgs.msg import Odometry

    module = load("ros2_node", monkeypatch)
    fleet = module.CircleFleet(2)
    twists = {0: [], 1: []}
    publishers = []
    for i, got in twists.items():
        publishers.append(ros.create_publisher(Odometry, f"/robot_{i}/odometry", 10))
        ros.create_subscription(Twist, f"/robot_{i}/cmd_vel", got.append, 10)

    def is_commanded():
        odometry = Odometry()
        odometry.pose.pose.position.z = -5.0 if len(fleet.depths) < 2 else -5.05
        for publisher in publishers:
            publisher.publish(odometry)
        return all(got and got[-1].linear.z > 0 for got in twists.values())

    spin_until(is_commanded, ros, fleet)
    assert twists[0][-1].linear.z == pytest.approx(0.05)
    assert twists[0][-1].linear.x == pytest.approx(module.SPEED_MPS)
    assert twists[0][-1].angular.z == -twists[1][-1].angular.z == pytest.approx(-0.25)
