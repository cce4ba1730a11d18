"""Stages stacked: where commands enter, what is remembered, what is refused. One robot, float32."""

import itertools
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import quaternion
from angler_mjx.errors import ConfigError
from angler_mjx.robot.control import allocation, stack, stages
from angler_mjx.robot.control.commands import (
    BodyTwist,
    BodyWrench,
    Estimate,
    PoseTarget,
    ThrusterPwm,
    TrackingTarget,
    joint_trajectory,
)
from angler_mjx.robot.control.commands.joint_goal import JointGoal, JointPoint
from angler_mjx.robot.control.commands.joint_goal import build_trajectory as build_goal
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.laws import follow

DT, DENSITY, GRAVITY = 0.05, 1000.0, 9.81
PATH = Trajectory(
    time_s=jnp.array([0.0, 8.0, 16.0]),
    position_m=jnp.array([[0.3, 0.0, -10.0], [4.0, 0.0, -10.0], [4.0, 4.0, -11.0]]),
    found=jnp.array(True),
)


def run(robot, names, command, memory=None):
    """One step of a stack with its own gains, and the memory before it."""
    known, at = robot
    made, gains = stages.build_stack(names, {})
    before = memory or stack.reset(made, at, quaternion.yaw(at.q))
    return before, stack.step(made, gains, known, before, at, command, DT, DENSITY, GRAVITY)


def same(x, y):
    return all(
        np.array_equal(a, b) for a, b in zip(jax.tree.leaves(x), jax.tree.leaves(y), strict=True)
    )


def test_a_command_enters_where_its_type_is_taken(robot):
    """Given what the stage above gave, the rest of the cascade does the same; to the bit."""
    known, at = robot
    made, gains = stages.build_stack(stages.CONTROLLERS["cascade"], {})
    before, whole = run(robot, stages.CONTROLLERS["cascade"], PATH)
    given = stack.StageInput(
        params=known, estimate=at, realised=None, dt=DT, density=DENSITY, gravity=GRAVITY
    )
    command, kinds = PATH, []
    for i, stage in enumerate(made):
        _, command = stage.step(gains[i], before.stages[i], given, command)
        kinds.append(type(command))
        _, part = run(robot, stages.CONTROLLERS["cascade"], command)
        np.testing.assert_array_equal(part.pwm.pwm_us, whole.pwm.pwm_us)
        # Memory of the stages above stays, that of the stages below goes on.
        assert same(part.memory.stages[: i + 1], before.stages[: i + 1])
        assert same(part.memory.stages[i + 1 :], whole.memory.stages[i + 1 :])
    assert kinds == [PoseTarget, BodyTwist, BodyWrench, ThrusterPwm]
    assert not same(whole.memory, before)


def test_the_target_is_what_the_robot_aims_at(robot):
    _, at = robot
    _, whole = run(robot, stages.CONTROLLERS["cascade"], PATH)
    np.testing.assert_array_equal(whole.target_m, PATH.position_m[0])
    # Nobody aims at a place with a velocity: the robot's own is what is said.
    _, driven = run(robot, stages.CONTROLLERS["cascade"], BodyTwist(nu=jnp.ones(6)))
    np.testing.assert_array_equal(driven.target_m, at.p)


def test_every_controller_takes_a_path_and_gives_signals(robot):
    seen = {}
    for name, names in stages.CONTROLLERS.items():
        before, action = run(robot, names, PATH)
        assert np.all((action.pwm.pwm_us >= 1100) & (action.pwm.pwm_us <= 1900)), name
        assert jax.tree.structure(before) == jax.tree.structure(action.memory), name
        seen[name] = np.asarray(action.pwm.pwm_us)
    # Without an arm, its controller is the cascade.
    np.testing.assert_array_equal(seen.pop("arm"), seen["cascade"])
    # No two others are the same law.
    apart = [np.abs(a - b).max() for a, b in itertools.combinations(seen.values(), 2)]
    assert min(apart) > 0.1


def test_what_the_thrusters_gave_is_handed_back(robot):
    """The wrench of one step, cut by saturation, is in the memory that the next step reads."""
    known, _ = robot
    hard = PoseTarget(
        position_m=jnp.array([9.0, 9.0, -3.0]), velocity_mps=jnp.zeros(3), yaw_rad=jnp.array(2.0)
    )
    names = ["pid_velocity", "pseudo_inverse"]
    before, action = run(robot, names, BodyTwist(nu=jnp.array([3.0, 2.0, 1.0, 0, 0, 1.0])))
    np.testing.assert_array_equal(before.realised.tau, np.zeros(6))
    gave = np.asarray(action.memory.realised.tau)
    asked = np.asarray(action.demanded.tau)
    assert np.abs(asked - gave).max() > 10.0
    exact = allocation.realised_wrench(known.allocation, action.pwm).tau
    np.testing.assert_array_equal(gave, exact)
    # Below the stage that wants it, nothing new is learned of its own demand.
    _, after = run(robot, names, BodyWrench(tau=jnp.ones(6)), action.memory)
    np.testing.assert_array_equal(after.memory.realised.tau, gave)
    # Who does not want it does not carry it.
    assert run(robot, stages.CONTROLLERS["cascade"], hard)[1].memory.realised is None


def test_the_current_is_told_to_those_who_want_it():
    wanting = {
        name
        for name, names in stages.CONTROLLERS.items()
        if stack.wants_flow(stages.build_stack(names, {})[0])
    }
    assert wanting == {"tracking", "computed_torque"}


def test_gains_reach_their_stage(robot):
    known, at = robot
    names = ["pose", "velocity", "pseudo_inverse"]
    made, gains = stages.build_stack(names, {"velocity": {"velocity_per_s": 0.0}})
    plain = stages.build_stack(names, {})[1]
    assert gains[1].velocity_per_s == 0.0
    assert (gains[0], gains[2]) == (plain[0], plain[2])
    assert gains[1].rate_per_s == plain[1].rate_per_s
    step = partial(stack.step, made, params=known, memory=stack.reset(made, at, at.p[0]))
    told = BodyTwist(nu=jnp.zeros(6))
    more = {"estimate": at, "command": told, "dt": DT, "density": DENSITY, "gravity": GRAVITY}
    with_it, without = (step(x, **more).demanded.tau for x in (plain, gains))
    # m + m_A of the Heavy in surge (11.5 + 5.5 kg) times 4 1/s times 0.2 m/s; float32.
    assert float(without[0] - with_it[0]) == pytest.approx(17.0 * 4.0 * 0.2, rel=1e-3)


def goal():
    """A quintic of 4 s along x with a turn, from rest to rest."""
    point = JointPoint(
        time_s=4.0,
        positions=(2.0, 1.0, -10.0, 1.5),
        velocities=(0.0,) * 4,
        accelerations=(0.0,) * 4,
    )
    return build_goal(
        JointGoal(joint_names=("x", "y", "z", "yaw"), points=(point,)),
        joints=joint_trajectory.VEHICLE_JOINTS,
        position=(0.0, 0.0, -10.0, 0.0),
        size=4,
    )


def test_a_joint_trajectory_is_followed_with_its_motion():
    command, gains = goal(), follow.FollowGains()
    clock = jnp.array(1.3)
    now = joint_trajectory.sample_state(command, clock)
    carry = replace(follow.reset(jnp.zeros(())), clock_s=clock)
    on_it = Estimate(p=now.position[:3], q=jnp.array([1.0, 0, 0, 0]), nu=jnp.zeros(6))
    after, target = follow.track_target(gains, carry, on_it, command, DT)
    assert float(after.clock_s) == pytest.approx(1.35)
    np.testing.assert_array_equal(target.position_m, now.position[:3])
    np.testing.assert_array_equal(target.velocity_mps, now.velocity[:3])
    np.testing.assert_array_equal(target.acceleration_mps2, now.acceleration[:3])
    assert float(target.yaw_rad) == pytest.approx(float(now.position[3]), abs=1e-6)  # float32
    np.testing.assert_array_equal(target.yaw_rate_radps, now.velocity[3])
    assert float(now.velocity[0]) > 0.5
    # 0.7 m behind is half way from 0.4 m to 1.0 m: time runs at half its pace, so velocities halve
    # and accelerations quarter.
    behind = Estimate(p=now.position[:3] - jnp.array([0.7, 0, 0]), q=on_it.q, nu=on_it.nu)
    after, slow = follow.track_target(gains, carry, behind, command, DT)
    assert float(after.clock_s) == pytest.approx(1.325, abs=1e-6)
    np.testing.assert_allclose(slow.velocity_mps, now.velocity[:3] / 2, rtol=1e-5)
    np.testing.assert_allclose(slow.acceleration_mps2, now.acceleration[:3] / 4, rtol=1e-5)
    # The pose alone is the same pose.
    _, pose = follow.step(gains, carry, on_it, command, DT)
    np.testing.assert_array_equal(pose.position_m, target.position_m)
    np.testing.assert_array_equal(pose.yaw_rad, target.yaw_rad)


def test_a_joint_trajectory_drives_a_stack(robot):
    for name in ("cascade", "tracking"):
        _, action = run(robot, stages.CONTROLLERS[name], goal())
        assert np.ptp(action.pwm.pwm_us) > 1.0


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (["follow", "velocity", "pseudo_inverse"], ["'follow' gives PoseTarget", "'velocity'"]),
        (["pose", "ardusub"], ["'pose' gives BodyTwist", "'ardusub' below it takes PoseTarget"]),
        (["follow", "pose"], ["last one, 'pose'", "BodyTwist", "ThrusterPwm"]),
        (["ardusub", "ardusub"], ["'ardusub' more than once"]),
        (["follow", "lqr"], ["'lqr'", "computed_torque"]),
        ([], ["empty"]),
    ],
)
def test_what_is_no_stack_is_refused(names, words):
    with pytest.raises(ConfigError) as caught:
        stages.build_stack(names, {})
    for word in words:
        assert word in str(caught.value)


def test_every_fault_of_the_gains_is_named_at_once():
    gains = {
        "follow": {"lag_stop_m": 0.2},
        "pose": {"speed": 3.0},
        "velocity": {"rate_per_s": -4.0},
        "ismc": {"layer_mps": 1.0},
    }
    with pytest.raises(ConfigError) as caught:
        stages.build_stack(stages.CONTROLLERS["cascade"], gains)
    for word in (
        "lag_stop_m = 0.2 must be greater than lag_slow_m",
        "gains.pose.speed = 3: unknown gain; there is position_per_s, attitude_per_s",
        "gains of velocity: rate_per_s = -4",
        "gains.ismc",
    ):
        assert word in str(caught.value)


def test_a_command_that_no_stage_takes_is_refused():
    made, _ = stages.build_stack(stages.CONTROLLERS["ardusub"], {})
    assert stack.find_entry(made, ThrusterPwm) == 2
    assert stack.find_entry(made, TrackingTarget) == 1
    with pytest.raises(ConfigError, match=r"BodyTwist: no stage of follow, ardusub takes it.*Pose"):
        stack.find_entry(made, BodyTwist)


def test_a_batch_of_commands_must_be_for_every_robot():
    made, _ = stages.build_stack(stages.CONTROLLERS["cascade"], {})
    stack.check_command(made, BodyTwist(nu=jnp.zeros((5, 2, 6))), (5, 2), 8)
    wanted = r"BodyTwist: nu has the shape \[2, 6\]: must be \[5, 2, 6\], for \[world, robot, 6\]"
    with pytest.raises(ConfigError, match=wanted):
        stack.check_command(made, BodyTwist(nu=jnp.zeros((2, 6))), (5, 2), 8)
