"""Conversion of keys to commands: driven robots, speeds, and the reaction to missing keys.

Each robot that may be driven is in one of four modes. It starts with its plan. A driving key takes
it over (teleop). Missing keys, or a stop key, brake it (stopping): it receives a zero twist until
it is slow, and then the pose at which it came to rest (hold). ``p`` returns it to its plan. The
module depends on no terminal and no wall clock: times are those of the scene.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

import jax.numpy as jnp
import numpy as np

from angler_mjx.robot.control.commands import BodyTwist, Estimate, PoseTarget
from angler_mjx.robot.control.commands.whole_body import JointTarget, WholeBodyCommand
from angler_mjx.robot.vehicles import library
from angler_mjx.runs.session.interface import Observation, RobotInfo, SessionCommand
from angler_mjx.teleop.arm_jog import ARM_KEYS, ArmJog
from angler_mjx.teleop.keys import ACTIONS, FACTORS, MOVES, STILL, Direction, KeyAction

KEY_TIMEOUT_S = 0.8
"""Time without a key after which a robot stops.

A held key repeats only after a while: 0.66 s on an unconfigured X server, 0.5 s on most desktops. A
shorter time would stop the robot in that gap; in a longer one it moves on blindly, 0.4 m in 0.8 s
at 0.5 m/s."""

REST_MPS, REST_RADPS = 0.03, 0.05
"""Max speeds of a braking robot at rest, which then holds its position."""

BRAKE_S = 4.0
"""Time limit of braking; then the robot holds its position, even if the current is too strong."""


RIGHTING_PER_S = 1.0
"""Rate at which a robot under keys is turned upright, for each radian of tilt.

Without it the tilt that a turn or a current leaves would stay: a twist has no upright reference."""


class DriveMode(Enum):
    """Drive mode of a robot."""

    PLAN = "plan"
    TELEOP = "teleop"
    STOPPING = "stopping"
    HOLD = "hold"


@dataclass
class _RobotControl:
    """Control state of one robot."""

    mode: DriveMode = DriveMode.PLAN
    direction: Direction = STILL
    since_s: float = 0.0
    """Time of the last key while driven, or of the start of braking."""
    is_sent: bool = True
    """Whether the mode was sent to the session."""
    remark: str = ""
    """Note for the user, until the next key."""


@dataclass(frozen=True, kw_only=True)
class TeleopCommands:
    """Commands to a session before its next step."""

    commands: dict[int, SessionCommand] = field(default_factory=dict)
    resume: tuple[int, ...] = ()
    """Robots that resume their plans."""


class TeleopPilot:
    """Pilot of some robots of a scene by keys.

    Attributes:
        driven: indices of the robots that may be driven.
        chosen: robots that receive keys now.
        speed_mps: set linear speed.
        turn_radps: set angular speed.
        help_wanted: whether to show the help.
        ended: whether a key requested the end.
    """

    def __init__(
        self,
        robots: Sequence[RobotInfo],
        driven: Sequence[int],
        *,
        speed_mps: float,
        turn_radps: float,
        silence_s: float = KEY_TIMEOUT_S,
    ) -> None:
        """Start with all robots on their plans; keys go to the first of ``driven``."""
        self.driven = tuple(driven)
        self.selected: tuple[int, ...] = self.driven[:1]
        self.speed_mps = speed_mps
        self.turn_radps = turn_radps
        self.silence_s = silence_s
        self.is_help_shown = False
        self.ended = False
        self._robots = robots
        self._controls = {i: _RobotControl() for i in self.driven}
        self._arms = {
            i: ArmJog(library.load_vehicle(robots[i].vehicle).find_joints())
            for i in self.driven
            if JointTarget in robots[i].accepts
        }

    def mode(self, robot: int) -> DriveMode:
        """Return the drive mode of a robot; the plan, for a robot that is not driven from here."""
        control = self._controls.get(robot)
        return DriveMode.PLAN if control is None else control.mode

    def remark(self, robot: int) -> str:
        """Return the user's note about a robot; empty if there is none."""
        control = self._controls.get(robot)
        return "" if control is None else control.remark

    def arm(self, robot: int) -> ArmJog | None:
        """Return the targets of a robot's joints; None without an arm that is driven from here."""
        return self._arms.get(robot)

    def press(self, key: str, time_s: float) -> None:
        """Process a key.

        Args:
            key: one character.
            time_s: time of the key, in seconds of the scene.
        """
        for control in self._selected_controls():
            control.remark = ""
        arms = [self._arms[i] for i in self.selected if i in self._arms]
        if key in ARM_KEYS and arms:
            for arm in arms:
                arm.press(key)
        elif key in MOVES and MOVES[key] != STILL:
            for control in self._selected_controls():
                control.mode, control.direction, control.since_s = (
                    DriveMode.TELEOP,
                    MOVES[key],
                    time_s,
                )
        elif key in FACTORS:
            linear, angular = FACTORS[key]
            self.speed_mps *= linear
            self.turn_radps *= angular
            for control in self._selected_controls():
                if control.mode is DriveMode.TELEOP:
                    control.since_s = time_s
        elif key in ACTIONS:
            self._apply_action(ACTIONS[key])
        else:
            for robot in self.selected:
                self.stop(robot, time_s)

    def stop(self, robot: int, time_s: float) -> None:
        """Brake a robot in any mode; a braking or holding robot is unchanged."""
        control = self._controls[robot]
        if control.mode in (DriveMode.PLAN, DriveMode.TELEOP):
            control.mode, control.since_s, control.is_sent = DriveMode.STOPPING, time_s, False

    def refuse(self, robot: int, reason: str, time_s: float) -> None:
        """Refuse a request for a robot: it stops, with the reason as its note."""
        self.stop(robot, time_s)
        self._controls[robot].remark = reason

    def build_commands(self, observation: Observation) -> TeleopCommands:
        """Return the commands from the keys so far, for the next step."""
        time_s, estimate = observation.time_s, observation.estimate
        commands: dict[int, SessionCommand] = {}
        resume = []
        for robot, control in self._controls.items():
            q, nu = np.asarray(estimate.q)[robot], np.asarray(estimate.nu)[robot]
            if control.mode is DriveMode.TELEOP and time_s - control.since_s > self.silence_s:
                self.stop(robot, time_s)
            if (
                control.mode is DriveMode.STOPPING
                and control.is_sent
                and _is_at_rest(control, nu, time_s)
            ):
                control.mode, control.is_sent = DriveMode.HOLD, False
            if control.mode is DriveMode.TELEOP:
                # Sent again at each step: the level frame turns within F as the robot tilts.
                nu = level_twist(self._scale_direction(control.direction), q)
                commands[robot] = BodyTwist(nu=jnp.asarray(limit_twist(nu, self._robots[robot])))
            elif not control.is_sent:
                if control.mode is DriveMode.PLAN:
                    resume.append(robot)
                elif control.mode is DriveMode.HOLD:
                    takes = PoseTarget in self._robots[robot].accepts
                    commands[robot] = hold_pose(estimate, robot) if takes else _stop_command()
                else:
                    commands[robot] = _stop_command()
            control.is_sent = True
        self._add_joints(commands, estimate)
        return TeleopCommands(commands=commands, resume=tuple(resume))

    def _add_joints(self, commands: dict[int, SessionCommand], estimate: Estimate) -> None:
        """Add the motions of joints to the commands to the bases."""
        if estimate.joints is None:
            return
        for robot, arm in self._arms.items():
            target = arm.take_target(np.asarray(estimate.joints.position, float)[robot])
            if target is None:
                continue
            base = commands.get(robot)
            commands[robot] = target
            if isinstance(base, BodyTwist | PoseTarget):
                commands[robot] = WholeBodyCommand(base=base, joints=target)

    def _selected_controls(self) -> list[_RobotControl]:
        return [self._controls[i] for i in self.selected]

    def _apply_action(self, action: KeyAction) -> None:
        match action:
            case KeyAction.NEXT:
                at = self.driven.index(self.selected[-1]) + 1
                self.selected = (self.driven[at % len(self.driven)],)
            case KeyAction.ALL:
                self.selected = self.driven
            case KeyAction.PLAN | KeyAction.HOLD:
                mode = DriveMode.PLAN if action is KeyAction.PLAN else DriveMode.HOLD
                for control in self._selected_controls():
                    if control.mode is not mode:
                        control.mode, control.is_sent = mode, False
            case KeyAction.HELP:
                self.is_help_shown = not self.is_help_shown
            case KeyAction.QUIT:
                self.ended = True

    def _scale_direction(self, direction: Direction) -> np.ndarray:
        """Return [4] surge, sway, heave in m/s and turn in rad/s, at the set speeds."""
        return np.append(self.speed_mps * np.array(direction[:3]), self.turn_radps * direction.yaw)


def _stop_command() -> BodyTwist:
    """Return a stop; for robots that accept velocities alone, also the nearest to holding."""
    return BodyTwist(nu=jnp.zeros(6))


def level_twist(velocity: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Convert a velocity in a robot's level frame to a twist in F that also rights the robot.

    The level frame has the robot's heading and an upright z axis, so that forward stays level and
    up stays up while the robot tilts. nu_F = [R^T Rz(psi) v, R^T (e_z r + k (R e_z) x e_z)], R from
    F to W and k `RIGHTING_PER_S`.

    Args:
        velocity: [4] surge, sway, heave, m/s, and yaw rate, rad/s.
        q: [4] attitude, F to W.

    Returns:
        nu [6] in F.
    """
    surge, sway, heave, turn = velocity
    yaw = heading(q)
    cos, sin = math.cos(yaw), math.sin(yaw)
    linear = np.array([cos * surge - sin * sway, sin * surge + cos * sway, heave])
    upright = _to_body(q, np.array([0.0, 0.0, 1.0]))
    righting = RIGHTING_PER_S * np.array([-upright[1], upright[0], 0.0])  # e_z x upright, in F
    return np.append(_to_body(q, linear), turn * upright + righting)


def limit_twist(nu: np.ndarray, robot: RobotInfo) -> np.ndarray:
    """Return a twist nu [6] in F, slowed to the robot's limits; its direction stays."""
    linear, angular = nu[:3], nu[3:]
    speeds = np.abs(linear) / np.asarray(robot.max_speed_mps)
    turn = float(np.linalg.norm(angular)) / robot.max_turn_radps
    return np.append(linear / max(1.0, float(speeds.max())), angular / max(1.0, turn))


def _to_body(q: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Rotate a vector [3] from W to F on the host; a few JAX operations take longer than a step."""
    w, axis = float(q[0]), -np.asarray(q[1:], float)
    double_cross = 2.0 * np.cross(axis, vector)
    turned: np.ndarray = vector + w * double_cross + np.cross(axis, double_cross)
    return turned


def hold_pose(estimate: Estimate, robot: int) -> PoseTarget:
    """Return the current pose of a robot of a scene, to be held."""
    q = np.asarray(estimate.q)[robot]
    return PoseTarget(
        position_m=jnp.asarray(np.asarray(estimate.p)[robot]),
        velocity_mps=jnp.zeros(3),
        yaw_rad=jnp.asarray(heading(q)),
    )


def heading(q: np.ndarray) -> float:
    """Return heading psi, rad, about z up, 0 = east, of attitude q [4] (Fossen 2021, eq. 2.81)."""
    w, x, y, z = (float(part) for part in q)
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def _is_at_rest(control: _RobotControl, nu: np.ndarray, time_s: float) -> bool:
    """Return whether a braking robot has come to rest, or has tried for long enough."""
    is_slow = np.linalg.norm(nu[:3]) < REST_MPS and np.linalg.norm(nu[3:]) < REST_RADPS
    return bool(is_slow) or time_s - control.since_s > BRAKE_S
