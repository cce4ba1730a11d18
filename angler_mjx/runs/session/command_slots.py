"""Commands of every robot of a session, as arrays of fixed shapes.

One slot for each type of command that the controllers take; the step is the same compiled program
for all commands.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import DTypeLike

from angler_mjx.host_arrays import as_leaf
from angler_mjx.robot.control import stack
from angler_mjx.robot.control.allocation import NEUTRAL_US
from angler_mjx.robot.control.commands import (
    BodyTwist,
    BodyWrench,
    PoseTarget,
    ThrusterPwm,
    TrackingTarget,
)
from angler_mjx.robot.control.commands.joint_trajectory import (
    LINEAR,
    VEHICLE_JOINTS,
    JointTrajectory,
)
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.commands.whole_body import (
    EndEffectorTarget,
    JointTarget,
    WholeBodyCommand,
)
from angler_mjx.robot.control.mixed import MixedCommand
from angler_mjx.robot.control.stack import Command, Stages

COMMAND_TYPES = (
    Trajectory,
    JointTrajectory,
    TrackingTarget,
    PoseTarget,
    EndEffectorTarget,
    BodyTwist,
    BodyWrench,
    ThrusterPwm,
)
"""All types of commands, from the highest down."""


@dataclass(frozen=True, kw_only=True)
class SlotSizes:
    """Numbers of rows of the slots."""

    robots: int
    thrusters: int
    points: int
    """Rows of a JointTrajectory."""
    way_points: int
    """Rows of a Trajectory."""
    joints: tuple[str, ...] = ()
    """Names of the joints of arms; empty where no robot has any."""


def widen_trajectory(command: JointTrajectory, joints: tuple[str, ...]) -> JointTrajectory:
    """Return a trajectory of the vehicle's joints as one of all joints, the others not named.

    Args:
        command: trajectory of one robot, [n_point, n_joint].
        joints: names of all joints, those of ``command`` first.
    """
    missing = len(joints) - len(command.joints)
    if not missing:
        return command

    def pad(leaf: jax.Array) -> jax.Array:
        return as_leaf(np.pad(leaf, [(0, 0)] * (np.ndim(leaf) - 1) + [(0, missing)]))

    return replace(
        command,
        joints=joints,
        position=pad(command.position),
        velocity=pad(command.velocity),
        acceleration=pad(command.acceleration),
        commanded=pad(command.commanded),
    )


def command_types(stages: Stages) -> tuple[type, ...]:
    """Return the types of commands that a stack takes."""
    accepted = {kind for stage in stages for kind in stage.takes} | {ThrusterPwm}
    return tuple(kind for kind in COMMAND_TYPES if kind in accepted)


class CommandSlots:
    """Commands of robots; [1, R] leads in every returned array.

    Attributes:
        kinds: types of its slots.
    """

    def __init__(self, stages: Stages, sizes: SlotSizes) -> None:
        """Fill the slots with empty paths for all robots."""
        self.kinds = command_types(stages)
        self._entry = {kind: stack.find_entry(stages, kind) for kind in self.kinds}
        blank = _blank_commands(sizes)
        self._slots = [jax.tree.map(np.array, blank[kind]) for kind in self.kinds]
        self._slot_index = np.zeros((1, sizes.robots), np.int32)
        self._fresh = np.zeros((1, sizes.robots), np.int32)
        self._joints = _blank_joints(sizes)
        self._has_joints = np.zeros((1, sizes.robots), bool) if sizes.joints else None
        self._step_commands: MixedCommand | None = None

    def put(self, robot: int, command: Command | JointTarget) -> None:
        """Put the command of a robot; its arrays have the shapes of the slots.

        Stages that were idle are reset, and so is the first stage with a new path. A JointTarget
        leaves the command to the base.
        """
        if isinstance(command, JointTarget):
            self._put_joints(robot, command)
        elif isinstance(command, WholeBodyCommand):
            self._put_base(robot, command.base)
            self._put_joints(robot, command.joints)
        else:
            self._put_base(robot, command)

    def _put_joints(self, robot: int, target: JointTarget) -> None:
        """Put the motion of a robot's joints; a trajectory names them no more."""
        if self._joints is None or self._has_joints is None:
            raise TypeError("no robot has joints")
        for stored, new in zip(jax.tree.leaves(self._joints), jax.tree.leaves(target), strict=True):
            stored[0, robot] = new
        self._has_joints[0, robot] = True
        if JointTrajectory in self.kinds:
            trajectory = self.slot(JointTrajectory)
            np.asarray(trajectory.commanded)[robot, len(VEHICLE_JOINTS) :] = False
        self._step_commands = None

    def _put_base(self, robot: int, command: Command) -> None:
        if isinstance(command, JointTrajectory):
            command = widen_trajectory(command, self.slot(JointTrajectory).joints)
        if self._has_joints is not None:
            self._has_joints[0, robot] = False
        kind = type(command)
        slot = self.kinds.index(kind)
        old_entry = self._entry[self.kinds[self._slot_index[0, robot]]]
        new_entry = self._entry[kind]
        fresh = old_entry if new_entry < old_entry else 0
        fresh = max(fresh, 1) if kind in (Trajectory, JointTrajectory) else fresh
        self._slot_index[0, robot] = slot
        self._fresh[0, robot] = max(self._fresh[0, robot], fresh)
        leaves = zip(jax.tree.leaves(self._slots[slot]), jax.tree.leaves(command), strict=True)
        for stored, new in leaves:
            stored[0, robot] = new
        self._step_commands = None

    def kind(self, robot: int) -> type:
        """Return the type of a robot's command."""
        return self.kinds[int(self._slot_index[0, robot])]

    def slot[C: Command](self, kind: type[C]) -> C:
        """Return arrays of a slot, [R] leading.

        Rows of robots with other commands are arbitrary.
        """
        commands: C = jax.tree.map(lambda leaf: leaf[0], self._slots[self.kinds.index(kind)])
        return commands

    def commands(self) -> MixedCommand:
        """Return the commands of one step; after it no stage is fresh any more."""
        if self._step_commands is None:
            # Copied: a device array may share the memory of the numpy array that it is made of.
            command = MixedCommand(
                which=as_leaf(self._slot_index),
                fresh=as_leaf(self._fresh),
                commands=tuple(self._slots),
                joints=self._joints,
                has_joints=None if self._has_joints is None else as_leaf(self._has_joints),
            )
            self._step_commands = jax.device_put(jax.tree.map(np.copy, command))
        result = self._step_commands
        if self._fresh.any():
            self._fresh[:] = 0
            self._step_commands = None
        return result


def _blank_commands(sizes: SlotSizes) -> dict[type, Command]:
    """Return an empty command of each type, [1, R] leading."""
    number = jnp.zeros(()).dtype

    def zeros(*tail: int, like: DTypeLike = number) -> jax.Array:
        return as_leaf(np.zeros((1, sizes.robots, *tail), like))

    joints = (*VEHICLE_JOINTS, *sizes.joints)
    table = zeros(sizes.points, len(joints))
    return {
        Trajectory: Trajectory(
            time_s=zeros(sizes.way_points),
            position_m=zeros(sizes.way_points, 3),
            found=zeros(like=bool) | True,
        ),
        JointTrajectory: JointTrajectory(
            joints=joints,
            time_s=zeros(sizes.points),
            position=table,
            velocity=table,
            acceleration=table,
            degree=zeros(sizes.points, like=np.int32) + LINEAR,
            commanded=zeros(len(joints), like=bool) | True,
        ),
        TrackingTarget: TrackingTarget(
            position_m=zeros(3),
            velocity_mps=zeros(3),
            acceleration_mps2=zeros(3),
            yaw_rad=zeros(),
            yaw_rate_radps=zeros(),
            yaw_acceleration_radps2=zeros(),
        ),
        PoseTarget: PoseTarget(position_m=zeros(3), velocity_mps=zeros(3), yaw_rad=zeros()),
        EndEffectorTarget: EndEffectorTarget(
            position_m=zeros(3),
            q=zeros(4),
            velocity_mps=zeros(3),
            angular_velocity_radps=zeros(3),
            is_oriented=zeros(like=bool),
        ),
        BodyTwist: BodyTwist(nu=zeros(6)),
        BodyWrench: BodyWrench(tau=zeros(6)),
        ThrusterPwm: ThrusterPwm(pwm_us=zeros(sizes.thrusters) + NEUTRAL_US),
    }


def _blank_joints(sizes: SlotSizes) -> JointTarget | None:
    """Return motions of joints at rest at 0, [1, R] leading; None where no robot has joints."""
    if not sizes.joints:
        return None
    shape, dtype = (1, sizes.robots, len(sizes.joints)), jnp.zeros(()).dtype
    position, velocity, acceleration = (as_leaf(np.zeros(shape, dtype)) for _ in range(3))
    return JointTarget(position=position, velocity=velocity, acceleration=acceleration)
