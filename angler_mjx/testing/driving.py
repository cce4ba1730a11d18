"""What the checks of a session share: tolerances, failures, and ways to drive a robot."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.commands import BodyTwist, PoseTarget
from angler_mjx.runs.session.interface import Floats, Observation, Session, SessionCommand


class NonConformanceError(AssertionError):
    """A session does not do what every session must."""


class Skipped(Exception):  # noqa: N818, it is no error
    """A check has no meaning for a session: a command that no robot takes, a fleet of one."""


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """How well a session must do; the defaults are those of the simulator in calm water."""

    robot: int = 0
    """The one that is driven. It needs free water of 1.5 m around its start."""
    repeat_m: float = 0.0
    """How far two runs of one seed may differ: nothing, in a simulator."""
    clock_s: float = 1e-6
    """How far time may be off after a step."""
    settle_s: float = 20.0
    """For a pose to be reached."""
    speed_mps: float = 0.2
    """That a robot is driven at."""
    velocity_mps: float = 0.06
    """How far a velocity that is held may be off; rad/s for turning."""
    pose_m: float = 0.1
    """How near a pose is reached; m, and rad of heading."""
    hold_m: float = 0.3
    """How far from where it was a robot may be carried that stops from ``speed_mps`` and holds."""
    track_m: float = 0.35
    """How far a robot may be from its JointTrajectory on the way."""
    jump_m: float = 0.02
    """How far the place aimed at may move in a step beside what speed explains."""
    jolt_mps: float = 0.1
    """How much a velocity may change in one step in the first second of a new course."""


def require(holds: bool | np.bool_, message: str) -> None:
    """Raise NonConformanceError unless something holds."""
    if not holds:
        raise NonConformanceError(message)


def require_accepts(session: Session, robot: int, kind: type) -> None:
    """Skip a check whose command a robot does not take."""
    if kind not in session.robots[robot].accepts:
        raise Skipped(f"{session.robots[robot].name} takes no {kind.__name__}")


def run_steps(
    session: Session, seconds: float, commands: Mapping[int, SessionCommand] | None = None
) -> list[Observation]:
    """Step for a while; commands are given once, at the beginning.

    Returns:
        What was observed after each step.
    """
    steps = max(1, round(seconds / session.dt_s))
    return [session.step(commands), *(session.step() for _ in range(steps - 1))]


def refusal_reason(session: Session, robot: int, order: Any) -> str:
    """Why `Session.check` refuses an order; empty if it does not."""
    try:
        session.check(robot, order)
    except ConfigError as error:
        return str(error)
    return ""


def position(observation: Observation, robot: int) -> Floats:
    """[3] m, in W, as estimated."""
    p: Floats = np.asarray(observation.estimate.p, float)[robot]
    return p


def velocity(observation: Observation, robot: int) -> Floats:
    """[6] nu, in F, as estimated."""
    nu: Floats = np.asarray(observation.estimate.nu, float)[robot]
    return nu


def heading(observation: Observation, robot: int) -> float:
    """Rad about z up, 0 = east."""
    w, x, y, z = np.asarray(observation.estimate.q, float)[robot]
    return float(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


def heading_difference(a: float, b: float) -> float:
    """Angle between two headings, at least 0."""
    return float(abs((a - b + np.pi) % (2 * np.pi) - np.pi))


def make_twist(*parts: float) -> BodyTwist:
    """A twist of six numbers."""
    nu: Any = np.array(parts)
    return BodyTwist(nu=nu)


def make_pose(p: Floats, yaw_rad: float) -> PoseTarget:
    """A pose at rest."""
    position_m: Any = np.asarray(p)
    yaw: Any = np.asarray(yaw_rad)
    return PoseTarget(position_m=position_m, velocity_mps=0.0 * position_m, yaw_rad=yaw)
