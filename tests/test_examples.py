"""Examples of docs/examples run, are short, and do what they say."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).parents[1] / "docs" / "examples"
MAX_LINES = 60
OF_ROS = {"ros2_node", "ros2_listener"}
"""Examples that need a network of ROS 2, and are imported only."""


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
    assert file.stem in OF_ROS or f'load("{file.stem}"' in Path(__file__).read_text("utf-8")


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


@pytest.mark.parametrize("name", sorted(OF_ROS))
def test_nodes_of_ros_are_made(name, monkeypatch):
    rclpy = pytest.importorskip(
        "rclpy", reason="rclpy is missing; it comes with ROS 2, or ros-kilted-rclpy"
    )
    module = load(name, monkeypatch)
    rclpy.init()
    try:
        node = getattr(module, "Listener", None) or module.CircleFleet
        node(2).destroy_node()
    finally:
        rclpy.shutdown()
