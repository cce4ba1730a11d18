"""PID on pose over PID on velocity: from a pose target to a wrench."""

from dataclasses import dataclass, field

import jax

from angler_mjx.control.commands import BodyWrench, Estimate, PoseTarget
from angler_mjx.control.laws import pid_pose, pid_velocity
from angler_mjx.control.laws.pid_pose import PidPoseCarry, PidPoseGains
from angler_mjx.control.laws.pid_velocity import PidVelocityCarry, PidVelocityGains
from angler_mjx.vehicles.params import VehicleParams


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class PidGains:
    """Gains of both loops."""

    pose: PidPoseGains = field(default_factory=PidPoseGains)
    velocity: PidVelocityGains = field(default_factory=PidVelocityGains)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class PidCarry:
    """Memory of both loops."""

    pose: PidPoseCarry
    velocity: PidVelocityCarry


def check(gains: PidGains) -> None:
    """Refuse gains that make no sense (host side).

    Raises:
        ConfigError: naming them.
    """
    pid_pose.check(gains.pose)
    pid_velocity.check(gains.velocity)


def reset(estimate: Estimate) -> PidCarry:
    """Memory of a robot that begins."""
    return PidCarry(pose=pid_pose.reset(estimate), velocity=pid_velocity.reset(estimate))


def step(
    gains: PidGains,
    vehicle: VehicleParams,
    carry: PidCarry,
    estimate: Estimate,
    command: PoseTarget,
    dt: float,
    density: float,
    gravity: float,
    realised: BodyWrench | None = None,
) -> tuple[PidCarry, BodyWrench]:
    """One control step of `pid_pose.step` and `pid_velocity.step`, with their arguments."""
    pose, twist = pid_pose.step(
        gains.pose, vehicle, carry.pose, estimate, command, dt, density, gravity
    )
    velocity, wrench = pid_velocity.step(
        gains.velocity, vehicle, carry.velocity, estimate, twist, dt, density, gravity, realised
    )
    return PidCarry(pose=pose, velocity=velocity), wrench
