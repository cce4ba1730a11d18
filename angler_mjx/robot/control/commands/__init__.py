"""Commands of one robot, from a pose down to the thrusters."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx.robot.vehicles.link_motion import JointMotion


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class GripReading:
    """What a robot measures of the body that it holds."""

    wrench: jax.Array
    """[6] of the body on the robot at its centre of mass, N and N m, in F: what a force-torque
    sensor measures, as mean of the control period before. 0 at the start and without a hold."""
    center_m: jax.Array
    """[3] centre of the body from the robot's centre of mass, m, in F."""
    lever_m: jax.Array
    """[3] point of the grip from there, m, in F: the end effector, or, of a robot that holds the
    body by its hull, the point below or above its centre at the height of the body."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Estimate:
    """Estimate of the pose and velocity of a robot."""

    p: jax.Array
    """[3] m in W."""
    q: jax.Array
    """[4] attitude, F to W."""
    nu: jax.Array
    """[6] velocity over ground, m/s and rad/s, in F."""
    flow: jax.Array | None = None
    """[3] velocity of the water there, m/s, in W; None where no stage of the controller uses it."""
    joints: JointMotion | None = None
    """[J] motion of the joints, which their encoders measure; None of a vehicle without joints."""
    grip: GripReading | None = None
    """Measured by the robot's grip; None where robots hold nothing."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class PoseTarget:
    """A pose to be at, level, with the velocity that the target itself has."""

    position_m: jax.Array
    """[3] in W."""
    velocity_mps: jax.Array
    """[3] in W."""
    yaw_rad: jax.Array
    """[] heading about z up, 0 = east."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class TrackingTarget:
    """A moving pose, level, with what it takes to feed its motion forward."""

    position_m: jax.Array
    """[3] in W."""
    velocity_mps: jax.Array
    """[3] in W."""
    acceleration_mps2: jax.Array
    """[3] in W."""
    yaw_rad: jax.Array
    """[] heading about z up, 0 = east."""
    yaw_rate_radps: jax.Array
    """[] about z up."""
    yaw_acceleration_radps2: jax.Array
    """[] about z up."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class BodyTwist:
    """A velocity over ground to have: nu [6], m/s and rad/s, in F."""

    nu: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class BodyWrench:
    """A wrench for the thrusters to exert: tau [6], N and N m, at the centre of mass, in F."""

    tau: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class ThrusterPwm:
    """The signal of each thruster: pwm_us [n_thruster], 1100 to 1900, 1500 neutral."""

    pwm_us: jax.Array


def as_tracking(target: PoseTarget | TrackingTarget) -> TrackingTarget:
    """The same target; a pose target moves on with its velocity and does not turn."""
    if isinstance(target, TrackingTarget):
        return target
    still = jnp.zeros_like(target.yaw_rad)
    return TrackingTarget(
        position_m=target.position_m,
        velocity_mps=target.velocity_mps,
        acceleration_mps2=jnp.zeros_like(target.velocity_mps),
        yaw_rad=target.yaw_rad,
        yaw_rate_radps=still,
        yaw_acceleration_radps2=still,
    )
