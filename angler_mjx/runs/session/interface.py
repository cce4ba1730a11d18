"""What every session is: a scene of robots that take commands and are observed.

A planner, a policy or a person holds a `Session` and never learns what stands behind it. Commands
are latched: a robot goes on with the last one until it is given another. A command that a robot
cannot follow is refused for that robot alone, which then holds its position while the others go on.
"""

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from angler_mjx.robot.control.commands import BodyWrench, Estimate, ThrusterPwm
from angler_mjx.robot.control.joint_goal import JointGoal
from angler_mjx.robot.control.stack import Command
from angler_mjx.sim.information import rename_warning
from angler_mjx.sim.state import Outcome

type Floats = NDArray[np.floating[Any]]

type SessionCommand = Command | JointGoal
"""What a robot can be told: a command of one robot, or a JointTrajectory as a message."""


@dataclass(frozen=True, kw_only=True)
class RobotInfo:
    """What is known of a robot before it moves."""

    name: str
    """As in topics and files: ``robot_0``, ``robot_1``, ..."""
    vehicle: str
    parameter_set: str
    radius_m: float
    """Of the sphere about its hull."""
    cruise_speed_mps: float
    max_speed_mps: Floats
    """[3] terminal speeds along the axes of F."""
    max_turn_radps: float = math.inf
    """Terminal speed of turning about z of F; infinite where nobody knows it."""
    thrusters: tuple[str, ...]
    accepts: tuple[type, ...]
    """Types of commands; `JointGoal` among them if JointTrajectory is."""


@dataclass(frozen=True, kw_only=True)
class RobotStatus:
    """How a robot stands with what it was told."""

    outcome: Outcome
    command: str
    """Name of the type it follows; ``plan`` for the path it was given at the reset."""
    refused: str = ""
    """Why its last command was refused; empty if it was not. It holds its position then."""
    note: str = ""
    """What else its driver has to say: a mode, or how a JointTrajectory stands, beginning with the
    name of its `angler_mjx.robot.control.joint_tolerance.ResultCode`."""


@dataclass(frozen=True, kw_only=True)
class SceneObstacles:
    """Obstacles as the robots may know them; [n] leads."""

    position_m: Floats
    """[n, 3] in W."""
    attitude: Floats
    """[n, 4] q."""
    kind: NDArray[np.integer[Any]]
    """[n] a kind of `angler_mjx.world.obstacles.types`."""
    half_size_m: Floats
    """[n, 3] as `angler_mjx.sim.information.ObstacleInformation.half_size_m`."""

    @property
    def size_m(self) -> Floats:
        """[n, 3] the former name of `half_size_m`, with the same meaning."""
        warnings.warn(rename_warning(type(self)), DeprecationWarning, stacklevel=2)
        return self.half_size_m


@dataclass(frozen=True, kw_only=True)
class Observation:
    """A scene at one time; arrays are numpy's, [R] leads."""

    time_s: float
    """Since the reset, by the scene's own clock."""
    estimate: Estimate
    """As the controllers know it: p [R, 3], q [R, 4], nu [R, 6]."""
    covariance: Floats | None
    """[R, 9, 9] of position (W), attitude error and linear velocity (W), or its diagonal alone.
    None where the estimate is the truth."""
    truth: Estimate | None
    """None where nobody knows it."""
    pwm: ThrusterPwm
    """[R, n_thruster] sent in the step that led here."""
    demanded: BodyWrench | None
    """[R, 6] wrench asked for in that step; NaN where a robot's command stood below wrenches. None
    where the driver does not say."""
    realised: BodyWrench | None
    """[R, 6] wrench that the thrusters settle at with those signals; None where nobody knows it."""
    target_m: Floats | None = None
    """[R, 3] position aimed at in that step, in W; the robot's own where it aimed at none. None
    where the driver does not say."""
    clearance_m: Floats | None
    """[R] from the hull to the nearest of cells, floor and obstacles; None where nobody knows it.
    Exact up to a radius, and that radius beyond it."""
    obstacles: SceneObstacles | None
    status: tuple[RobotStatus, ...]
    readings: Mapping[str, Any] = field(default_factory=dict)
    """Latest readings of the instruments by name, [R] leading; empty without instruments."""


class Session(Protocol):
    """A scene that can be stepped."""

    @property
    def robots(self) -> Sequence[RobotInfo]:
        """Who is there, in order."""
        ...

    @property
    def dt_s(self) -> float:
        """Control period, s."""
        ...

    def reset(self, seed: int | None = None) -> Observation:
        """Begin anew: every robot at its start, at rest, following its plan if it has one.

        Args:
            seed: of all that is drawn; that of the scenario if left out.
        """
        ...

    def step(self, commands: Mapping[int, SessionCommand] | None = None) -> Observation:
        """One control period.

        Args:
            commands: by index of the robot, each of one robot (no leading axis); robots that are
                left out go on with what they have. One that cannot be followed is refused: see
                `RobotStatus.refused`.

        Raises:
            ConfigError: a command for a robot that is not there.
        """
        ...

    def observe(self) -> Observation:
        """The scene as it is; nothing moves."""
        ...

    def check(self, robot: int, command: SessionCommand) -> None:
        """Refuse a command that the robot cannot follow from where it is.

        Raises:
            ConfigError: naming the robot, what of the command does not hold, and its value.
        """
        ...

    def resume_plan(self, robot: int) -> None:
        """Let a robot go on with its plan from where it is, joining it smoothly.

        Raises:
            ConfigError: it has none, or there is no way back to it.
        """
        ...

    def close(self) -> None:
        """Give back what the session holds; further calls raise RunError."""
        ...
