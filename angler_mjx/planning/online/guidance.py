"""Clocks along the plans of a team: target of each robot, and waits."""

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp

from angler_mjx.planning.online.order import ObservedTeam, PassingOrder, clock_limits
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
"""Limit [s] of a wait for a robot that makes no progress and waits for none that does."""
MIN_PROGRESS_S = 0.5
"""Progress [s] along a plan below which a robot made none in that time."""
SILENCE_S = 60.0
"""Limit [s] of a wait for a robot that sent no packet since, with acoustics."""
MIN_SPEED_MPS = 0.05
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
    """Progress of robots [R] along their plans, as they send it to each other."""

    passed_s: jax.Array
    """[R] how far each is on its plan."""
    stands: jax.Array
    """bool [R] robots for which others no longer wait."""


@dataclass(frozen=True, kw_only=True)
class HeardProgress:
    """Received `PlanProgress` of other robots, and the present time."""

    others: HeardRobots
    """Its words are `PlanProgress`, [R, R] leading."""
    time_s: jax.Array
    """[] now."""

    def observe_team(
        self, progress: PlanProgress, at_m: jax.Array, speed_mps: jax.Array
    ) -> ObservedTeam:
        """Return each robot's picture of the others; that of itself, [R], needs no packet."""
        others, heard = self.others, self.others.payload
        is_self = jnp.eye(at_m.shape[0], dtype=bool)
        is_silent = self.time_s - others.time_s > SILENCE_S
        others_mps = jnp.sqrt(jnp.sum(others.v_mps**2, axis=-1))
        return ObservedTeam(
            clock_s=jnp.where(is_self, progress.passed_s, heard.passed_s),
            stands=jnp.where(is_self, progress.stands, heard.stands | is_silent),
            at_m=jnp.where(is_self[..., None], at_m, others.extrapolate_m(self.time_s)),
            speed_mps=jnp.where(is_self, speed_mps, others_mps),
        )


def initial_status(clock_s: jax.Array) -> PlanStatus:
    """Return the status of robots [R] at given clocks, none of which stands yet."""
    return PlanStatus(passed_s=clock_s, for_s=jnp.zeros_like(clock_s))


def shift_status(status: PlanStatus, before_s: jax.Array, after_s: jax.Array) -> PlanStatus:
    """Return the status with clocks [R] moved from one time to another, as for new plans."""
    return replace(status, passed_s=status.passed_s + after_s - before_s)


def initial_clocks(q: jax.Array) -> FollowCarry:
    """Return clocks at 0 for robots [R] with attitudes q [R, 4]."""
    w, x, y, z = jnp.moveaxis(q, -1, 0)
    yaw = jnp.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return jax.vmap(follow.reset)(yaw)


def reach_m(radius_m: jax.Array) -> jax.Array:
    """Return distances [R, R] of centres below which two robots block each other."""
    return radius_m[:, None] + radius_m + 2 * SLACK_M


def step(
    gains: FollowGains,
    carry: FollowCarry,
    estimate: Estimate,
    plan: Plan,
    order: PassingOrder | None,
    cruise_mps: jax.Array,
    dt: float,
    status: PlanStatus | None = None,
    heard: HeardProgress | None = None,
) -> tuple[FollowCarry, PoseTarget, PlanStatus | None]:
    """Advance the clocks of a team by one control step; [R] leads.

    Args:
        gains: of the guidance.
        carry: clocks and headings.
        estimate: of the robots' own motion.
        plan: theirs.
        order: of passing; None: each flies by its own clock.
        cruise_mps: [R] for how late a robot is that is behind its place.
        dt: control period, s.
        status: of robots for which others no longer wait; None: they wait for all.
        heard: received progress of the others; None: all is known.

    Returns:
        The memory, the target of each robot, and the status. The heading turns at a limited
        rate.
    """
    next_carry, target = jax.vmap(partial(follow.step, gains, dt=dt))(carry, estimate, plan)
    if order is None:
        return next_carry, target, status
    progress_along_s = progress_s(carry, estimate, plan, cruise_mps)
    is_stuck = None if status is None else status.for_s > PATIENCE_S
    speed = jnp.sqrt(jnp.sum(estimate.nu[:, :3] ** 2, axis=-1))
    observed = None
    if heard is not None:
        observed = heard.observe_team(build_progress(progress_along_s, status), estimate.p, speed)
    max_clock_s, barred = clock_limits(
        order, progress_along_s, is_stuck, estimate.p, speed, observed
    )
    clock = jnp.minimum(next_carry.clock_s, jnp.maximum(carry.clock_s, max_clock_s))
    is_held = clock < next_carry.clock_s
    target = replace(target, velocity_mps=jnp.where(is_held[:, None], 0.0, target.velocity_mps))
    if status is not None:
        status = update_status(status, progress_along_s, is_held & ~barred, dt)
    return replace(next_carry, clock_s=clock), target, status


def progress_s(
    carry: FollowCarry, estimate: Estimate, plan: Plan, cruise_mps: jax.Array
) -> jax.Array:
    """Return the progress [R] along plans by estimated positions; arguments of `step`."""
    position_m = jax.vmap(plans.position_at)(plan, carry.clock_s)
    behind_m = jnp.maximum(
        jnp.sqrt(jnp.sum((position_m - estimate.p) ** 2, axis=-1)) - SLACK_M, 0.0
    )
    return carry.clock_s - behind_m / jnp.maximum(cruise_mps, MIN_SPEED_MPS)


def build_progress(passed: jax.Array, status: PlanStatus | None) -> PlanProgress:
    """Build the progress that robots [R] send each other."""
    nothing_stuck = jnp.zeros_like(passed, bool)
    is_stuck = nothing_stuck if status is None else status.for_s > PATIENCE_S
    return PlanProgress(passed_s=passed, stands=is_stuck)


def update_status(
    status: PlanStatus, passed_s: jax.Array, waits: jax.Array, dt: float
) -> PlanStatus:
    """Update the status by one control step; ``waits`` [R] for others that advance."""
    gets_on = waits | (passed_s > status.passed_s + MIN_PROGRESS_S)
    return PlanStatus(
        passed_s=jnp.where(gets_on, passed_s, status.passed_s),
        for_s=jnp.where(gets_on, 0.0, status.for_s + dt),
    )
