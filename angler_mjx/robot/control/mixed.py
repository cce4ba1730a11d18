"""Robots of one step driven at different levels of the same stack: one by its path, one by a twist.

A `MixedCommand` command holds a command of each type that may be given, and says which one counts.
All stages are worked out; where a robot's own command enters, it takes the place of what comes from
above, and the stages above it keep their memory. What is not chosen costs its arithmetic, so this
is for scenes that are driven step by step; batches give one type to all.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx._moved import renamed as _renamed
from angler_mjx.robot.control import allocation, plans, stack
from angler_mjx.robot.control.commands import (
    BodyWrench,
    Estimate,
)
from angler_mjx.robot.control.commands.joint_trajectory import JointTrajectory
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.commands.whole_body import JointTarget
from angler_mjx.robot.control.stack import (
    Action,
    Command,
    ControlMemory,
    ControlParams,
    Stage,
    StageInput,
    Stages,
)

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class MixedCommand:
    """Commands of several types for one robot, of which one counts."""

    which: jax.Array
    """int32 [] its place in ``commands``."""
    fresh: jax.Array
    """int32 [] so many stages, counted from the top, begin this step with a new memory; 0: none.
    For stages that stood idle until now, and for the first one when a new path begins."""
    commands: tuple[Command, ...]
    """Each of another type; those that do not count hold any numbers."""
    joints: JointTarget | None = None
    """Motion of the joints beside the command that counts; None where no robot has joints."""
    has_joints: jax.Array | None = None
    """bool [] whether ``joints`` counts; None without ``joints``."""


def last_approach_s(mixed: MixedCommand, goal_m: jax.Array, tolerance_m: float) -> jax.Array:
    """Return `plans.last_approach_s` [] s of one robot's command; zero unless it is a plan."""
    begin = jnp.zeros_like(goal_m[0])
    for k, command in enumerate(mixed.commands):
        if isinstance(command, Trajectory | JointTrajectory):
            of_plan = plans.last_approach_s(command, goal_m, tolerance_m)
            begin = jnp.where(mixed.which == k, of_plan, begin)
    return begin


def progress_s(stages: Stages, memory: ControlMemory, mixed: MixedCommand) -> jax.Array:
    """Return `stack.progress_s` [] s of one robot's command; zero unless it is a plan."""
    progress: jax.Array | float = 0.0
    for k, command in enumerate(mixed.commands):
        if isinstance(command, Trajectory | JointTrajectory):
            of_plan = stack.progress_s(stages, memory, command)
            progress = jnp.where(mixed.which == k, of_plan, progress)
    return jnp.asarray(progress)


def step(
    stages: Stages,
    gains: Sequence["DataclassInstance"],
    params: ControlParams,
    memory: ControlMemory,
    estimate: Estimate,
    mixed: MixedCommand,
    dt: float,
    density: float,
    gravity: float,
) -> Action:
    """One control step of one robot; see `angler_mjx.robot.control.stack.step`.

    Args:
        stages: the stack.
        gains: of each stage.
        params: of the robot.
        memory: of the stack; its ``demanded`` is kept up to date if there is one.
        estimate: its state as known to the controllers, with the current if a stage wants it.
        mixed: the commands.
        dt: control period, s.
        density: of the water, kg/m^3.
        gravity: m/s^2.

    Returns:
        As for the chosen command alone; ``demanded`` is NaN where it stands below wrenches, and
        also counts a wrench that was given.

    Raises:
        ConfigError: no stage takes one of the commands.
    """
    chosen = [mixed.which == k for k in range(len(mixed.commands))]
    joints, commands = stack.stop_joints(memory.joints), []
    for flag, command in zip(chosen, mixed.commands, strict=True):
        base, target = stack.split_joints(command, joints)
        commands.append(base)
        joints = _select(flag, target, joints)
    if joints is not None and mixed.has_joints is not None:
        joints = _select(mixed.has_joints, mixed.joints, joints)
    entries = [stack.find_entry(stages, type(command)) for command in commands]
    yaw = quaternion.yaw(estimate.q)
    below: Command | None = None
    used = realised_used = mixed.which < 0
    aim, demanded = estimate.p, jnp.full_like(estimate.nu, jnp.nan)
    carries = []
    for i, stage in enumerate(stages):
        entering = [
            (flag, command)
            for flag, command, entry_index in zip(chosen, commands, entries, strict=True)
            if entry_index == i
        ]
        for flag, command in entering:
            aim = jnp.where(flag, stack.target_position(command, aim), aim)
            demanded = jnp.where(flag, _demanded_wrench(command, demanded), demanded)
        used = reduce(jnp.logical_or, (flag for flag, _ in entering), used)
        if below is None and not entering:
            carries.append(memory.stages[i])
            continue
        new = mixed.fresh > i
        before = _select(new, stage.reset(estimate, yaw), memory.stages[i])
        inputs = StageInput(
            params=params,
            estimate=estimate,
            realised=_select_realised(stage, memory, new),
            dt=dt,
            density=density,
            gravity=gravity,
            joints=joints,
        )
        carry, below = _run_stage(stage, gains[i], before, inputs, below, entering)
        for flag, command in entering:
            followed = stack.follow_joints(stage, before, carry, command, dt, joints)
            joints = _select(flag, followed, joints)
        below, target = stack.split_joints(below, joints)
        joints = _select(used, target, joints)
        carries.append(_select(used, carry, memory.stages[i]))
        aim = jnp.where(used, stack.target_position(below, aim), aim)
        demanded = jnp.where(used, _demanded_wrench(below, demanded), demanded)
        realised_used = realised_used | used if stage.wants_realised else realised_used
    for flag, command, entry_index in zip(chosen, commands, entries, strict=True):
        if entry_index == len(stages):
            below = command if below is None else _select(flag, command, below)
            demanded = jnp.where(flag, jnp.nan, demanded)
    if below is None:
        raise TypeError("neither stages nor commands give thruster signals")
    joints, clipped = stack.limit_command(params, joints, memory)
    return Action(
        memory=ControlMemory(
            stages=tuple(carries),
            joints=joints,
            joints_clipped=clipped,
            realised=None
            if memory.realised is None
            else _select(
                realised_used,
                allocation.realised_wrench(params.allocation, stack.require_signals(below)),
                memory.realised,
            ),
            demanded=None if memory.demanded is None else BodyWrench(tau=demanded),
        ),
        target_m=aim,
        command=below,
        demanded=BodyWrench(tau=demanded),
    )


def _run_stage(
    stage: Stage,
    gains: "DataclassInstance",
    carry: object,
    stage_input: StageInput,
    above: Command | None,
    entering: Sequence[tuple[jax.Array, Command]],
) -> tuple[object, Command]:
    """Memory and command of a stage: once for each type of command that it is given."""
    inputs: dict[type, tuple[jax.Array | None, Command]] = {}
    if above is not None:
        inputs[type(above)] = (None, above)
    for flag, command in entering:
        kind = type(command)
        if kind in inputs:
            inputs[kind] = (None, _select(flag, command, inputs[kind][1]))
        else:
            inputs[kind] = (flag, command)
    results = [
        (flag, stage.step(gains, carry, stage_input, stage_command))
        for flag, stage_command in inputs.values()
    ]
    chosen = results[0][1]
    for mask, result in results[1:]:
        chosen = result if mask is None else _select(mask, result, chosen)
    return chosen


def _select_realised(stage: Stage, memory: ControlMemory, new: jax.Array) -> BodyWrench | None:
    """What a stage is told of the wrench before; a stage that begins anew asked for none."""
    if not stage.wants_realised or memory.realised is None:
        return None
    return BodyWrench(tau=jnp.where(new, 0.0, memory.realised.tau))


def _select[T](flag: jax.Array, yes: T, no: T) -> T:
    selected: T = jax.tree.map(lambda a, b: jnp.where(flag, a, b), yes, no)
    return selected


def _demanded_wrench(command: Command, before: jax.Array) -> jax.Array:
    return command.tau if isinstance(command, BodyWrench) else before


def __getattr__(name: str) -> object:
    """Return what had another name before 0.2."""
    return _renamed(__name__, name)
