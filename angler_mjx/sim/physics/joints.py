"""Efforts on the joints of one vehicle: servo, friction and hard stops, implicit over a step.

A servo holds a reference by position and speed, within the speed and the effort of its motor:

    v = clip(stiffness / damping (position error) + reference speed, +- max_speed)
    effort = clip(damping (v - speed), +- max_effort)

Inside its limits this is stiffness (position error) + damping (speed error). Friction is viscous
and Coulomb's. A stop is a stiff one-sided spring with a damper: the motor's full effort pushes a
joint by `STOP_FRACTION` of its range into it.

Over a step, v is that of the middle, from the present speed; a servo closes no error faster than
within a step. Speeds act by a weighted mean of beginning and end (`end_weight`), stops and
Coulomb's friction at the end. The end is found by iterations that decide in turn which motors are
at their limits and which stops are met: a light joint with a strong motor leaves no room for a
wrong guess.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx.robot.vehicles.link_motion import JointMotion
from angler_mjx.robot.vehicles.link_params import LinkParams

STOP_FRACTION = 0.01
STOP_TIME_S = 0.02
"""Damping of a stop over its stiffness, s."""
STICKING = 1e4
"""Damper of a sticking joint over that which halves its speed in a step."""


@dataclass(frozen=True, kw_only=True)
class Effort:
    """Mean effort on each joint [J] over a step, and how it falls with the change of speed."""

    effort: jax.Array
    """[J] N m or N."""
    by_change: jax.Array
    """[J] minus its derivative by the change of speed over the step, >= 0."""


def home(links: LinkParams) -> JointMotion:
    """Return the joints at rest in the home posture of the vehicle file."""
    return JointMotion(position=links.home, velocity=jnp.zeros_like(links.home))


def at_end(joints: JointMotion, change: jax.Array, dt: jax.Array | float) -> JointMotion:
    """Return joints after a step in which their speeds change by ``change`` [J]."""
    velocity = joints.velocity + change
    position = joints.position + (0.5 * dt) * (joints.velocity + velocity)
    return JointMotion(position=position, velocity=velocity)


def end_weight(by_speed: jax.Array, inertia: jax.Array, dt: jax.Array | float) -> jax.Array:
    """Return the weight [J] of the end of a step of ``dt`` [] s in the mean of a speed.

    1/2, the trapezoidal rule, for slow joints, and 1 for stiff ones: (x + 3) / (x + 6) with x the
    step over the time in which an effort that falls with speed by ``by_speed`` [J] stops an
    ``inertia`` [J]. The speed then decays by (6 - 2 x) / (6 + 4 x + x^2), the Pade approximant of
    exp(-x) of degrees 1 and 2, and does not ring.
    """
    x = dt * by_speed / inertia
    return (x + 3.0) / (x + 6.0)


def wanted_speed(
    links: LinkParams, reference: JointMotion, joints: JointMotion, dt: jax.Array | float
) -> jax.Array:
    """Return the speed [J] that each servo asks for over a step, rad/s or m/s.

    Args:
        links: of the vehicle.
        reference: at the beginning of the step; it moves on with its speed.
        joints: at the beginning.
        dt: [] s.
    """
    rate = links.stiffness / jnp.where(links.damping > 0, links.damping, 1.0)
    error = reference.position - joints.position
    error = error + 0.5 * dt * (reference.velocity - joints.velocity)
    wanted = jnp.minimum(rate, 1.0 / dt) * error + reference.velocity
    return jnp.clip(wanted, -links.max_speed, links.max_speed)


@dataclass(frozen=True, kw_only=True)
class Motors:
    """Servos and viscous friction of the joints [J] in a step."""

    links: LinkParams
    wanted: jax.Array
    """[J] speed that each servo asks for."""
    begin: jax.Array
    """[J] speed at the beginning."""
    weight: jax.Array
    """[J] weight of the speed at the end in that which acts."""

    def servo_effort(self, change: jax.Array) -> jax.Array:
        """Return the efforts [J] of unlimited servos where the speeds change by ``change`` [J]."""
        return self.links.damping * (self.wanted - self.begin - self.weight * change)

    def effort(self, change: jax.Array, unlimited: jax.Array | None) -> Effort:
        """Return the efforts where the speeds change by ``change`` [J].

        Args:
            change: [J] of the speeds.
            unlimited: [J] efforts of unlimited servos that decide which motors are at their limits;
                None: the motors have no limits.
        """
        links, speed = self.links, self.begin + self.weight * change
        effort, slope = self.servo_effort(change), links.damping
        if unlimited is not None:
            saturated = jnp.abs(unlimited) > links.max_effort
            effort = jnp.where(saturated, jnp.sign(unlimited) * links.max_effort, effort)
            slope = jnp.where(saturated, 0.0, slope)
        return Effort(
            effort=effort - links.viscous_friction * speed,
            by_change=self.weight * (slope + links.viscous_friction),
        )


@dataclass(frozen=True, kw_only=True)
class JointContact:
    """What stops and Coulomb's friction do with each joint [J] in a step."""

    stiffness: jax.Array
    """[J] stiffness of the stop that the joint meets; 0 where it meets none."""
    stop: jax.Array
    """[J] position of that stop, rad or m."""
    inwards: jax.Array
    """[J] sign of the effort of that stop."""
    damper: jax.Array
    """[J] damper that holds a sticking joint; 0 of one that slides."""
    sliding: jax.Array
    """[J] effort of the friction on a sliding joint; 0 of one that sticks."""


def find_contact(
    links: LinkParams, free_end: JointMotion, inertia: jax.Array, dt: jax.Array | float
) -> JointContact:
    """Return which stops the joints meet in a step, and which joints friction can stop.

    Args:
        links: of the vehicle.
        free_end: the joints at the end of the step without stops and friction.
        inertia: [J] of each joint with all else that resists a change of its speed.
        dt: [] s.
    """
    below, above = free_end.position < links.lower, free_end.position > links.upper
    stiffness = links.max_effort / (STOP_FRACTION * (links.upper - links.lower))
    needed, speed = inertia / dt, free_end.velocity
    sticks = needed * jnp.abs(speed) < links.coulomb_friction
    return JointContact(
        stiffness=jnp.where(below | above, stiffness, 0.0),
        stop=jnp.where(below, links.lower, links.upper),
        inwards=jnp.where(below, 1.0, -1.0).astype(speed.dtype),
        damper=jnp.where(sticks, STICKING * needed, 0.0),
        sliding=jnp.where(sticks, 0.0, -jnp.sign(speed) * links.coulomb_friction),
    )


def stop_acts(joints: JointMotion, contact: JointContact) -> jax.Array:
    """Return bool [J]: whether a stop that is met pushes the joint inwards."""
    return _push(joints, contact) * contact.inwards > 0


def contact_effort(
    joints: JointMotion, contact: JointContact, acts: jax.Array | None, dt: jax.Array | float
) -> Effort:
    """Return the efforts of stops and of Coulomb's friction at the end of a step.

    Args:
        joints: at the end.
        contact: of the step.
        acts: bool [J] whether a stop that is met acts; None: all do, if they pull too.
        dt: [] s.
    """
    acts = jnp.ones(contact.stop.shape, bool) if acts is None else acts
    stiffness = jnp.where(acts, contact.stiffness, 0.0)
    return Effort(
        effort=jnp.where(acts, _push(joints, contact), 0.0)
        + contact.sliding
        - contact.damper * joints.velocity,
        by_change=(STOP_TIME_S + 0.5 * dt) * stiffness + contact.damper,
    )


def _push(joints: JointMotion, contact: JointContact) -> jax.Array:
    depth = joints.position - contact.stop
    return -contact.stiffness * (depth + STOP_TIME_S * joints.velocity)
