"""Leader and followers: one robot flies the plan, the others go where the body pulls them.

A follower knows neither the plan nor what the leader is commanded. It measures the wrench of its
grip, and estimates from it the velocity at which the leader moves the body: a virtual mass that the
force beyond the robot's part of the load accelerates, and a virtual damper beside it. At constant
velocity no force is needed. The grip is rigid, so a follower's attitude is the body's: where the
leader has gone up or down, the follower sees how far the body's centre is off level and goes after
it, and the damper alone gives way to vertical forces. In the manner of K. Kosuge and T. Oosumi,
"Decentralized control of multiple robots handling an object", IEEE/RSJ International Conference on
Intelligent Robots and Systems (1996), whose followers estimate the leader's motion from the force
at their grips.

Followers keep themselves level.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.commands import BodyTwist, Estimate
from angler_mjx.robot.control.laws import model
from angler_mjx.robot.control.laws.cargo_part import CargoPartGains, find_excess, require_grip
from angler_mjx.robot.control.laws.checks import check_gains
from angler_mjx.robot.vehicles.params import VehicleParams


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class LeaderFollowerGains(CargoPartGains):
    """Virtual mass and damper of a follower."""

    mass_kg: float = 100.0
    """Mass that the measured force accelerates."""
    damping_ns_per_m: float = 200.0
    """Force over the velocity that it adds at once."""
    inertia_kgm2: float = 10.0
    """The same about the vertical: inertia."""
    damping_nms_per_rad: float = 40.0
    """The same about the vertical: damper."""
    level_per_s: float = 2.0
    """Vertical velocity of a follower per metre that the body's centre is off level."""
    attitude_per_s: float = 2.5
    """Angular velocity of a follower per radian off level."""
    turn_gain: float = 20.0
    """Factor of the leader's error of turn rate: it turns the body and the followers with it."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class LeaderFollowerCarry:
    """Velocity of the leader's motion as a follower estimates it."""

    velocity_mps: jax.Array
    """[3] over ground, in W; vertically 0."""
    yaw_rate_radps: jax.Array
    """[] about z up."""


def check(gains: LeaderFollowerGains) -> None:
    """Refuse gains that make no sense (host side).

    Raises:
        ConfigError: naming them.
    """
    positive = ("mass_kg", "damping_ns_per_m", "inertia_kgm2", "damping_nms_per_rad")
    check_gains("leader_follower", gains, positive=positive)


def reset(estimate: Estimate) -> LeaderFollowerCarry:
    """Return the memory of a robot that begins: the leader is at rest."""
    zero = jnp.zeros_like(estimate.p)
    return LeaderFollowerCarry(velocity_mps=zero, yaw_rate_radps=zero[0])


def step(
    gains: LeaderFollowerGains,
    vehicle: VehicleParams,
    is_leader: jax.Array | None,
    carry: LeaderFollowerCarry,
    estimate: Estimate,
    command: BodyTwist,
    dt: float,
) -> tuple[LeaderFollowerCarry, BodyTwist]:
    """One control step.

    M v_e' = f and v = v_e + f / D with f the measured force beyond the robot's part of the load, in
    W; the same of the turn about the vertical. Vertically v = f / D + k h with h the height of the
    body's centre above where it is when the robot is level. v is bounded as by other laws.

    Args:
        gains: of the law.
        vehicle: of one robot.
        is_leader: bool [] whether it leads; a leader passes its command on.
        carry: memory.
        estimate: state as known to the controller, with the wrench of its grip and the current.
        command: the velocity over ground to have, of a leader; a follower does not read it.
        dt: control period, s.

    Raises:
        ConfigError: the robots hold nothing, or none of them leads.
    """
    if is_leader is None:
        raise ConfigError("stage leader_follower: no robot leads; set controller.leader")
    grip = require_grip("leader_follower", estimate)
    # A follower whose grip is open stays where it is.
    follows = (jnp.sum(jnp.abs(grip.wrench)) > 0.0).astype(estimate.p.dtype)
    excess = find_excess("leader_follower", gains, estimate)
    force = quaternion.rotate(estimate.q, excess[:3])
    up = quaternion.world_up(estimate.q)
    moment = jnp.sum(up * excess[3:])
    limit = model.speed_limit(vehicle)
    height = follows * (jnp.sum(up * grip.center_m) - grip.center_m[2])
    zero = jnp.zeros_like(height)
    level = jnp.stack([zero, zero, gains.level_per_s * height])
    horizontal = jnp.stack([force[0], force[1], zero])
    leading = follows * carry.velocity_mps + (dt / gains.mass_kg) * horizontal
    leading = model.limit_norm(leading, limit)
    turning = follows * carry.yaw_rate_radps + (dt / gains.inertia_kgm2) * moment
    velocity = model.limit_norm(leading + force / gains.damping_ns_per_m + level, limit)
    tilt = model.attitude_error(estimate.q, quaternion.yaw(estimate.q))
    turn = (turning + moment / gains.damping_nms_per_rad) * up
    following = jnp.concatenate(
        [quaternion.rotate_inverse(estimate.q, velocity), turn + gains.attitude_per_s * tilt]
    )
    error = jnp.sum(up * (command.nu[3:] - estimate.nu[3:]))
    wanted = jnp.concatenate(
        [command.nu[:3], command.nu[3:] + (gains.turn_gain - 1.0) * error * up]
    )
    after = LeaderFollowerCarry(velocity_mps=leading, yaw_rate_radps=turning)
    return after, BodyTwist(nu=jnp.where(is_leader, wanted, following))
