"""When the robots of a world may arrive: on the last approach of their plans, or at any time."""

from collections.abc import Callable

import jax

from angler_mjx.robot.control import mixed, plans
from angler_mjx.robot.control.commands.joint_trajectory import JointTrajectory
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.mixed import MixedCommand
from angler_mjx.robot.control.stack import Command
from angler_mjx.sim.state import SimSpec, World


def last_approaches_s(
    spec: SimSpec, world: World, command: Command | MixedCommand | None = None
) -> jax.Array | None:
    """Return when the last approaches of the robots' plans begin, [R] s along the plans.

    Args:
        spec: settings.
        world: one world.
        command: [R] leading; if left out, robots fly the plans of the world.

    Returns:
        None where the goal alone counts: a task, or commands that are no plans.
    """
    executed = world.path if command is None else command
    if spec.by_task or not isinstance(executed, Trajectory | JointTrajectory | MixedCommand):
        return None
    robot_last_approach_s: Callable[..., jax.Array] = (
        mixed.last_approach_s if isinstance(executed, MixedCommand) else plans.last_approach_s
    )
    return jax.vmap(robot_last_approach_s, (0, 0, None))(
        executed, world.environment.goal_m, spec.goal_tolerance_m
    )
