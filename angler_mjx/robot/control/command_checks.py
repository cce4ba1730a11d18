"""What a batch of commands must look like before it enters a compiled step (host side)."""

from dataclasses import fields
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.commands import (
    BodyTwist,
    BodyWrench,
    PoseTarget,
    ThrusterPwm,
    TrackingTarget,
)
from angler_mjx.robot.control.commands.joint_trajectory import JointTrajectory
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.commands.whole_body import (
    EndEffectorTarget,
    JointTarget,
    WholeBodyCommand,
)
from angler_mjx.robot.vehicles.thrusters import PWM_HIGH_US, PWM_LOW_US

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

type Axes = tuple[int | str, ...]

POINTS, JOINTS, THRUSTERS = "n_point", "n_joint", "n_thruster"

AXES: dict[type, dict[str, Axes]] = {
    Trajectory: {"time_s": (POINTS,), "position_m": (POINTS, 3), "found": ()},
    JointTrajectory: {
        "time_s": (POINTS,),
        "position": (POINTS, JOINTS),
        "velocity": (POINTS, JOINTS),
        "acceleration": (POINTS, JOINTS),
        "degree": (POINTS,),
        "commanded": (JOINTS,),
        "found": (),
    },
    TrackingTarget: {
        "position_m": (3,),
        "velocity_mps": (3,),
        "acceleration_mps2": (3,),
        "yaw_rad": (),
        "yaw_rate_radps": (),
        "yaw_acceleration_radps2": (),
    },
    PoseTarget: {"position_m": (3,), "velocity_mps": (3,), "yaw_rad": ()},
    BodyTwist: {"nu": (6,)},
    BodyWrench: {"tau": (6,)},
    ThrusterPwm: {"pwm_us": (THRUSTERS,)},
    EndEffectorTarget: {
        "position_m": (3,),
        "q": (4,),
        "velocity_mps": (3,),
        "angular_velocity_radps": (3,),
        "is_oriented": (),
    },
    JointTarget: {"position": (JOINTS,), "velocity": (JOINTS,), "acceleration": (JOINTS,)},
}
"""Axes of each array of a command for one robot."""


def check_arrays(
    command: "DataclassInstance", lead: tuple[int, ...], thrusters: int, joints: int = 0
) -> None:
    """Refuse arrays of other shapes than the command's.

    Args:
        command: of any type that a stack takes, with all robots of all worlds.
        lead: sizes of the axes that all arrays begin with, [world, robot].
        thrusters: of a robot, padding included.
        joints: of its links.

    Raises:
        ConfigError: names the command, the field, what it is and what it must be.
    """
    if isinstance(command, WholeBodyCommand):
        check_arrays(command.base, lead, thrusters, joints)
        check_arrays(command.joints, lead, thrusters, joints)
        return
    kind = type(command).__name__
    sizes: dict[str, int] = {THRUSTERS: thrusters, JOINTS: joints}
    if isinstance(command, JointTrajectory):
        sizes[JOINTS] = len(command.joints)
    axes = AXES[type(command)]
    for name in (field.name for field in fields(command) if field.name in axes):
        value, where = getattr(command, name), f"command {kind}: {name}"
        if value is None and isinstance(command, JointTrajectory) and name == "found":
            continue  # no planner was asked
        dtype = getattr(value, "dtype", None)
        if dtype is None or not (jnp.isdtype(dtype, ("real floating", "integral", "bool"))):
            raise ConfigError(
                f"{where} is {type(value).__name__ if dtype is None else dtype}: must be an array "
                "of real numbers"
            )
        if POINTS in axes[name] and POINTS not in sizes and len(value.shape) > len(lead):
            sizes[POINTS] = max(2, value.shape[len(lead)])
        wanted = (*lead, *(sizes.get(n, n) if isinstance(n, str) else n for n in axes[name]))
        if value.shape != wanted:
            raise ConfigError(
                f"{where} has the shape {_format_shape(value.shape)}: must be "
                f"{_format_shape(wanted)}, for "
                f"{_format_shape(('world', 'robot', *axes[name]))}"
            )


def check_choice(mixed: object, lead: tuple[int, ...], joints: int = 0) -> None:
    """Refuse a `MixedCommand` that lacks a choice for any robot; as `check_arrays`."""
    names = ["which", "fresh"]
    target = getattr(mixed, "joints", None)
    if target is not None:
        check_arrays(target, lead, 0, joints)
        names.append("has_joints")
    for name in names:
        value = getattr(mixed, name)
        if getattr(value, "shape", None) != lead:
            raise ConfigError(
                f"command Mixed: {name} has the shape {_format_shape(np.shape(value))}: must be "
                f"{_format_shape(lead)}, for [world, robot]"
            )


def check_pulses(command: object) -> None:
    """Refuse pulse widths in NumPy's arrays beyond the ends of the thrust table, and NaN.

    Those in arrays of a device are not looked at, which would wait for it: there the table's ends
    hold beyond them, and a robot that is given NaN ends as diverged.

    Args:
        command: of any type, with the shapes that `check_arrays` asks for.

    Raises:
        ConfigError: names the world, the robot, the thruster and the value.
    """
    if not (isinstance(command, ThrusterPwm) and isinstance(command.pwm_us, np.ndarray)):
        return
    wrong = ~((command.pwm_us >= PWM_LOW_US) & (command.pwm_us <= PWM_HIGH_US))
    if wrong.any():
        world, robot, thruster = at = tuple(int(i) for i in np.argwhere(wrong)[0])
        raise ConfigError(
            f"command ThrusterPwm: pwm_us of world {world}, robot {robot}, thruster {thruster} is "
            f"{command.pwm_us[at]:g} us: must be {PWM_LOW_US} to {PWM_HIGH_US}"
        )


def _format_shape(shape: tuple[int | str, ...]) -> str:
    return f"[{', '.join(map(str, shape))}]"
