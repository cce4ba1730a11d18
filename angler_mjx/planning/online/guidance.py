"""Clocks along the plans of a team: where each robot is to be now, and who has to wait."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp

from angler_mjx.control import plans
from angler_mjx.control.commands import Estimate, PoseTarget
from angler_mjx.control.laws import follow
from angler_mjx.control.laws.follow import FollowCarry, FollowGains
from angler_mjx.control.plans import Plan
from angler_mjx.planning.online.order import Order, limits

SLACK_M = 0.2
"""How far a robot may be from its place on the plan and still count as there; order keeps it free
beside the radii."""
LEAST_SPEED_MPS = 0.05
"""Of a robot that is behind: slower cruise speeds count as this one."""


def begin(q: jax.Array) -> FollowCarry:
    """Clocks at 0 for robots [R] with attitudes q [R, 4]."""
    w, x, y, z = jnp.moveaxis(q, -1, 0)
    yaw = jnp.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return jax.vmap(follow.reset)(yaw)


def reach_m(radius_m: jax.Array) -> jax.Array:
    """[R, R] distance of centres below which two robots are in each other's way."""
    return radius_m[:, None] + radius_m + 2 * SLACK_M


def step(
    gains: FollowGains,
    carry: FollowCarry,
    estimate: Estimate,
    plan: Plan,
    order: Order | None,
    cruise_mps: jax.Array,
    dt: float,
) -> tuple[FollowCarry, PoseTarget]:
    """One control step of a team; [R] leads.

    Args:
        gains: of the guidance.
        carry: clocks and headings.
        estimate: the robots as they are told of themselves.
        plan: theirs.
        order: who passes first; None: each flies by its own clock.
        cruise_mps: [R] for how late a robot is that is behind its place.
        dt: control period, s.

    Returns:
        The memory, and where each robot is to be. The heading turns at a limited rate.
    """
    after, target = jax.vmap(partial(follow.step, gains, dt=dt))(carry, estimate, plan)
    if order is None:
        return after, target
    here = jax.vmap(plans.place)(plan, carry.clock_s)
    behind = jnp.maximum(jnp.sqrt(jnp.sum((here - estimate.p) ** 2, axis=-1)) - SLACK_M, 0.0)
    passed = carry.clock_s - behind / jnp.maximum(cruise_mps, LEAST_SPEED_MPS)
    most = jnp.maximum(carry.clock_s, limits(order, passed))
    clock = jnp.minimum(after.clock_s, most)
    held = (clock < after.clock_s)[:, None]
    target = replace(target, velocity_mps=jnp.where(held, 0.0, target.velocity_mps))
    return replace(after, clock_s=clock), target
