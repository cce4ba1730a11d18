"""Clocks along the plans of a team: where each robot is to be now, and who has to wait."""

from dataclasses import dataclass, replace
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
PATIENCE_S = 15.0
"""Nobody waits longer for a robot that is behind and stands, though nobody holds it."""
MOVES_M = 0.25
"""Who is within this of where it was stands."""
LEAST_SPEED_MPS = 0.05
"""Of a robot that is behind: slower cruise speeds count as this one."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Standing:
    """Since when robots [R] of a team have not moved on though they could."""

    at_m: jax.Array
    """[R, 3] where they were last seen to move."""
    for_s: jax.Array
    """[R] since then."""


def moving(p: jax.Array) -> Standing:
    """Robots at p [R, 3], none of which stands yet."""
    return Standing(at_m=p, for_s=jnp.zeros(p.shape[:1], p.dtype))


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
    standing: Standing | None = None,
) -> tuple[FollowCarry, PoseTarget, Standing | None]:
    """One control step of a team; [R] leads.

    Args:
        gains: of the guidance.
        carry: clocks and headings.
        estimate: the robots as they are told of themselves.
        plan: theirs.
        order: who passes first; None: each flies by its own clock.
        cruise_mps: [R] for how late a robot is that is behind its place.
        dt: control period, s.
        standing: who is waited for no longer; None: all are waited for.

    Returns:
        The memory, where each robot is to be, and who stands now. The heading turns at a limited
        rate.
    """
    after, target = jax.vmap(partial(follow.step, gains, dt=dt))(carry, estimate, plan)
    if order is None:
        return after, target, standing
    here = jax.vmap(plans.place)(plan, carry.clock_s)
    behind = jnp.maximum(jnp.sqrt(jnp.sum((here - estimate.p) ** 2, axis=-1)) - SLACK_M, 0.0)
    passed = carry.clock_s - behind / jnp.maximum(cruise_mps, LEAST_SPEED_MPS)
    stands = None if standing is None else standing.for_s > PATIENCE_S
    most = jnp.maximum(carry.clock_s, limits(order, passed, stands, estimate.p))
    clock = jnp.minimum(after.clock_s, most)
    held = clock < after.clock_s
    target = replace(target, velocity_mps=jnp.where(held[:, None], 0.0, target.velocity_mps))
    if standing is not None:
        standing = _seen(standing, estimate.p, held | (behind == 0.0), dt)
    return replace(after, clock_s=clock), target, standing


def _seen(standing: Standing, p: jax.Array, may_stand: jax.Array, dt: float) -> Standing:
    """Who stands one control step later; ``may_stand`` [R] who is held, or where it is to be."""
    off = jnp.sqrt(jnp.sum((p - standing.at_m) ** 2, axis=-1))
    moves = may_stand | (off > MOVES_M)
    return Standing(
        at_m=jnp.where(moves[:, None], p, standing.at_m),
        for_s=jnp.where(moves, 0.0, standing.for_s + dt),
    )
