"""Modes, silence, speeds and frames: what a row of keys makes of commands."""

import math
from dataclasses import replace

import numpy as np
import pytest

from angler_mjx.robot.control.commands import BodyTwist, PoseTarget
from angler_mjx.teleop import pilot as module
from angler_mjx.teleop.keys import FACTORS, MOVES, STILL
from angler_mjx.teleop.pilot import BRAKE_S, DriveMode, TeleopPilot

from .by_hand import observed, turned

FLOAT32 = 1e-6
"""Commands are of order 1 in float32, with a handful of operations behind them."""


@pytest.fixture
def pilot(robots):
    """Drives robots 0 and 2 of three."""
    return TeleopPilot(robots, (0, 2), speed_mps=0.5, turn_radps=0.4, silence_s=0.8)


def told(pilot, **what):
    return pilot.build_commands(observed(**what))


def nu_of(orders, robot):
    assert isinstance(orders.commands[robot], BodyTwist)
    return np.asarray(orders.commands[robot].nu)


def test_without_a_key_nobody_is_told_anything(pilot):
    for time in (0.0, 5.0, 60.0):
        orders = told(pilot, time_s=time)
        assert orders.commands == {}
        assert orders.resume == ()
    assert [pilot.mode(i) for i in range(3)] == [DriveMode.PLAN] * 3


@pytest.mark.parametrize("key", [key for key in MOVES if MOVES[key] != STILL])
def test_a_level_robot_is_told_the_key_times_the_speeds(pilot, key):
    pilot.press(key, 0.0)
    surge, sway, heave, yaw = MOVES[key]
    # 0.5 m/s lies within what the vehicle can do along each axis.
    wanted = [0.5 * surge, 0.5 * sway, 0.5 * heave, 0.0, 0.0, 0.4 * yaw]
    orders = told(pilot)
    np.testing.assert_allclose(nu_of(orders, 0), wanted, atol=FLOAT32)
    assert set(orders.commands) == {0}


def test_the_frame_is_level_whatever_the_robot_does(pilot):
    # Heading north (90 degrees), nose 30 degrees down; a person sees the robot go level.
    q = np.tile(turned(yaw=math.pi / 2, pitch=math.pi / 6), (3, 1))
    cos, sin = math.cos(math.pi / 6), math.sin(math.pi / 6)
    wanted = {
        "i": [0.5 * cos, 0.0, 0.5 * sin, 0.0, 0.0, 0.0],
        "J": [0.0, 0.5, 0.0, 0.0, 0.0, 0.0],
        "t": [-0.5 * sin, 0.0, 0.5 * cos, 0.0, 0.0, 0.0],
        "j": [0.0, 0.0, 0.0, -0.4 * sin, 0.0, 0.4 * cos],
    }
    # And it is turned upright: the nose up, about F's y axis.
    righting = np.array([0.0, 0.0, 0.0, 0.0, -module.RIGHTING_PER_S * sin, 0.0])
    for key, nu in wanted.items():
        pilot.press(key, 0.0)
        np.testing.assert_allclose(nu_of(told(pilot, q=q), 0), nu + righting, atol=FLOAT32)


def test_a_robot_that_turns_as_it_is_told_comes_upright(pilot):
    q, dt = turned(yaw=0.7, pitch=0.9), 0.05
    pilot.press("j", 0.0)
    for _ in range(200):
        pilot.press("j", 0.0)
        rate = nu_of(told(pilot, q=np.tile(q, (3, 1))), 0)[3:]
        # Kinematics of the attitude: dq/dt = q (0, omega) / 2.
        w, v = q[0], q[1:]
        q = q + 0.5 * dt * np.append(-v @ rate, w * rate + np.cross(v, rate))
        q /= np.linalg.norm(q)
    # Ten seconds, and a time constant of one: the tilt is that of a level robot, whatever it turns.
    assert np.hypot(q[1], q[2]) < 1e-3


def test_speed_keys_multiply_and_the_vehicle_limits(pilot):
    for key in FACTORS:
        before = pilot.speed_mps, pilot.turn_radps
        pilot.press(key, 0.0)
        assert pilot.speed_mps == pytest.approx(before[0] * FACTORS[key][0])
        assert pilot.turn_radps == pytest.approx(before[1] * FACTORS[key][1])
    for _ in range(30):
        pilot.press("q", 0.0)
    assert pilot.speed_mps > 5.0
    assert pilot.turn_radps > 5.0
    # The vehicle does 1.4, 0.7 and 0.6 m/s along its axes and turns with 0.9 rad/s; what asks for
    # more is slowed without a change of direction.
    limits = {"i": [1.4, 0, 0], "J": [0, 0.7, 0], "b": [0, 0, -0.6], "O": [0.7, -0.7, 0]}
    for key, linear in limits.items():
        pilot.press(key, 0.0)
        np.testing.assert_allclose(nu_of(told(pilot), 0), [*linear, 0, 0, 0], atol=FLOAT32)
    pilot.press("l", 0.0)
    assert nu_of(told(pilot), 0)[5] == pytest.approx(-0.9)


def test_tab_goes_round_and_a_takes_all(pilot):
    assert pilot.selected == (0,)
    for wanted in ((2,), (0,)):
        pilot.press("\t", 0.0)
        assert pilot.selected == wanted
    pilot.press("a", 0.0)
    pilot.press("i", 0.0)
    assert set(told(pilot).commands) == {0, 2}
    pilot.press("\t", 0.0)
    assert pilot.selected == (0,)


def test_silence_brakes_and_then_holds_where_the_robot_came_to_rest(pilot):
    pilot.press("i", 1.0)
    moving = [[0.5, 0, 0, 0, 0, 0]] * 3
    # Up to the silence that was set it drives on.
    assert nu_of(told(pilot, time_s=1.8, nu=moving), 0)[0] == pytest.approx(0.5)
    assert pilot.mode(0) is DriveMode.TELEOP
    braking = told(pilot, time_s=1.85, nu=moving)
    np.testing.assert_array_equal(nu_of(braking, 0), 0.0)
    assert pilot.mode(0) is DriveMode.STOPPING
    # A twist of zero is latched: it is told once.
    assert told(pilot, time_s=1.9, nu=moving).commands == {}
    at_rest = observed(2.4, p=[[4.0, 5.0, -6.0]] * 3, q=[turned(yaw=0.7, pitch=0.2)] * 3)
    target = pilot.build_commands(at_rest).commands[0]
    assert isinstance(target, PoseTarget)
    np.testing.assert_allclose(target.position_m, [4.0, 5.0, -6.0])
    np.testing.assert_array_equal(target.velocity_mps, 0.0)
    assert float(target.yaw_rad) == pytest.approx(0.7, abs=FLOAT32)
    assert pilot.mode(0) is DriveMode.HOLD
    assert told(pilot, time_s=9.0).commands == {}


def test_a_robot_that_the_current_carries_away_still_ends_in_a_hold(pilot):
    pilot.press("i", 0.0)
    pilot.press("k", 0.1)
    carried = [[0.3, 0, 0, 0, 0, 0]] * 3
    told(pilot, time_s=0.1, nu=carried)
    assert told(pilot, time_s=0.1 + BRAKE_S, nu=carried).commands == {}
    last = told(pilot, time_s=0.15 + BRAKE_S, nu=carried)
    assert isinstance(last.commands[0], PoseTarget)


def test_a_key_in_time_keeps_the_robot_going(pilot):
    for time in np.arange(0.0, 5.0, 0.7):
        pilot.press("i", time)
        assert nu_of(told(pilot, time_s=time + 0.7), 0)[0] == pytest.approx(0.5)
    # A speed key is a sign of life as well; help is not.
    pilot.press("i", 10.0)
    pilot.press("w", 10.7)
    assert nu_of(told(pilot, time_s=11.4), 0)[0] == pytest.approx(0.55)
    pilot.press("?", 11.4)
    told(pilot, time_s=11.6)
    assert pilot.mode(0) is DriveMode.STOPPING


def test_a_robot_that_is_left_by_tab_stops_by_itself(pilot):
    pilot.press("i", 0.0)
    pilot.press("\t", 0.1)
    pilot.press("i", 0.7)
    told(pilot, time_s=0.9)
    assert pilot.mode(0) is DriveMode.STOPPING
    assert pilot.mode(2) is DriveMode.TELEOP


@pytest.mark.parametrize("key", ["k", "K", " ", "\r", "\x1b", "y", "é"])
def test_any_other_key_stops_even_a_plan(pilot, key):
    pilot.press(key, 0.0)
    np.testing.assert_array_equal(nu_of(told(pilot), 0), 0.0)
    assert pilot.mode(0) is DriveMode.STOPPING
    assert pilot.mode(2) is DriveMode.PLAN


def test_hold_and_plan_are_told_once(pilot):
    pilot.press("h", 0.0)
    assert isinstance(told(pilot, nu=[[0.5] * 6] * 3).commands[0], PoseTarget)
    assert told(pilot).commands == {}
    pilot.press("p", 1.0)
    assert told(pilot).resume == (0,)
    assert told(pilot).resume == ()
    pilot.press("p", 2.0)
    assert told(pilot).resume == ()


def test_a_refusal_stops_the_robot_and_is_told_until_the_next_key(pilot):
    pilot.press("h", 0.0)
    told(pilot)
    pilot.press("p", 1.0)
    assert told(pilot).resume == (0,)
    pilot.refuse(0, "it has no plan", 1.0)
    assert pilot.remark(0) == "it has no plan"
    np.testing.assert_array_equal(nu_of(told(pilot, time_s=1.05), 0), 0.0)
    pilot.press("i", 2.0)
    assert pilot.remark(0) == ""


def test_the_end_is_asked_for_by_two_keys(robots):
    for key in ("Q", "\x03"):
        pilot = TeleopPilot(robots, (0,), speed_mps=0.5, turn_radps=0.5)
        assert not pilot.ended
        pilot.press(key, 0.0)
        assert pilot.ended


def test_the_silence_outlasts_the_longest_usual_delay_of_a_keyboard():
    # 0.66 s is the X server's own default (XkbDfltRepeatDelay); desktops set 0.5 s or less.
    assert module.KEY_TIMEOUT_S > 0.66 + 0.05


def test_a_robot_that_takes_velocities_alone_is_let_go_where_another_holds(robots):
    sticks = [replace(robot, accepts=(BodyTwist,)) for robot in robots]
    pilot = TeleopPilot(sticks, (0,), speed_mps=0.5, turn_radps=0.5)
    pilot.press("h", 0.0)
    (order,) = pilot.build_commands(observed()).commands.values()
    np.testing.assert_array_equal(order.nu, np.zeros(6))
