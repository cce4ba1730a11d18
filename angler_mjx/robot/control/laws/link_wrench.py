"""Feed-forward of the wrench that an arm exerts on its base.

The links weigh, drag, and are accelerated by their servos; laws for the base know nothing of it.
This law adds the opposite of that wrench at the estimated state (computed-torque coupling of
vehicle and manipulator: McLain, Rock and Lee 1996; Schjolberg and Fossen 1994).
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_kernels import rigid_body
from angler_mjx.robot.control.commands import BodyWrench, Estimate
from angler_mjx.robot.control.commands.whole_body import JointTarget
from angler_mjx.robot.control.laws.checks import check_gains
from angler_mjx.robot.vehicles import link_motion
from angler_mjx.robot.vehicles.link_motion import JointMotion
from angler_mjx.robot.vehicles.link_params import LinkParams
from angler_mjx.robot.vehicles.params import VehicleParams


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class LinkWrenchGains:
    """Fractions of the wrench that are fed forward."""

    present: float = 1.0
    """Fraction of weight, buoyancy, drag and Coriolis terms of the links."""
    acceleration: float = 1.0
    """Fraction of what the links' accelerations by their servos take."""


def check(gains: LinkWrenchGains) -> None:
    """Refuse gains that make no sense (host side).

    Raises:
        ConfigError: naming them.
    """
    check_gains("link_wrench", gains)


def step(
    gains: LinkWrenchGains,
    vehicle: VehicleParams,
    estimate: Estimate,
    target: JointTarget | None,
    command: BodyWrench,
    dt: float,
    density: float,
    gravity: float,
) -> BodyWrench:
    """One control step.

    tau = tau_base - (wrench of the links at the present state) - (moment of the trim) + M_bj q''_j,
    with the joints' accelerations q''_j that bring their speeds to those that the servos ask for at
    the end of the control period. The trim is the offset of the base's centre of buoyancy along x
    and y, by which a file balances the arm.

    Args:
        gains: of the law.
        vehicle: of one robot; without links the command is returned.
        estimate: state as known to the controller.
        target: that the joints follow.
        command: wrench for the base alone.
        dt: control period, s.
        density: of the water, kg/m^3.
        gravity: m/s^2.
    """
    joints, links = estimate.joints, vehicle.links
    if links is None or joints is None or target is None:
        return command
    inertia, force = _coupling(links, joints, estimate, density, gravity)
    wanted = servo_speed(links, joints, target) + dt * target.acceleration
    acceleration = (wanted - joints.velocity) / dt
    moved = rigid_body.matrix_times(inertia[:6, 6:], acceleration)
    lift = density * gravity * vehicle.volume_m3
    trim = rigid_body.buoyancy_wrench(estimate.q, lift, vehicle.p_cb_m.at[2].set(0.0))
    present = force[:6] + trim.at[:3].set(0.0)
    return BodyWrench(tau=command.tau - gains.present * present + gains.acceleration * moved)


def servo_speed(links: LinkParams, joints: JointMotion, target: JointTarget) -> jax.Array:
    """Return the speeds [J] that servos ask for to follow a target."""
    has_servo = links.damping > 0
    rate = links.stiffness / jnp.where(has_servo, links.damping, 1.0)
    wanted = rate * (target.position - joints.position) + target.velocity
    return jnp.where(has_servo, jnp.clip(wanted, -links.max_speed, links.max_speed), 0.0)


def _coupling(
    links: LinkParams, joints: JointMotion, estimate: Estimate, density: float, gravity: float
) -> tuple[jax.Array, jax.Array]:
    """Return what links add to the inertia [n, n] and the force [n], with their drag."""
    q, z = estimate.q, estimate.p[2]
    still = jnp.zeros_like(estimate.p)
    flow = still if estimate.flow is None else estimate.flow
    motion = link_motion.move_links(links, joints, estimate.nu)
    inertia, wrench = link_motion.inertia_and_wrench(
        links, motion, z, q, flow, still, density, gravity
    )
    nu_r = link_motion.relative_velocity(motion, q, flow)
    wrench = wrench + link_motion.drag_wrench(links, nu_r, density)
    return link_motion.join_bodies(motion, inertia), link_motion.join_wrenches(motion, wrench)
