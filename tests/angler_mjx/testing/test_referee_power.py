"""The referee's power of thrusters with curves, by hand."""

import re

import numpy as np
import pytest

from angler_mjx.robot.vehicles import library
from angler_mjx.testing.referee.vehicles import read_robot

THRUSTER = """
name = "plain"
description = "A thruster of round numbers, the same at both voltages."
source = "by hand"
voltage_v = [10.0, 20.0]
pwm_us = [1100, 1300, 1500, 1700, 1900]
thrust_n = [[-40.0, -40.0], [-10.0, -10.0], [0.0, 0.0], [10.0, 10.0], [50.0, 50.0]]
power_w = [[400.0, 800.0], [50.0, 100.0], [0.0, 0.0], [50.0, 100.0], [500.0, 1000.0]]
"""


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    folder = tmp_path_factory.mktemp("curves")
    (folder / "plain.toml").write_text(THRUSTER)
    text = library.locate_vehicle("bluerov2").read_text(encoding="utf-8")
    text = text.replace('model = "t200"', 'model = "plain.toml"')
    curve = "curve = { pwm_us = [1100, 1500, 1900], thrust_n = [-10.0, 0.0, 200.0] }"
    text, count = re.subn(r"(spin = -?1) \}", rf"\1, {curve} }}", text, count=1)
    assert count == 1
    path = folder / "weak.toml"
    path.write_text(text)
    return read_robot({"vehicle": str(path), "battery_v": 15.0}, {})


@pytest.mark.parametrize(
    ("signal", "weak_w"),
    [
        (1100, 75.0),  # 10 N astern
        (1300, 37.5),  # 5 N astern
        (1500, 0.0),
        (1520, 75.0),  # 10 N ahead
        (1560, 75.0 + 675.0 * 20.0 / 40.0),  # 30 N
        (1900, 750.0 * 4.0**1.5),  # four times the file's greatest thrust
    ],
)
def test_a_curve_takes_the_power_of_its_thrust(robot, signal, weak_w):
    signals = np.full(6, 1500.0)
    signals[0] = signal
    assert robot.power(signals) == pytest.approx(weak_w)


def test_the_others_take_the_power_of_their_signal(robot):
    signals = np.full(6, 1500.0)
    signals[3] = 1800.0
    assert robot.power(signals) == pytest.approx((75.0 + 750.0) / 2.0)


def test_power_bounds_hold_the_power_of_all_signals_between(robot):
    rng = np.random.default_rng(0)
    signals = rng.uniform(1100, 1900, (50, 6))
    low, high = robot.power_bounds(signals, 2.0)
    inner = robot.power(signals + rng.uniform(-2.0, 2.0, (200, 50, 6)))
    assert np.all(inner >= low - 1e-9)
    assert np.all(inner <= high + 1e-9)


def test_dead_thrusters_draw_nothing(robot):
    variant = {"battery_v": 20.0, "drawn": {"thrust": [0.0, 1.0, 1.0, 1.0, 1.0, 1.0]}}
    signals = np.full(6, 1500.0)
    signals[:2] = 1900.0
    assert robot.with_variant(variant).power(signals) == pytest.approx(1000.0)
