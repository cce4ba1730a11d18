"""Clocks along the plans of a team: where each robot is to be now, and who has to wait."""

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp

from angler_mjx.planning.online.order import PassingOrder, Seen, limits
from angler_mjx.robot.control import plans
from angler_mjx.robot.control.commands import Estimate, PoseTarget
from angler_mjx.robot.control.laws import follow
from angler_mjx.robot.control.laws.follow import FollowCarry, FollowGains
from angler_mjx.robot.control.plans import Plan
from angler_mjx.world.acoustics.channel import HeardRobots

SLACK_M = 0.2
"""How far a robot may be from its place on the plan and still count as there; order keeps it free
beside the radii."""
PATIENCE_S = 5.0
"""Nobody waits longer for a robot that gets no further and does not wait for one that does."""
FURTHER_S = 0.5
"""Of its plan; who has come less far than this in all that time got no further."""
SILENCE_S = 60.0
"""Nobody waits longer for a robot that it has not heard since, where robots talk by acoustics."""
LEAST_SPEED_MPS = 0.05
"""Of a robot that is behind: slower cruise speeds count as this one."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class PlanStatus:
    """Since when robots [R] of a team get no further on their plans though they could."""

    passed_s: jax.Array
    """[R] how far each was on its plan when it was last seen to get on."""
    for_s: jax.Array
    """[R] since then."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class PlanProgress:
    """Of robots [R] along their plans: what they tell each other."""

    passed_s: jax.Array
    """[R] how far each is on its plan."""
    stands: jax.Array
    """bool [R] who is waited for no longer."""


@dataclass(frozen=True, kw_only=True)
class Heard:
    """What robots have heard of each other's `PlanProgress`, and when that is looked at."""

    others: HeardRobots
    """Its words are `PlanProgress`, [R, R] leading."""
    time_s: jax.Array
    """[] now."""

    def seen(self, own: PlanProgress, at_m: jax.Array, speed_mps: jax.Array) -> Seen:
        """What each takes the others for; what it knows of itself, [R], needs no packet."""
        others, said = self.others, self.others.words
        itself = jnp.eye(at_m.shape[0], dtype=bool)
        silent = self.time_s - others.time_s > SILENCE_S
        theirs_mps = jnp.sqrt(jnp.sum(others.v_mps**2, axis=-1))
        return Seen(
            clock_s=jnp.where(itself, own.passed_s, said.passed_s),
            stands=jnp.where(itself, own.stands, said.stands | silent),
            at_m=jnp.where(itself[..., None], at_m, others.place_m(self.time_s)),
            speed_mps=jnp.where(itself, speed_mps, theirs_mps),
        )


def moving(clock_s: jax.Array) -> PlanStatus:
    """Robots [R] so far along their plans, none of which stands yet."""
    return PlanStatus(passed_s=clock_s, for_s=jnp.zeros_like(clock_s))


def begun_anew(standing: PlanStatus, before_s: jax.Array, after_s: jax.Array) -> PlanStatus:
    """The same when clocks [R] are set from one time to another, as for new plans."""
    return replace(standing, passed_s=standing.passed_s + after_s - before_s)


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
    order: PassingOrder | None,
    cruise_mps: jax.Array,
    dt: float,
    standing: PlanStatus | None = None,
    heard: Heard | None = None,
) -> tuple[FollowCarry, PoseTarget, PlanStatus | None]:
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
        heard: what each knows of the others' progress; None: all of it.

    Returns:
        The memory, where each robot is to be, and who stands now. The heading turns at a limited
        rate.
    """
    after, target = jax.vmap(partial(follow.step, gains, dt=dt))(carry, estimate, plan)
    if order is None:
        return after, target, standing
    passed = passed_s(carry, estimate, plan, cruise_mps)
    stands = None if standing is None else standing.for_s > PATIENCE_S
    speed = jnp.sqrt(jnp.sum(estimate.nu[:, :3] ** 2, axis=-1))
    seen_now = None
    if heard is not None:
        seen_now = heard.seen(progress(passed, standing), estimate.p, speed)
    most, barred = limits(order, passed, stands, estimate.p, speed, seen_now)
    clock = jnp.minimum(after.clock_s, jnp.maximum(carry.clock_s, most))
    held = clock < after.clock_s
    target = replace(target, velocity_mps=jnp.where(held[:, None], 0.0, target.velocity_mps))
    if standing is not None:
        standing = seen(standing, passed, held & ~barred, dt)
    return replace(after, clock_s=clock), target, standing


def passed_s(
    carry: FollowCarry, estimate: Estimate, plan: Plan, cruise_mps: jax.Array
) -> jax.Array:
    """How far robots [R] are on their plans, by where they are told to be; arguments of `step`."""
    here = jax.vmap(plans.place)(plan, carry.clock_s)
    behind = jnp.maximum(jnp.sqrt(jnp.sum((here - estimate.p) ** 2, axis=-1)) - SLACK_M, 0.0)
    return carry.clock_s - behind / jnp.maximum(cruise_mps, LEAST_SPEED_MPS)


def progress(passed: jax.Array, standing: PlanStatus | None) -> PlanProgress:
    """What robots so far along [R] tell each other."""
    nobody = jnp.zeros_like(passed, bool)
    stands = nobody if standing is None else standing.for_s > PATIENCE_S
    return PlanProgress(passed_s=passed, stands=stands)


def seen(standing: PlanStatus, passed_s: jax.Array, waits: jax.Array, dt: float) -> PlanStatus:
    """Who stands one control step later; ``waits`` [R] for others who get on."""
    gets_on = waits | (passed_s > standing.passed_s + FURTHER_S)
    return PlanStatus(
        passed_s=jnp.where(gets_on, passed_s, standing.passed_s),
        for_s=jnp.where(gets_on, 0.0, standing.for_s + dt),
    )
