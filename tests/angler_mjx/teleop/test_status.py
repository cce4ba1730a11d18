"""What the screen says of a scene, and that it fits 80 columns."""

import math

import numpy as np
import pytest

from angler_mjx.runs.session.interface import RobotStatus
from angler_mjx.sim.state import Outcome
from angler_mjx.teleop import status
from angler_mjx.teleop.pace import Overruns
from angler_mjx.teleop.pilot import TeleopPilot

from .by_hand import observed, turned


@pytest.fixture
def pilot(robots):
    return TeleopPilot(robots, (0, 2), speed_mps=0.5, turn_radps=0.4)


def shown(robots, pilot, observation, overruns=None):
    lines = status.format_screen("reef, world 3", robots, observation, pilot, overruns)
    assert max(map(len, lines)) <= 79
    return lines


def row(lines, name):
    return next(line for line in lines if f" {name} " in line).split()


def test_a_line_for_each_robot(robots, pilot):
    pilot.press("i", 0.0)
    observation = observed(
        12.34,
        p=[[0, 0, -4.5], [0, 0, -10.25], [0, 0, -1]],
        q=[turned(), turned(yaw=math.pi / 2), turned(yaw=-math.pi)],
        nu=[[0.3, 0.4, 0, 0, 0, 9], [0] * 6, [0] * 6],
    )
    lines = shown(robots, pilot, observation, Overruns(count=1, worst_s=0.0123))
    assert lines[0] == "reef, world 3  12.3 s  1 overrun, worst 12 ms"
    # East is 90 on a compass, north is 0, west is 270.
    assert row(lines, "robot_0") == [
        ">", "robot_0", "4.50", "90", "0.50", "1.25", "teleop", "running"
    ]  # fmt: skip
    assert row(lines, "robot_1") == ["robot_1", "10.25", "0", "0.00", "1.25", "plan", "running"]
    assert row(lines, "robot_2")[2] == "270"


def test_a_refusal_is_marked_and_told_in_full(robots, pilot):
    long = "robot_0: nu[0] = 9 m/s is faster than the vehicle, which reaches 1.4 m/s; " * 2
    fine = RobotStatus(outcome=Outcome.RUNNING, command="plan")
    refused = RobotStatus(outcome=Outcome.COLLISION_DYNAMIC, command="BodyTwist", refused=long)
    noted = RobotStatus(outcome=Outcome.REACHED, command="plan", note="goal reached")
    pilot.press("i", 0.0)
    lines = shown(robots, pilot, observed(status=[refused, fine, noted]))
    assert row(lines, "robot_0")[-3:] == ["hold", "collision_dynamic", "refused"]
    assert "refused" not in row(lines, "robot_1")
    told = " ".join(line.strip() for line in lines)
    assert long.strip() in told
    assert "robot_2: goal reached" in lines


def test_nobody_knows_the_clearance_and_nobody_keeps_time(robots, pilot):
    observation = observed()
    object.__setattr__(observation, "clearance_m", None)
    lines = shown(robots, pilot, observation)
    assert row(lines, "robot_1")[4] == "-"
    assert "as fast as possible" in lines[0]


def test_help_comes_and_goes(robots, pilot):
    before = shown(robots, pilot, observed())
    pilot.press("?", 0.0)
    assert len(shown(robots, pilot, observed())) > len(before) + 5
    pilot.press("?", 0.0)
    assert shown(robots, pilot, observed()) == before


def test_the_longest_things_still_fit(robots, pilot):
    pilot.speed_mps = pilot.turn_radps = 123.456
    far = observed(98765.4, p=np.full((3, 3), -12345.6), nu=np.full((3, 6), 77.7))
    shown(robots, pilot, far, Overruns(count=123456, worst_s=12.3456))


def test_compass_of_every_heading():
    for yaw in np.linspace(-3.0, 3.0, 13):
        wanted = (90.0 - math.degrees(yaw)) % 360.0
        # An attitude has its heading to float64; pitch does not change it.
        assert status.compass_heading_deg(turned(yaw, 0.3)) == pytest.approx(wanted, abs=1e-9)
