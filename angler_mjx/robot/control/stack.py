"""Controllers stacked: each stage turns the command from above into the next one down, to PWM.

A stage is a pure function of one robot with its own gains and its own memory, in the form of
cascaded control (Fossen 2021, chapter 15): guidance over pose over velocity over allocation. A
stack is a row of stages in which each takes what the one above gives, and the last gives the
thrusters' signals. A command enters at the first stage that takes its type, so a path, a pose, a
velocity, a wrench or the signals themselves can drive the same stack; the memory of the stages
above stays as it is until a command comes to them again.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control import allocation, command_checks
from angler_mjx.robot.control.allocation import AllocationParams
from angler_mjx.robot.control.commands import (
    BodyTwist,
    BodyWrench,
    Estimate,
    PoseTarget,
    ThrusterPwm,
    TrackingTarget,
)
from angler_mjx.robot.control.commands.joint_trajectory import VEHICLE_JOINTS, JointTrajectory
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.commands.whole_body import (
    EndEffectorTarget,
    JointTarget,
    WholeBodyCommand,
    hold_joints,
    limit_joints,
    sample_joints,
)
from angler_mjx.robot.vehicles.params import VehicleParams

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

type Command = (
    Trajectory
    | JointTrajectory
    | TrackingTarget
    | PoseTarget
    | BodyTwist
    | BodyWrench
    | ThrusterPwm
    | WholeBodyCommand
    | EndEffectorTarget
)
"""What can be told to a robot."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class ControlParams:
    """One robot, and what controllers know of it."""

    vehicle: VehicleParams
    """As it is; `known` is what controllers take it for."""
    allocation: AllocationParams
    cruise_speed_mps: jax.Array
    """[] speed along a planned path."""
    nominal: VehicleParams | None = None
    """What controllers and planners take the vehicle for; None: for what it is."""
    is_leader: jax.Array | None = None
    """bool [] whether it leads the robots that carry a body with it; None where none does."""

    @property
    def vehicle_model(self) -> VehicleParams:
        """The vehicle as controllers and planners know it."""
        return self.vehicle if self.nominal is None else self.nominal


@dataclass(frozen=True, kw_only=True)
class StageInput:
    """What a stage is given beside its command."""

    params: ControlParams
    estimate: Estimate
    realised: BodyWrench | None
    """What the thrusters gave of the wrench asked for in the step before; None for stages that do
    not want it."""
    dt: float
    """Control period, s."""
    density: float
    """Of the water, kg/m^3."""
    gravity: float
    """m/s^2."""
    joints: JointTarget | None = None
    """Motion that the joints shall follow; None of a vehicle without joints."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class NoGains:
    """Of a stage that has none."""


@dataclass(frozen=True, kw_only=True)
class Stage:
    """One controller of a stack."""

    name: str
    takes: tuple[type, ...]
    """Types of commands."""
    gives: type
    """Type of the command to the stage below."""
    step: Callable[..., tuple[object, Command]]
    """(gains, carry, given, command) -> (carry, command to the stage below); pure, of one robot."""
    reset: Callable[[Estimate, jax.Array], object]
    """(estimate, heading [] rad at the start) -> carry."""
    gains: type = NoGains
    """Dataclass of its gains, all with defaults."""
    check: Callable[..., None] | None = None
    """Refuses gains that make no sense, with a ConfigError (host side)."""
    wants_flow: bool = False
    """Whether it is to be told the current."""
    wants_realised: bool = False
    """Whether it is to be told what became of the wrench of the step before."""
    progress: Callable[..., jax.Array] | None = None
    """(carry, plan) -> time [] s along the plan that the robot has come to; None for stages that
    take no plan."""
    wants_grip: bool = False
    """Whether it takes the measured wrench of the robot's grip, and so cannot fly without one."""
    wants_sway: bool = False
    """Whether it cannot fly a vehicle that has no thrust to the side."""
    flies_by_fins: bool = False
    """Whether it can fly a vehicle without heave or yaw thrust, by its fins and with way on."""
    glides: bool = False
    """Whether it flies vehicles without thrust by ballast and moving masses, and no others."""


type Stages = tuple[Stage, ...]

type StackGains = tuple["DataclassInstance", ...]
"""Gains of each stage."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class ControlMemory:
    """Memory of a stack of one robot."""

    stages: tuple[object, ...]
    """Carry of each stage."""
    realised: BodyWrench | None
    """For the stages that want it; None where none does."""
    demanded: BodyWrench | None = None
    """What the thrusters were asked for in the step before, NaN where by signals alone: for those
    who watch. None where nobody does."""
    joints: JointTarget | None = None
    """Motion of the joints that was commanded last, within their limits; None of a vehicle without
    joints."""
    joints_clipped: jax.Array | None = None
    """int32 [] control steps in which a command to the joints was beyond their limits."""


@dataclass(frozen=True, kw_only=True)
class Action:
    """What came of one control step of a stack."""

    memory: ControlMemory
    target_m: jax.Array
    """[3] position that was aimed at, in W; where no stage aimed at one, the robot's own."""
    command: Command
    """Of the last stage: thruster signals, or what an autopilot takes."""
    demanded: BodyWrench | None
    """The wrench that the thrusters were asked for; None where there was none above the signals."""

    @property
    def pwm(self) -> ThrusterPwm:
        """Thruster signals; see `require_signals`."""
        return require_signals(self.command)


def require_signals(command: Command) -> ThrusterPwm:
    """Return a command that is thruster signals.

    Raises:
        TypeError: it is another command.
    """
    if not isinstance(command, ThrusterPwm):
        raise TypeError(f"the last stage gives {type(command).__name__}, no thruster signals")
    return command


def describe_inputs(stage: Stage) -> str:
    """The commands of a stage, in words."""
    return " or ".join(kind.__name__ for kind in stage.takes)


def find_entry(stages: Stages, command: type) -> int:
    """Number of the first stage that takes a type of command; that of stages for the signals.

    Raises:
        ConfigError: no stage takes it.
    """
    if command is ThrusterPwm:
        return len(stages)
    for i, stage in enumerate(stages):
        if command in stage.takes:
            return i
    accepted = dict.fromkeys(kind.__name__ for stage in stages for kind in stage.takes)
    raise ConfigError(
        f"command {command.__name__}: no stage of {', '.join(s.name for s in stages)} takes it; "
        f"give one of {', '.join([*accepted, 'ThrusterPwm'])}"
    )


def check_command(
    stages: Stages, command: Command, lead: tuple[int, ...], thrusters: int, joints: int = 0
) -> None:
    """Refuse a batch of commands that a stack cannot be driven by (host side).

    Args:
        stages: the stack.
        command: of every robot.
        lead: sizes of the axes that all arrays begin with, [world, robot].
        thrusters: of a robot, padding included.
        joints: of its links.

    Raises:
        ConfigError: no stage takes it, or an array of it has another shape than its robots want.
    """
    base = command.base if isinstance(command, WholeBodyCommand) else command
    find_entry(stages, type(base))
    command_checks.check_arrays(command, lead, thrusters, joints)


def progress_s(stages: Stages, memory: ControlMemory, plan: Command) -> jax.Array:
    """Return the time [] s along its plan that a robot has come to.

    Args:
        stages: the stack.
        memory: of the stack.
        plan: that the robot follows.

    Raises:
        ConfigError: no stage takes the plan.
    """
    i = find_entry(stages, type(plan))
    progress = stages[i].progress
    if progress is None:
        raise ConfigError(f"stage {stages[i].name} does not say how far along a plan a robot is")
    return progress(memory.stages[i], plan)


def wants_flow(stages: Stages) -> bool:
    """Whether any stage is to be told the current."""
    return any(stage.wants_flow for stage in stages)


def reset(stages: Stages, estimate: Estimate, yaw_rad: jax.Array) -> ControlMemory:
    """Memory of a robot that begins with an estimate and a heading []."""
    wanted = any(stage.wants_realised for stage in stages)
    return ControlMemory(
        stages=tuple(stage.reset(estimate, yaw_rad) for stage in stages),
        realised=BodyWrench(tau=jnp.zeros_like(estimate.nu)) if wanted else None,
        joints=None if estimate.joints is None else hold_joints(estimate.joints),
        joints_clipped=None if estimate.joints is None else jnp.zeros((), jnp.int32),
    )


def step(
    stages: Stages,
    gains: Sequence["DataclassInstance"],
    params: ControlParams,
    memory: ControlMemory,
    estimate: Estimate,
    command: Command,
    dt: float,
    density: float,
    gravity: float,
) -> Action:
    """One control step of one robot.

    Args:
        stages: the stack.
        gains: of each stage.
        params: of the robot.
        memory: of the stack.
        estimate: its state as known to the controllers, with the current if a stage wants it.
        command: of any type that a stage takes, or the signals themselves.
        dt: control period, s.
        density: of the water, kg/m^3.
        gravity: m/s^2.

    Raises:
        ConfigError: no stage takes the command.
    """
    command, joints = split_joints(command, stop_joints(memory.joints))
    first = find_entry(stages, type(command))
    carries = list(memory.stages)
    aim, realised_used = target_position(command, estimate.p), False
    demanded = command if isinstance(command, BodyWrench) else None
    for i in range(first, len(stages)):
        stage = stages[i]
        inputs = StageInput(
            params=params,
            estimate=estimate,
            realised=memory.realised if stage.wants_realised else None,
            dt=dt,
            density=density,
            gravity=gravity,
            joints=joints,
        )
        before = carries[i]
        carries[i], lower = stage.step(gains[i], before, inputs, command)
        joints = follow_joints(stage, before, carries[i], command, dt, joints)
        command, joints = split_joints(lower, joints)
        aim = target_position(command, aim)
        demanded = command if isinstance(command, BodyWrench) else demanded
        realised_used |= stage.wants_realised
    joints, clipped = limit_command(params, joints, memory)
    return Action(
        memory=ControlMemory(
            stages=tuple(carries),
            joints=joints,
            joints_clipped=clipped,
            # Of a step in which those who want it had no say they would learn nothing.
            realised=allocation.realised_wrench(params.allocation, require_signals(command))
            if realised_used
            else memory.realised,
            demanded=None if memory.demanded is None else _demanded_or_nan(demanded, estimate),
        ),
        target_m=aim,
        command=command,
        demanded=demanded,
    )


def stop_joints(joints: JointTarget | None) -> JointTarget | None:
    """Return what joints do that nothing is commanded to: stay at the target before."""
    if joints is None:
        return None
    still = jnp.zeros_like(joints.position)
    return replace(joints, velocity=still, acceleration=still)


def split_joints(
    command: Command, joints: JointTarget | None
) -> tuple[Command, JointTarget | None]:
    """Return the command to the base, and that to the joints: ``joints`` where it says nothing."""
    if isinstance(command, WholeBodyCommand):
        return command.base, joints if joints is None else command.joints
    return command, joints


def follow_joints(
    stage: Stage,
    before: object,
    after: object,
    command: Command,
    dt: float,
    joints: JointTarget | None,
) -> JointTarget | None:
    """Return the motion of the joints in a trajectory that a stage followed in this step.

    Joints that the trajectory does not name keep ``joints``.
    """
    if joints is None or stage.progress is None or not isinstance(command, JointTrajectory):
        return joints
    if len(command.joints) == len(VEHICLE_JOINTS):
        return joints
    clock_s = stage.progress(before, command)
    pace = (stage.progress(after, command) - clock_s) / dt
    followed = sample_joints(command, clock_s, pace)
    is_named = command.commanded[len(VEHICLE_JOINTS) :]
    target: JointTarget = jax.tree.map(
        lambda new, old: jnp.where(is_named, new, old), followed, joints
    )
    return target


def limit_command(
    params: ControlParams, joints: JointTarget | None, memory: ControlMemory
) -> tuple[JointTarget | None, jax.Array | None]:
    """Return a command to the joints within their limits, and how often one was beyond them."""
    clipped = memory.joints_clipped
    if joints is None or clipped is None:
        return None, None
    links = params.vehicle_model.links
    if links is None:
        return None, None
    joints, is_beyond = limit_joints(links, joints)
    return joints, clipped + is_beyond


def _demanded_or_nan(demanded: BodyWrench | None, estimate: Estimate) -> BodyWrench:
    """A wrench, of NaN where there is none."""
    return demanded or BodyWrench(tau=jnp.full_like(estimate.nu, jnp.nan))


def target_position(command: Command, before: jax.Array) -> jax.Array:
    """Return the position [3] that a command aims at; ``before`` where it aims at none."""
    return command.position_m if isinstance(command, PoseTarget | TrackingTarget) else before
