"""Interface of sessions: a scene of robots that take commands and are observed.

A planner, a policy or a person uses a `Session` independently of its implementation. Commands are
latched: a robot follows the last one until it receives another. A command that a robot cannot
follow is refused for that robot alone, which then holds its position while the others continue.
"""

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from angler_mjx.robot.control.commands import (
    BodyWrench,
    Estimate,
    GripReading,
    ThrusterPwm,
)
from angler_mjx.robot.control.commands.joint_goal import JointGoal
from angler_mjx.robot.control.commands.whole_body import JointTarget
from angler_mjx.robot.control.stack import Command
from angler_mjx.sim.information import rename_warning
from angler_mjx.sim.state import Outcome

type Floats = NDArray[np.floating]

type SessionCommand = Command | JointGoal | JointTarget
"""Command of one robot, a JointTrajectory as a message, or a motion of its joints alone."""


@dataclass(frozen=True, kw_only=True)
class RobotInfo:
    """Facts of a robot before it moves."""

    name: str
    """Name as in topics and files: ``robot_0``, ``robot_1``, ..."""
    vehicle: str
    parameter_set: str
    radius_m: float
    """Radius of the sphere about its hull."""
    cruise_speed_mps: float
    max_speed_mps: Floats
    """[3] terminal speeds along the axes of F."""
    max_turn_radps: float = math.inf
    """Terminal rate of turning about z of F; infinite where unknown."""
    thrusters: tuple[str, ...]
    accepts: tuple[type, ...]
    """Accepted types of commands; `JointGoal` among them if JointTrajectory is, `JointTarget` if
    the robot has joints."""
    joints: tuple[str, ...] = ()
    """Names of the joints of its arm, in the order of the vehicle file; empty without an arm."""


@dataclass(frozen=True, kw_only=True)
class RobotStatus:
    """Status of a robot's command."""

    outcome: Outcome
    command: str
    """Name of the type that the robot follows; ``plan`` for the path of the reset."""
    refused: str = ""
    """Reason for the refusal of its last command, on which it holds its position; empty without
    refusal."""
    note: str = ""
    """What else its driver has to say: a mode, or how a JointTrajectory stands, beginning with the
    name of its `angler_mjx.robot.control.commands.joint_tolerance.ResultCode`."""


@dataclass(frozen=True, kw_only=True)
class SceneObstacles:
    """Obstacles at the robots' information level; [n] leads."""

    position_m: Floats
    """[n, 3] in W."""
    attitude: Floats
    """[n, 4] q."""
    kind: NDArray[np.integer]
    """[n] kind, as in `angler_mjx.world.obstacles.types`."""
    half_size_m: Floats
    """[n, 3] as `angler_mjx.sim.information.ObstacleInformation.half_size_m`."""

    @property
    def size_m(self) -> Floats:
        """Return [n, 3] `half_size_m` by its former name."""
        warnings.warn(rename_warning(type(self)), DeprecationWarning, stacklevel=2)
        return self.half_size_m


@dataclass(frozen=True, kw_only=True)
class SceneCargo:
    """Body that the robots hold together; [R] leads."""

    obstacle: int
    """Row of the body in `Observation.obstacles`."""
    held: NDArray[np.bool_]
    """[R] whether the robot holds it."""
    reading: GripReading
    """[R, 6] wrench and [R, 3] points, as laws receive them."""
    distance_m: Floats
    """[R] distance of the body from its goal, until the robot's episode ends."""
    angle_rad: Floats
    """[R] angle from its attitude at the goal, likewise."""


@dataclass(frozen=True, kw_only=True)
class Observation:
    """Scene at one time; arrays are numpy's, [R] leads."""

    time_s: float
    """Time since the reset, by the scene's own clock."""
    estimate: Estimate
    """Estimate of the controllers: p [R, 3], q [R, 4], nu [R, 6], joints [R, J] with NaN of a robot
    without an arm; None where no robot has one."""
    covariance: Floats | None
    """[R, 9, 9] covariance of position (W), attitude error and linear velocity (W), or its diagonal
    alone. None where the estimate is the truth."""
    truth: Estimate | None
    """True state, with joints as in ``estimate``; None where unknown."""
    pwm: ThrusterPwm
    """[R, n_thruster] signals of the last step."""
    demanded: BodyWrench | None
    """[R, 6] wrench demanded in that step; NaN where a robot's command was of a level below
    wrenches. None if the driver does not report it."""
    realised: BodyWrench | None
    """[R, 6] wrench that the thrusters settle at with those signals; None where unknown."""
    target_m: Floats | None = None
    """[R, 3] set-point of the position in that step, in W; the robot's own without one. None if the
    driver does not report it."""
    clearance_m: Floats | None
    """[R] from the hull to the nearest of cells, floor and obstacles; None where unknown. Exact up
    to a radius, and that radius beyond it."""
    obstacles: SceneObstacles | None
    cargo: SceneCargo | None = None
    """Body that the robots hold together; None where they hold nothing."""
    status: tuple[RobotStatus, ...]
    readings: Mapping[str, object] = field(default_factory=dict)
    """Latest readings of the instruments by name, [R] leading; empty without instruments."""


class Session(Protocol):
    """Scene that can be stepped."""

    @property
    def robots(self) -> Sequence[RobotInfo]:
        """Return the robots, in order."""
        ...

    @property
    def dt_s(self) -> float:
        """Return the control period, s."""
        ...

    def reset(self, seed: int | None = None) -> Observation:
        """Reset: every robot at its start, at rest, following its plan if it has one.

        Args:
            seed: seed of all samples; that of the scenario if left out.
        """
        ...

    def step(self, commands: Mapping[int, SessionCommand] | None = None) -> Observation:
        """Advance by one control period.

        Args:
            commands: commands by index of the robot, each of one robot (no leading axis); robots
                that are left out keep theirs. A command that cannot be followed is refused: see
                `RobotStatus.refused`.

        Raises:
            ConfigError: a command for a missing robot.
        """
        ...

    def observe(self) -> Observation:
        """Return the present scene without advancing it."""
        ...

    def check(self, robot: int, command: SessionCommand) -> None:
        """Refuse a command that the robot cannot follow from its position.

        Raises:
            ConfigError: the robot cannot follow the command; the message names the robot, the
                violated limit and the value.
        """
        ...

    def resume_plan(self, robot: int) -> None:
        """Resume a robot's plan from its position, joining it smoothly.

        Raises:
            ConfigError: the robot has no plan, or there is no free path back to it.
        """
        ...

    def close(self) -> None:
        """Release the session; further calls raise RunError."""
        ...
