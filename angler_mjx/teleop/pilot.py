"""From keys to commands: who is driven, how fast, and what happens when the keys fall silent.

Each robot that may be driven is in one of four modes. It begins with its plan. A key that drives
takes it over (teleop). Silence, or a key that stops, brakes it (stopping): it is told a twist of
zero until it is slow, and then the pose at which it came to rest (hold). ``p`` gives it back to its
plan. Nothing here knows of terminals or of wall clocks: times are those of the scene.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

import jax.numpy as jnp
import numpy as np

from angler_mjx.robot.control.commands import BodyTwist, Estimate, PoseTarget
from angler_mjx.robot.control.stack import Command
from angler_mjx.runs.session.interface import Observation, RobotInfo
from angler_mjx.teleop.keys import ACTIONS, FACTORS, MOVES, STILL, Direction, KeyAction

KEY_TIMEOUT_S = 0.8
"""Without a key for so long a robot stops. A key that is held repeats only after a while: 0.66 s on
an X server that nobody configured, 0.5 s on most desktops. A shorter time would stop the robot in
that gap; in a longer one it goes on blindly, 0.4 m in 0.8 s at 0.5 m/s."""

REST_MPS, REST_RADPS = 0.03, 0.05
"""Slower than this a robot that brakes is at rest, and holds its position."""

BRAKE_S = 4.0
"""A robot that has not come to rest in this time (the current may be too much for it) is told to
hold where it is then."""


RIGHTING_PER_S = 1.0
"""Rate at which a robot under keys is turned upright, for each radian of tilt. Without it the tilt
that a turn or a stream leaves would stay: nothing in a twist says where up is."""


class DriveMode(Enum):
    """What drives a robot."""

    PLAN = "plan"
    TELEOP = "teleop"
    STOPPING = "stopping"
    HOLD = "hold"


@dataclass
class _RobotControl:
    """One robot's."""

    mode: DriveMode = DriveMode.PLAN
    direction: Direction = STILL
    since_s: float = 0.0
    """The last key while it is driven, or when it began to brake."""
    is_sent: bool = True
    """Whether the session knows of the mode."""
    remark: str = ""
    """What a person should know, until the next key."""


@dataclass(frozen=True, kw_only=True)
class TeleopCommands:
    """What a session is to be told before its next step."""

    commands: dict[int, Command] = field(default_factory=dict)
    resume: tuple[int, ...] = ()
    """Robots that go back to their plans."""


class TeleopPilot:
    """Drives some robots of a scene by keys.

    Attributes:
        driven: indices of the robots that it may drive.
        chosen: those that keys go to now.
        speed_mps: set linear speed.
        turn_radps: set angular speed.
        help_wanted: whether the help is to be shown.
        ended: whether a key asked for the end.
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
        """Everybody follows the plan; keys go to the first of ``driven``."""
        self.driven = tuple(driven)
        self.selected: tuple[int, ...] = self.driven[:1]
        self.speed_mps = speed_mps
        self.turn_radps = turn_radps
        self.silence_s = silence_s
        self.is_help_shown = False
        self.ended = False
        self._robots = robots
        self._controls = {i: _RobotControl() for i in self.driven}

    def mode(self, robot: int) -> DriveMode:
        """What drives a robot; the plan, for one that is not driven from here."""
        control = self._controls.get(robot)
        return DriveMode.PLAN if control is None else control.mode

    def remark(self, robot: int) -> str:
        """What a person should know of a robot; empty if nothing."""
        control = self._controls.get(robot)
        return "" if control is None else control.remark

    def press(self, key: str, time_s: float) -> None:
        """Take a key.

        Args:
            key: one character.
            time_s: when, in seconds of the scene.
        """
        for control in self._selected_controls():
            control.remark = ""
        if key in MOVES and MOVES[key] != STILL:
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
        """Brake a robot, whatever drives it; one that brakes or holds already goes on with that."""
        control = self._controls[robot]
        if control.mode in (DriveMode.PLAN, DriveMode.TELEOP):
            control.mode, control.since_s, control.is_sent = DriveMode.STOPPING, time_s, False

    def refuse(self, robot: int, reason: str, time_s: float) -> None:
        """A robot cannot do what was asked for: it stops, and a person is told why."""
        self.stop(robot, time_s)
        self._controls[robot].remark = reason

    def build_commands(self, observation: Observation) -> TeleopCommands:
        """What follows from the keys so far, for the step that begins now."""
        time_s, estimate = observation.time_s, observation.estimate
        commands: dict[int, Command] = {}
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
                # Told anew at each step: the level frame turns within F as the robot tilts.
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
        return TeleopCommands(commands=commands, resume=tuple(resume))

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
        """[4] surge, sway, heave in m/s and turn in rad/s, as set."""
        return np.append(self.speed_mps * np.array(direction[:3]), self.turn_radps * direction.yaw)


def _stop_command() -> BodyTwist:
    """Stop; of those who take velocities alone, also the nearest thing to holding."""
    return BodyTwist(nu=jnp.zeros(6))


def level_twist(velocity: np.ndarray, q: np.ndarray) -> np.ndarray:
    """A velocity in a robot's level frame as a twist in F that also rights the robot.

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
    """A twist nu [6] in F, slowed to what a robot can do; its direction stays."""
    linear, angular = nu[:3], nu[3:]
    speeds = np.abs(linear) / np.asarray(robot.max_speed_mps)
    turn = float(np.linalg.norm(angular)) / robot.max_turn_radps
    return np.append(linear / max(1.0, float(speeds.max())), angular / max(1.0, turn))


def _to_body(q: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """A vector [3] of W in F, on the host: a few operations of JAX take longer than a step."""
    w, axis = float(q[0]), -np.asarray(q[1:], float)
    double_cross = 2.0 * np.cross(axis, vector)
    turned: np.ndarray = vector + w * double_cross + np.cross(axis, double_cross)
    return turned


def hold_pose(estimate: Estimate, robot: int) -> PoseTarget:
    """The pose at which a robot of a scene is, to be held."""
    q = np.asarray(estimate.q)[robot]
    return PoseTarget(
        position_m=jnp.asarray(np.asarray(estimate.p)[robot]),
        velocity_mps=jnp.zeros(3),
        yaw_rad=jnp.asarray(heading(q)),
    )


def heading(q: np.ndarray) -> float:
    """Heading psi, rad, about z up, 0 = east, of an attitude q [4] (Fossen 2021, eq. 2.81)."""
    w, x, y, z = (float(part) for part in q)
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def _is_at_rest(control: _RobotControl, nu: np.ndarray, time_s: float) -> bool:
    """Whether a robot that brakes has come to rest, or has tried for long enough."""
    is_slow = np.linalg.norm(nu[:3]) < REST_MPS and np.linalg.norm(nu[3:]) < REST_RADPS
    return bool(is_slow) or time_s - control.since_s > BRAKE_S
