"""When a plan's last approach to its goal begins, and how far along a plan a robot is."""

import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control import mixed, plans, stack, stages
from angler_mjx.robot.control.commands import BodyTwist, Estimate
from angler_mjx.robot.control.commands.joint_trajectory import (
    VEHICLE_JOINTS,
    JointTrajectory,
    from_path,
)
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.mixed import MixedCommand

from ...compiling import quickly

GOAL = np.array([0.0, 0.0, -8.0])
TOLERANCE_M = 0.3


def plan(rows, found=True):
    """Way-points at (time, x, y) beside the goal, at its depth; padded by the last one."""
    rows = [*rows, rows[-1], rows[-1]]
    time, x, y = np.array(rows, float).T
    point = np.stack([x, y, np.full_like(x, GOAL[2])], axis=-1)
    return Trajectory(time_s=jnp.array(time), position_m=jnp.array(point), found=jnp.asarray(found))


CASES = {
    "from afar to the goal": ([(0, 9, 0), (10, 4, 0), (20, 0, 0)], 10),
    "closed": ([(0, 0, 0), (8, 4, 0), (16, 4, 4), (24, 0, 4), (32, 0, 0)], 24),
    "over the goal and back": ([(0, 9, 0), (18, 0, 0), (26, -4, 0), (34, 0, 0)], 26),
    "ends elsewhere": ([(0, 9, 0), (18, 0, 0), (36, -9, 0)], 36),
    "two rounds": ([(0, 0, 0), (4, 2, 0), (8, 0, 0), (12, 2, 0), (16, 0, 0)], 12),
    "a round smaller than the margin": ([(0, 0, 0), (2, 1, 0), (4, 0, 0)], 2),
    "a step near the goal": ([(0, 0.5, 0), (1, 0, 0)], 0),
    "stays at its goal": ([(0, 9, 0), (18, 0, 0), (78, 0, 0)], 0),
    "stays where it starts, at its goal": ([(0, 0.1, 0), (60, 0.1, 0)], 60),
    "waits on its way": ([(0, 9, 0), (10, 4, 0), (30, 4, 0), (38, 0, 0)], 30),
    "waits near its goal": ([(0, 9, 0), (16, 1, 0), (30, 1, 0), (32, 0, 0)], 0),
}


@pytest.mark.parametrize("case", CASES)
def test_the_last_approach_begins_where_the_plan_is_far_for_the_last_time(case):
    rows, begin = CASES[case]

    @quickly
    def last(path, goal_m):
        both = (path, from_path(path, jnp.asarray(0.0)))
        return [plans.last_approach_s(x, goal_m, TOLERANCE_M) for x in both]

    assert [float(time_s) for time_s in last(plan(rows), GOAL)] == [begin] * 2


def test_a_plan_is_not_over_before_a_bulge_between_its_way_points():
    # At its goal after 14 s, at 0.45 m/s: the cubic back to it over 40 s leads 2.67 m away.
    lines = plan([(0, 3, 0), (14, 0, 0), (54, 0, 0)])
    time, point = lines.time_s, lines.position_m
    velocity = np.zeros((5, 4))
    velocity[1, 0] = -0.45
    bulge = JointTrajectory(
        joints=VEHICLE_JOINTS,
        time_s=time,
        position=jnp.concatenate([point, jnp.zeros((5, 1))], axis=-1),
        velocity=jnp.asarray(velocity),
        acceleration=jnp.zeros((5, 4)),
        degree=jnp.full(5, 3),
        commanded=jnp.ones(4, bool),
        found=jnp.asarray(True),
    )
    # -18 s (1 - s)^2 m at share s of the way: more than 1.3 m at 5/8 (-1.58), less at 6/8 (-0.84).
    assert float(plans.last_approach_s(bulge, GOAL, TOLERANCE_M)) == 14 + 40 * 5 / 8
    inner = -18.0 * np.linspace(0, 1, 9) * (1 - np.linspace(0, 1, 9)) ** 2
    length = 3.0 + np.abs(np.diff(inner)).sum()
    # On the first segment it overshoots neither end: 3 m.
    np.testing.assert_allclose(plans.length_m(bulge), length, rtol=1e-6)


def test_without_a_plan_there_is_nothing_to_wait_for():
    rows, _ = CASES["closed"]
    assert float(plans.last_approach_s(plan(rows, found=False), GOAL, TOLERANCE_M)) == 0.0


def begun(names):
    state = Estimate(p=jnp.array([0.0, 0.0, -8.0]), q=jnp.array([1.0, 0, 0, 0]), nu=jnp.zeros(6))
    built, _ = stages.build_stack(names, {})
    return built, stack.reset(built, state, jnp.asarray(0.0))


@pytest.mark.parametrize("name", [*stages.CONTROLLERS])
def test_every_controller_says_how_far_along_its_plan_a_robot_is(name):
    built, memory = begun(stages.CONTROLLERS[name])
    path = plan(CASES["closed"][0])
    # The guidance by a clock begins at 0, the one along lines on its first line.
    assert float(stack.progress_s(built, memory, path)) == (8.0 if name == "los" else 0.0)


def test_a_stage_below_plans_says_so():
    built, memory = begun(("pose", "velocity", "pseudo_inverse"))
    with pytest.raises(ConfigError, match="no stage of pose, velocity"):
        stack.progress_s(built, memory, plan(CASES["closed"][0]))


@pytest.mark.parametrize(("which", "begin", "progress"), [(0, 24.0, 8.0), (1, 0.0, 0.0)])
def test_of_several_commands_the_plan_counts_where_it_is_chosen(which, begin, progress):
    built, memory = begun(stages.CONTROLLERS["los"])
    path = plan(CASES["closed"][0])
    command = MixedCommand(
        which=jnp.asarray(which), fresh=jnp.asarray(0), commands=(path, BodyTwist(nu=jnp.zeros(6)))
    )
    assert float(mixed.last_approach_s(command, GOAL, TOLERANCE_M)) == begin
    assert float(mixed.progress_s(built, memory, command)) == progress
