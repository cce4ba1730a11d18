"""Common parts of the session checks: tolerances, failures, and functions to drive a robot."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.host_arrays import as_leaf
from angler_mjx.robot.control.commands import BodyTwist, PoseTarget
from angler_mjx.runs.session.interface import Floats, Observation, Session, SessionCommand


class NonConformanceError(AssertionError):
    """Error for a session that violates the interface."""


class Skipped(Exception):  # noqa: N818, it is no error
    """Skip of a check without meaning for a session: an unsupported command, a fleet of one."""


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """Limits of the session checks; the defaults are those of the simulator in calm water."""

    robot: int = 0
    """Index of the driven robot. It needs free water of 1.5 m around its start."""
    repeat_m: float = 0.0
    """Max difference of two runs of one seed: zero in a simulator."""
    clock_s: float = 1e-6
    """Max time error after a step."""
    settle_s: float = 20.0
    """Time for a pose to be reached."""
    speed_mps: float = 0.2
    """Speed of a driven robot."""
    velocity_mps: float = 0.06
    """Max error of a held velocity; rad/s for turning."""
    pose_m: float = 0.1
    """Max error of a reached pose; m, and rad of heading."""
    hold_m: float = 0.3
    """Max drift of a robot that stops from ``speed_mps`` and holds."""
    track_m: float = 0.35
    """Max distance of a robot from its JointTrajectory in flight."""
    jump_m: float = 0.02
    """Max step of the target beyond its speed."""
    jolt_mps: float = 0.1
    """Max velocity change in one step in the first second of a new course."""


def require(holds: bool | np.bool_, message: str) -> None:
    """Raise NonConformanceError unless a condition holds."""
    if not holds:
        raise NonConformanceError(message)


def require_accepts(session: Session, robot: int, kind: type) -> None:
    """Skip a check whose command type a robot does not accept."""
    if kind not in session.robots[robot].accepts:
        raise Skipped(f"{session.robots[robot].name} takes no {kind.__name__}")


def run_steps(
    session: Session, seconds: float, commands: Mapping[int, SessionCommand] | None = None
) -> list[Observation]:
    """Run steps for a time; commands are given once, at the start.

    Returns:
        The observation after each step.
    """
    steps = max(1, round(seconds / session.dt_s))
    return [session.step(commands), *(session.step() for _ in range(steps - 1))]


def refusal_reason(session: Session, robot: int, order: SessionCommand) -> str:
    """Return the reason why `Session.check` refuses an order; empty if it does not."""
    try:
        session.check(robot, order)
    except ConfigError as error:
        return str(error)
    return ""


def position(observation: Observation, robot: int) -> Floats:
    """Return the estimated position [3] m, in W."""
    p: Floats = np.asarray(observation.estimate.p, float)[robot]
    return p


def velocity(observation: Observation, robot: int) -> Floats:
    """Return the estimated velocity [6] nu, in F."""
    nu: Floats = np.asarray(observation.estimate.nu, float)[robot]
    return nu


def heading(observation: Observation, robot: int) -> float:
    """Return the estimated heading, rad about z up, 0 = east."""
    w, x, y, z = np.asarray(observation.estimate.q, float)[robot]
    return float(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


def heading_difference(a: float, b: float) -> float:
    """Return the angle between two headings, at least 0."""
    return float(abs((a - b + np.pi) % (2 * np.pi) - np.pi))


def make_twist(*parts: float) -> BodyTwist:
    """Return a twist of six numbers."""
    return BodyTwist(nu=as_leaf(np.array(parts)))


def make_pose(p: Floats, yaw_rad: float) -> PoseTarget:
    """Return a pose at rest."""
    position_m = as_leaf(np.asarray(p))
    yaw = as_leaf(np.asarray(yaw_rad))
    return PoseTarget(position_m=position_m, velocity_mps=0.0 * position_m, yaw_rad=yaw)
