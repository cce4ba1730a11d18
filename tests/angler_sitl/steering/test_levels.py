"""What our own controllers make of commands at each level, before they are sent."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control import stack
from angler_mjx.robot.control.commands import (
    BodyTwist,
    Estimate,
    PoseTarget,
    ThrusterPwm,
    TrackingTarget,
)
from angler_mjx.robot.control.commands.joint_goal import JointGoal
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.laws.guided import LEASH_M, LEASH_RAD
from angler_mjx.runs.session.interface import RobotInfo
from angler_mjx.sim.state import SimSpec
from angler_sitl.firmware.parameters import LEVELS
from angler_sitl.steering import levels, sticks
from angler_sitl.wire import messages

DT = 0.05


def estimate(p=(0.0, 0.0, -3.0), yaw=0.5):
    q = jnp.array([np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)])
    return Estimate(p=jnp.array(p), q=q, nu=jnp.zeros(6))


@pytest.fixture(scope="module")
def guided():
    """A step of the level: (memory, estimate, command) -> (memory, target)."""
    spec = levels.build_level_spec("guided", SimSpec())

    @jax.jit
    def step(memory, known, command):
        # The vehicle's parameters are not looked at.
        action = stack.step(spec.stages, spec.gains, None, memory, known, command, DT, 1000.0, 9.81)
        return action.memory, action.command

    known = estimate()
    return partial(stack.reset, spec.stages)(known, jnp.asarray(0.5)), step


def test_a_twist_moves_the_target_on_along_the_robots_own_axes(guided):
    memory, step = guided
    twist = BodyTwist(nu=jnp.array([0.3, -0.1, 0.05, 0, 0, 0.2]))
    known, ahead = estimate(), np.zeros(3)
    for _ in range(8):
        memory, target = step(memory, known, twist)
        turn = np.array([[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]])
        velocity = np.array([*(turn @ [0.3, -0.1]), 0.05])
        ahead += DT * velocity
        # float32 sums of eight steps.
        np.testing.assert_allclose(target.position_m, known.p + ahead, atol=1e-5)
        np.testing.assert_allclose(target.velocity_mps, velocity, atol=1e-6)
    assert float(target.yaw_rad) == pytest.approx(0.5 + 8 * DT * 0.2, abs=1e-5)


def test_the_target_of_a_twist_waits_for_a_robot_that_is_behind(guided):
    memory, step = guided
    twist = BodyTwist(nu=jnp.array([1.0, 0, 0, 0, 0, 1.0]))
    for _ in range(60):
        memory, target = step(memory, estimate(), twist)
    lead = np.linalg.norm(np.asarray(target.position_m) - [0, 0, -3.0])
    # The leash, and one step beyond it.
    assert lead == pytest.approx(LEASH_M + DT, abs=1e-4)
    assert float(target.yaw_rad) == pytest.approx(0.5 + LEASH_RAD + DT, abs=1e-4)


def test_a_twist_begins_where_the_robot_is_and_not_at_the_pose_before(guided):
    memory, step = guided
    far = PoseTarget(
        position_m=jnp.array([9.0, 9.0, -9.0]), velocity_mps=jnp.zeros(3), yaw_rad=jnp.asarray(2.0)
    )
    memory, target = step(memory, estimate(), far)
    np.testing.assert_array_equal(target.position_m, far.position_m)
    assert float(target.yaw_rad) == 2.0
    memory, target = step(memory, estimate(), BodyTwist(nu=jnp.zeros(6)))
    np.testing.assert_allclose(target.position_m, [0, 0, -3.0], atol=1e-6)
    assert float(target.yaw_rad) == pytest.approx(0.5, abs=1e-6)


def test_sticks_are_let_go_where_a_robot_is_to_stay():
    spec = levels.build_level_spec("poshold", SimSpec())
    known = estimate()
    memory = stack.reset(spec.stages, known, jnp.asarray(0.5))

    def output(command):
        step = partial(stack.step, spec.stages, spec.gains, None, memory, known)
        return step(command, DT, 1000.0, 9.81).command

    nu = jnp.array([0.1, 0.2, 0.3, 0, 0, 0.4])
    np.testing.assert_array_equal(output(BodyTwist(nu=nu)).nu, nu)
    here = PoseTarget(position_m=known.p, velocity_mps=jnp.zeros(3), yaw_rad=jnp.asarray(0.5))
    np.testing.assert_array_equal(output(here).nu, np.zeros(6))


ROBOT = RobotInfo(
    name="robot_0",
    vehicle="",
    parameter_set="",
    radius_m=0.3,
    cruise_speed_mps=0.5,
    max_speed_mps=np.array([1.0, 0.8, 0.5]),
    max_turn_radps=2.0,
    thrusters=(),
    accepts=(BodyTwist,),
)


def test_sticks_are_shares_of_the_top_speeds():
    half = np.array([0.5, -0.4, 0.25, 9, 9, -1.0])
    deflection = sticks.twist_to_sticks("manual", ROBOT, half)
    np.testing.assert_allclose(deflection, [0.5, -0.5, 0.5, -0.5])
    sent = messages.build_manual_control(1, deflection)
    # Right and clockwise are positive there, and 500 is neither up nor down.
    assert (sent.x, sent.y, sent.z, sent.r) == (500, 500, 750, 500)
    beyond = messages.build_manual_control(1, np.array([-9.0, -9, 9, -9]))
    assert (beyond.x, beyond.y, beyond.z, beyond.r) == (-1000, 1000, 1000, 1000)
    assert sticks.stick_parameters("manual", ROBOT) == {}


def climb(stick, scales):
    """The firmware's climb rate, cm/s: its throttle counts from RC3_MIN + RC3_DZ to RC3_MAX."""
    throttle, middle = (1000 * (1500 + 400 * z - 1130) / 770 for z in (stick, 0.0))
    if throttle > middle + 100:
        return scales["PILOT_SPEED_UP"] * (throttle - middle - 100) / (1000 - middle - 100)
    return scales["PILOT_SPEED_DN"] * (throttle - middle + 100) / (middle - 100)


def test_where_a_stick_is_a_velocity_the_dead_zone_is_jumped_over():
    scales = sticks.stick_parameters("poshold", ROBOT)
    nu = np.array([0.3, -0.2, 0.1, 0, 0, 0.4])
    x, y, z, turn = sticks.twist_to_sticks("poshold", ROBOT, nu)
    # As the firmware reads them: PILOT_SPEED counts from the end of the dead zone.
    assert (abs(x) - 0.25) * scales["PILOT_SPEED"] == pytest.approx(30.0, abs=0.3)  # whole cm/s
    assert (abs(y) - 0.25) * scales["PILOT_SPEED"] == pytest.approx(20.0, abs=0.3)
    assert (x > 0, y < 0) == (True, True)
    assert climb(z, scales) == pytest.approx(10.0)
    down = sticks.twist_to_sticks("poshold", ROBOT, -nu)[2]
    assert climb(down, scales) == pytest.approx(-10.0)
    assert (turn - 0.1) / 0.9 * 4500 * 3.375 == pytest.approx(100 * np.degrees(0.4))
    np.testing.assert_array_equal(
        sticks.twist_to_sticks("poshold", ROBOT, np.zeros(6)), np.zeros(4)
    )
    level = sticks.twist_to_sticks("althold", ROBOT, nu)[:2]
    np.testing.assert_allclose(level, [0.3, -0.25])  # thrust there, without a dead zone


def test_each_level_takes_what_it_can_follow():
    ours = (Trajectory, PoseTarget, ThrusterPwm, JointGoal)
    assert levels.accepted_command_types("thrusters", ours) == ours
    guided = levels.accepted_command_types("guided", ours)
    assert {Trajectory, PoseTarget, TrackingTarget, BodyTwist, JointGoal} < set(guided)
    assert ThrusterPwm not in guided
    for level in levels.STICK_LEVELS:
        assert levels.accepted_command_types(level, ours) == (BodyTwist,)
    assert set(levels.LEVEL_MODES) == set(LEVELS)
    with pytest.raises(ConfigError, match=r"'autopilot'.*guided"):
        levels.build_level_spec("autopilot", SimSpec())
