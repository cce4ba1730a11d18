"""Validation of commands on the host, before a step.

Every check raises a ConfigError that names the robot, the part of the command and its value.
"""

import math
from dataclasses import dataclass

import jax
import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.host_arrays import as_leaf
from angler_mjx.robot.control.commands import (
    BodyTwist,
    BodyWrench,
    PoseTarget,
    ThrusterPwm,
    TrackingTarget,
    joint_goal,
)
from angler_mjx.robot.control.commands.joint_goal import JointGoal
from angler_mjx.robot.control.commands.joint_trajectory import (
    CUBIC,
    VEHICLE_JOINTS,
    JointState,
    JointTrajectory,
    interpolate_segment,
    is_continuous,
)
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.commands.whole_body import (
    EndEffectorTarget,
    JointTarget,
    WholeBodyCommand,
)
from angler_mjx.robot.control.stack import Command
from angler_mjx.robot.vehicles.thrusters import PWM_HIGH_US, PWM_LOW_US
from angler_mjx.runs.session.command_slots import COMMAND_TYPES
from angler_mjx.runs.session.interface import Floats, RobotInfo

LIMIT_MARGIN = 1.0 + 1e-6
"""Relative margin by which a command at the limit passes in spite of rounding."""
UNIT_TOLERANCE = 1e-3
"""Maximum difference of the length of a quaternion from 1."""
SEGMENT_FRACTIONS = as_leaf(np.linspace(0.0, 1.0, 9))
"""Fractions of a segment at which its speed is checked."""


@dataclass(frozen=True, kw_only=True)
class RobotPosition:
    """Pose of a robot, for checks of commands."""

    p: Floats
    """[3] m, in W."""
    yaw_rad: float
    arm: tuple[float, ...] = ()
    """Positions of the joints of its arm, rad or m."""

    @property
    def joints(self) -> tuple[float, ...]:
        """Return the vehicle's joints x, y, z and yaw, then those of the arm."""
        return (*map(float, self.p), self.yaw_rad, *self.arm)


@dataclass(frozen=True, kw_only=True)
class CommandLimits:
    """Limits of a session's commands."""

    start_tolerance: float
    """Maximum distance of a path's start from the robot; m, and rad of yaw."""
    points: int
    """Maximum number of points of a JointTrajectory."""
    way_points: int
    """Maximum number of way-points of a Trajectory."""

    def rows(self, kind: type) -> int:
        """Return the maximum number of rows of a path of either type."""
        return self.points if kind is JointTrajectory else self.way_points


def check_command(
    robot: RobotInfo, position: RobotPosition, limits: CommandLimits, command: object, now_s: float
) -> None:
    """Refuse a command that a robot cannot follow.

    Args:
        robot: robot that receives the command.
        position: pose of the robot.
        limits: limits of the session.
        command: command of any type.
        now_s: time of the session.

    Raises:
        ConfigError: the robot cannot follow the command; the message names the violated limit and
            the value.
    """
    kind = type(command)
    if kind not in robot.accepts:
        names = ", ".join(accepted.__name__ for accepted in robot.accepts)
        rigid = kind in (JointTarget, WholeBodyCommand) and not robot.joints
        reason = f": {robot.vehicle} has no joints" if rigid else ""
        raise ConfigError(f"{robot.name}: takes no {kind.__name__}{reason}; give one of {names}")
    if isinstance(command, JointGoal):
        _check_goal(robot, position, limits, command, now_s)
        return
    # Copied to the host unchanged: numpy would have JAX compile a change of their type.
    faults = _command_faults(robot, position, limits, jax.device_get(command))
    if faults:
        head = f"{robot.name}: {kind.__name__} refused, {len(faults)} fault"
        raise ConfigError("\n  ".join([head + "s" * (len(faults) > 1), *faults]))


def _check_goal(
    robot: RobotInfo, position: RobotPosition, limits: CommandLimits, goal: JointGoal, now_s: float
) -> None:
    surge, sway, heave = map(float, robot.max_speed_mps)
    level = max(surge, sway)  # the faster direction, into which a vehicle can turn
    joint_goal.validate_goal(
        goal,
        robot=robot.name,
        joints=(*VEHICLE_JOINTS, *robot.joints),
        position=position.joints,
        start_tolerance=limits.start_tolerance,
        max_speed={"x": level, "y": level, "z": heave, "yaw": robot.max_turn_radps},
        now_s=now_s,
    )
    if len(goal.points) >= limits.points:
        raise ConfigError(
            f"{robot.name}: points: {len(goal.points)} of them; this session takes at most "
            f"{limits.points - 1} at once"
        )


def _command_faults(
    robot: RobotInfo,
    position: RobotPosition,
    limits: CommandLimits,
    command: Command | JointTarget,
) -> list[str]:
    match command:
        case Trajectory():
            return _path_faults(robot, position, limits, command)
        case JointTrajectory():
            return _joint_faults(robot, position, limits, command)
        case TrackingTarget():
            return _tracking_faults(robot, command)
        case PoseTarget():
            return _pose_faults(robot, command)
        case BodyTwist():
            return _twist_faults(robot, command)
        case BodyWrench():
            return _array_faults(command, {"tau": (6,)})
        case ThrusterPwm():
            return _pwm_faults(robot, command)
        case EndEffectorTarget():
            return _end_effector_faults(command)
        case WholeBodyCommand():
            if type(command.base) not in robot.accepts or type(command.base) not in COMMAND_TYPES:
                return [f"base: takes no {type(command.base).__name__}"]
            return [
                *_command_faults(robot, position, limits, command.base),
                *_target_faults(robot, command.joints),
            ]
        case JointTarget():
            return _target_faults(robot, command)


def _target_faults(robot: RobotInfo, command: JointTarget) -> list[str]:
    """List faults of a motion of joints; numbers beyond their limits are clipped in the step."""
    size: tuple[int, ...] = (len(robot.joints),)
    shapes = {"position": size, "velocity": size, "acceleration": size}
    faults = _array_faults(command, shapes)
    return faults and [*faults, f"joints of {robot.vehicle}: {', '.join(robot.joints)}"]


def _name_faults(robot: RobotInfo, joints: tuple[str, ...]) -> list[str]:
    """List joints that a trajectory has beside those of its robot, or lacks."""
    expected = (*VEHICLE_JOINTS, *robot.joints)
    if joints in (VEHICLE_JOINTS, expected):
        return []
    unknown = [
        f"joints: {name!r} is no joint of this robot" for name in joints if name not in expected
    ]
    missing = [f"joints: {name!r} is missing" for name in expected if name not in joints]
    others = unknown + missing or [f"joints = {joints}: have another order"]
    choice = f"{VEHICLE_JOINTS} or {expected}" if robot.joints else f"{VEHICLE_JOINTS}"
    return [*others, f"joints must be {choice}; a JointGoal may name some"]


def _pose_faults(robot: RobotInfo, command: PoseTarget) -> list[str]:
    faults = _array_faults(command, {"position_m": (3,), "velocity_mps": (3,), "yaw_rad": ()})
    return faults or _velocity_faults(robot, "velocity_mps", command.velocity_mps)


def _end_effector_faults(command: EndEffectorTarget) -> list[str]:
    shapes = {"position_m": (3,), "q": (4,), "velocity_mps": (3,), "angular_velocity_radps": (3,)}
    if faults := _array_faults(command, {**shapes, "is_oriented": ()}):
        return faults
    length = float(np.linalg.norm(np.asarray(command.q, float)))
    if abs(length - 1.0) > UNIT_TOLERANCE:
        return [f"q has the length {length:g}: must be a quaternion of length 1"]
    return []


def _tracking_faults(robot: RobotInfo, command: TrackingTarget) -> list[str]:
    shapes = {"position_m": (3,), "velocity_mps": (3,), "acceleration_mps2": (3,), "yaw_rad": ()}
    faults = _array_faults(command, {**shapes, "yaw_rate_radps": (), "yaw_acceleration_radps2": ()})
    return faults or [
        *_velocity_faults(robot, "velocity_mps", command.velocity_mps),
        *_turn_faults(robot, "yaw_rate_radps", float(command.yaw_rate_radps)),
    ]


def _twist_faults(robot: RobotInfo, command: BodyTwist) -> list[str]:
    if faults := _array_faults(command, {"nu": (6,)}):
        return faults
    nu = np.asarray(command.nu, float)
    faults = [
        f"nu[{i}] ({axis}) = {nu[i]:g} m/s: {limit:.3g} m/s is the most that this vehicle can do"
        for i, (axis, limit) in enumerate(
            zip(("surge", "sway", "heave"), robot.max_speed_mps, strict=True)
        )
        if abs(nu[i]) > limit * LIMIT_MARGIN
    ]
    return faults + _turn_faults(robot, "nu[3:]", float(np.linalg.norm(nu[3:])))


def _pwm_faults(robot: RobotInfo, command: ThrusterPwm) -> list[str]:
    if faults := _array_faults(command, {"pwm_us": (len(robot.thrusters),)}):
        return faults
    return [
        f"pwm_us[{i}] ({name}) = {value:g} us: must be {PWM_LOW_US:g} to {PWM_HIGH_US:g}"
        for i, (name, value) in enumerate(
            zip(robot.thrusters, np.asarray(command.pwm_us, float), strict=True)
        )
        if not PWM_LOW_US <= value <= PWM_HIGH_US
    ]


def _path_faults(
    robot: RobotInfo, position: RobotPosition, limits: CommandLimits, command: Trajectory
) -> list[str]:
    time, point = np.asarray(command.time_s, float), np.asarray(command.position_m, float)
    if time.ndim != 1 or time.size < 1 or point.shape != (time.size, 3):
        return [f"time_s {time.shape} and position_m {point.shape}: must be [n] and [n, 3]"]
    if time.size > limits.way_points:
        return [f"time_s: {time.size} way-points; this session takes at most {limits.way_points}"]
    rows = np.column_stack([time, point])
    if faults := _row_faults("way-point", rows) or _time_faults("time_s", time):
        return faults
    durations_s, legs_m = np.diff(time), np.linalg.norm(np.diff(point, axis=0), axis=1)
    max_speed_mps = float(np.max(robot.max_speed_mps)) * LIMIT_MARGIN
    distance_m = float(np.linalg.norm(point[0] - position.p))
    faults = [
        f"position_m[{i + 1}]: {legs_m[i]:.3g} m in {durations_s[i]:.3g} s; {max_speed_mps:.3g} "
        "m/s is the most that "
        "this vehicle can do"
        for i in np.flatnonzero(legs_m > max_speed_mps * durations_s + 1e-9)
    ]
    return faults + _away_faults("position_m[0]", "", distance_m, limits.start_tolerance)


def _joint_faults(
    robot: RobotInfo, position: RobotPosition, limits: CommandLimits, command: JointTrajectory
) -> list[str]:
    if faults := _name_faults(robot, command.joints):
        return faults
    time = np.asarray(command.time_s, float)
    n = time.size
    if not 2 <= n <= limits.points:
        return [f"time_s: {n} points; this session takes 2 to {limits.points}"]
    table = (n, len(command.joints))
    shapes = {"time_s": (n,), "position": table, "velocity": table, "acceleration": table}
    faults = _array_faults(command, {**shapes, "degree": (n,), "commanded": table[1:]})
    if faults := faults or _time_faults("time_s", time):
        return faults
    first, commanded = np.asarray(command.position, float)[0], np.asarray(command.commanded)
    for i, joint in enumerate(command.joints):
        away = float(first[i]) - position.joints[i]
        away = abs(math.remainder(away, math.tau) if is_continuous(joint) else away)
        if commanded[i]:
            joint_label = f", joint {joint!r}"
            faults += _away_faults("position[0]", joint_label, away, limits.start_tolerance)
    return faults + _joint_speed_faults(robot, command)


def _joint_speed_faults(robot: RobotInfo, command: JointTrajectory) -> list[str]:
    host: JointTrajectory = jax.tree.map(lambda leaf: np.asarray(leaf, float), command)
    time, velocity, degree = host.time_s, host.velocity, host.degree
    surge, sway, heave = map(float, robot.max_speed_mps)
    limits = np.array([max(surge, sway), max(surge, sway), heave, robot.max_turn_radps])
    faults = []
    for k in np.flatnonzero(np.diff(time) > 0):
        begin, end = (
            JointState(
                position=host.position[i], velocity=velocity[i], acceleration=host.acceleration[i]
            )
            for i in (k, k + 1)
        )
        span = time[k + 1] - time[k]
        velocities = [
            interpolate_segment(begin, end, span, s, degree[k]).velocity for s in SEGMENT_FRACTIONS
        ]
        # Joints of an arm are clipped at their limits in the step.
        fastest = np.max(np.abs(velocities), axis=0)[: len(VEHICLE_JOINTS)]
        faults += [
            f"point {k + 1}, joint {joint!r}: needs {speed:.3g} per s on the way there, "
            f"{limit:.3g} is the most; give it more time"
            for joint, speed, limit in zip(VEHICLE_JOINTS, fastest, limits, strict=True)
            if speed > limit * LIMIT_MARGIN
        ]
    if degree[-2] >= CUBIC and np.any(velocity[-1] != 0.0):
        faults.append(f"velocity[-1] = {velocity[-1]}: must be 0, the end is held")
    return faults


def _array_faults(command: Command | JointTarget, shapes: dict[str, tuple[int, ...]]) -> list[str]:
    """List arrays of a wrong shape, or with numbers that are not finite."""
    faults = []
    for name, shape in shapes.items():
        value = np.asarray(getattr(command, name), float)
        if value.shape != shape:
            faults.append(f"{name}: has the shape {value.shape}, must be {shape}")
        elif not np.all(np.isfinite(value)):
            index = tuple(np.argwhere(~np.isfinite(value))[0].tolist())
            label = f"{name}[{', '.join(map(str, index))}]" if index else name
            faults.append(f"{label} = {value[index]}: must be a finite number")
    return faults


def _row_faults(name: str, rows: Floats) -> list[str]:
    bad = np.argwhere(~np.isfinite(rows))
    return [f"{name} {i}: {rows[i, j]} is not a finite number" for i, j in bad[:1]]


def _time_faults(name: str, time: Floats) -> list[str]:
    faults = [] if time[0] == 0 else [f"{name}[0] = {time[0]:g} s: must be 0"]
    return faults + [
        f"{name}[{i + 1}] = {time[i + 1]:g} s: must not be before {time[i]:g} s before it"
        for i in np.flatnonzero(np.diff(time) < 0)
    ]


def _away_faults(name: str, joint_label: str, away: float, tolerance: float) -> list[str]:
    if tolerance <= 0 or away <= tolerance:
        return []
    return [
        f"{name}{joint_label}: {away:.3g} from where the robot is, farther than the start "
        "tolerance "
        f"{tolerance:g}; start nearer"
    ]


def _velocity_faults(robot: RobotInfo, name: str, velocity: jax.Array | np.ndarray) -> list[str]:
    speed, max_speed_mps = float(np.linalg.norm(velocity)), float(np.max(robot.max_speed_mps))
    if speed <= max_speed_mps * LIMIT_MARGIN:
        return []
    return [
        f"{name}: {speed:.3g} m/s; {max_speed_mps:.3g} m/s is the most that this vehicle can do"
    ]


def _turn_faults(robot: RobotInfo, name: str, rate: float) -> list[str]:
    max_rate_radps = robot.max_turn_radps
    if abs(rate) <= max_rate_radps * LIMIT_MARGIN:
        return []
    return [
        f"{name}: {rate:.3g} rad/s; {max_rate_radps:.3g} rad/s is the most that this vehicle can do"
    ]
