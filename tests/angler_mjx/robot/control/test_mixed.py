"""A mixed command does what the chosen one does alone: signals, memory, target. One robot."""

from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import quaternion
from angler_mjx.errors import ConfigError
from angler_mjx.robot.control import mixed, stack, stages
from angler_mjx.robot.control.commands import (
    BodyTwist,
    BodyWrench,
    PoseTarget,
    ThrusterPwm,
    TrackingTarget,
    as_tracking,
    joint_trajectory,
)
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.mixed import MixedCommand

from ...compiling import quickly

WATER = (0.05, 1000.0, 9.81)
PATH = Trajectory(
    time_s=jnp.array([0.0, 8.0, 16.0]),
    position_m=jnp.array([[0.3, 0.0, -10.0], [4.0, 0.0, -10.0], [4.0, 4.0, -11.0]]),
    found=jnp.array(True),
)
POSE = PoseTarget(
    position_m=jnp.array([1.0, 0.5, -9.0]), velocity_mps=jnp.zeros(3), yaw_rad=jnp.array(0.7)
)
COMMANDS = (
    PATH,
    joint_trajectory.from_path(PATH, jnp.array(0.2)),
    replace(as_tracking(POSE), position_m=POSE.position_m + 0.2),
    POSE,
    BodyTwist(nu=jnp.array([0.3, -0.1, 0.1, 0.0, 0.0, 0.2])),
    BodyWrench(tau=jnp.array([10.0, 5.0, -8.0, 0.0, 0.0, 1.0])),
    ThrusterPwm(pwm_us=jnp.linspace(1400.0, 1650.0, 8)),
)
KINDS = [type(command).__name__ for command in COMMANDS]


def of(controller):
    """Its stages and gains, and the commands that it takes."""
    made, gains = stages.build_stack(stages.CONTROLLERS[controller], {})
    taken = {kind for stage in made for kind in stage.takes} | {ThrusterPwm}
    return made, gains, tuple(command for command in COMMANDS if type(command) in taken)


def begun(made, at):
    """A memory in which something is: that of a robot that has been elsewhere before."""
    fresh = stack.reset(made, replace(at, p=at.p + 1.0), quaternion.yaw(at.q) + 0.3)
    grown = jax.tree.map(
        lambda leaf: leaf + 0.1 if jnp.issubdtype(leaf.dtype, jnp.floating) else leaf, fresh
    )
    return replace(grown, demanded=BodyWrench(tau=jnp.zeros(6)))


def stepper(controller, robot):
    """Mixed and plain steps of a stack, compiled."""
    known, at = robot
    made, gains, taken = of(controller)

    @quickly
    def mix(memory, which, fresh):
        told = MixedCommand(which=which, fresh=fresh, commands=taken)
        action = mixed.step(made, gains, known, memory, at, told, *WATER)
        return action.memory, action.pwm, action.target_m

    @partial(quickly, static_argnums=1)
    def plain(memory, k):
        action = stack.step(made, gains, known, memory, at, taken[k], *WATER)
        return action.memory, action.pwm, action.target_m

    return made, taken, mix, plain


@pytest.fixture(scope="module")
def steppers(robot):
    return cache(lambda controller: stepper(controller, robot))


def assert_same(ours, theirs):
    assert jax.tree.structure(ours) == jax.tree.structure(theirs)
    for x, y in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        assert x.dtype == y.dtype
        # The same operations in two programs: float32 rounding of sums of some ten terms.
        np.testing.assert_allclose(x, y, rtol=2e-5, atol=2e-5)


@pytest.mark.parametrize("controller", ["cascade", "tracking"])
def test_the_chosen_command_acts_as_if_it_were_alone(controller, robot, steppers):
    made, taken, mix, plain = steppers(controller)
    memory = begun(made, robot[1])
    seen = []
    for k in range(len(taken)):
        ours = mix(memory, jnp.int32(k), jnp.int32(0))
        assert_same(ours, plain(memory, k))
        seen.append(np.asarray(ours[1].pwm_us))
    # A choice that chose nothing would have passed: all commands lead to other signals.
    apart = [np.abs(a - b).max() for i, a in enumerate(seen) for b in seen[:i]]
    assert min(apart) > 0.5


def test_stages_above_keep_their_memory_and_fresh_ones_begin_anew(robot, steppers):
    made, taken, mix, _ = steppers("cascade")
    _, at = robot
    memory = begun(made, at)
    twist = [type(command) for command in taken].index(BodyTwist)
    after, *_ = mix(memory, jnp.int32(twist), jnp.int32(0))
    assert_same(after.stages[:2], memory.stages[:2])
    assert not np.array_equal(after.stages[2].integral, memory.stages[2].integral)
    # Its path begins anew; the velocity loop, below, goes on with what it holds.
    clean = replace(memory, stages=(made[0].reset(at, quaternion.yaw(at.q)), *memory.stages[1:]))
    again, *_ = mix(memory, jnp.int32(0), jnp.int32(1))
    assert_same(again, mix(clean, jnp.int32(0), jnp.int32(0))[0])
    assert float(again.stages[0].clock_s) < 0.06 < float(mix(memory, 0, 0)[0].stages[0].clock_s)


def test_what_was_demanded_is_known_down_to_wrenches(robot, steppers):
    made, taken, mix, _ = steppers("cascade")
    memory = begun(made, robot[1])
    demanded = {
        type(command): np.asarray(mix(memory, jnp.int32(k), jnp.int32(0))[0].demanded.tau)
        for k, command in enumerate(taken)
    }
    np.testing.assert_array_equal(demanded[BodyWrench], COMMANDS[5].tau)
    assert np.isnan(demanded[ThrusterPwm]).all()
    for kind in (Trajectory, PoseTarget, TrackingTarget, BodyTwist):
        assert np.isfinite(demanded[kind]).all()
    # Where nobody watches, nothing is kept.
    assert mix(replace(memory, demanded=None), jnp.int32(0), jnp.int32(0))[0].demanded is None


def test_who_wants_it_is_told_what_the_thrusters_gave_and_nothing_where_it_begins_anew(robot):
    known, at = robot

    def repeat(gains, carry, given, command):
        return carry, given.realised or BodyWrench(tau=jnp.full(6, 7.0))

    def begin(estimate, yaw_rad):
        return ()

    gave = jnp.array([3.0, -2.0, 1.0, 0.2, 0.1, -0.3])
    for wants in (True, False):
        tells = stack.Stage(
            name="tells",
            takes=(BodyTwist,),
            gives=BodyWrench,
            step=repeat,
            reset=begin,
            wants_realised=wants,
        )
        made = (tells, *stages.build_stack(["pseudo_inverse"], {})[0])
        memory = stack.ControlMemory(stages=((), ()), realised=BodyWrench(tau=gave))
        for fresh, told in ((0, gave), (1, jnp.zeros(6))):
            command = MixedCommand(
                which=jnp.int32(0), fresh=jnp.int32(fresh), commands=(COMMANDS[4],)
            )
            gains = [stage.gains() for stage in made]
            action = mixed.step(made, gains, known, memory, at, command, *WATER)
            np.testing.assert_array_equal(action.demanded.tau, told if wants else 7.0)


def test_two_stages_that_want_it_are_told_as_one_is(robot):
    """The lower one is used whenever the upper one is: that it wants it too takes nothing back."""
    known, at = robot
    tau = jnp.array([3.0, -2.0, 1.0, 0.0, 0.0, 0.3])

    def begin(estimate, yaw_rad):
        return ()

    def passes(gains, carry, given, command):
        return carry, command

    def pushes(gains, carry, given, command):
        return carry, BodyWrench(tau=tau)

    made = (
        *(
            stack.Stage(
                name=f"wants {gives.__name__}",
                takes=(BodyTwist,),
                gives=gives,
                step=step,
                reset=begin,
                wants_realised=True,
            )
            for gives, step in ((BodyTwist, passes), (BodyWrench, pushes))
        ),
        *stages.build_stack(["pseudo_inverse"], {})[0],
    )
    memory = stack.ControlMemory(stages=((), (), ()), realised=BodyWrench(tau=jnp.full(6, 9.0)))
    command = MixedCommand(which=jnp.int32(0), fresh=jnp.int32(0), commands=(COMMANDS[4],))
    gains = [stage.gains() for stage in made]
    action = mixed.step(made, gains, known, memory, at, command, *WATER)
    # Well within what the thrusters give, of which each may miss 0.005 N in its dead band.
    np.testing.assert_allclose(action.memory.realised.tau, tau, atol=8 * 0.005)


def test_a_command_that_no_stage_takes_is_refused(robot):
    made, gains, _ = of("ardusub")
    told = MixedCommand(which=jnp.int32(0), fresh=jnp.int32(0), commands=(PATH, COMMANDS[4]))
    memory = stack.reset(made, robot[1], jnp.array(0.0))
    with pytest.raises(ConfigError, match="BodyTwist"):
        mixed.step(made, gains, robot[0], memory, robot[1], told, *WATER)
