"""Passing order at the crossings of a team's plans, and the limits of clocks that keep it.

Where two paths come nearer than their reach at different times, one robot passes first by plan. A
late robot would meet a punctual one there. Each robot has a clock along its plan; the order is kept
by a limit of each clock by the others' clocks:

    robot b may be at its position of time t only when robot a has left, by its own clock, all
    positions near to it that its plan left before t; or is level with b, where that is sooner.

No limit is later than the time it guards, so the robot with the least clock is never held: a
waiting robot waits for a moving one, and the team does not stand.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_mjx.robot.control import plans
from angler_mjx.robot.control.plans import Plan

SAMPLES = 128
"""Compared positions of a plan; between two of them a robot may be anywhere."""
_ROUNDING = 0.1
"""Fraction of half a sample by which level clocks may differ: of two robots that wait at the same
time each would otherwise be behind the other by a last bit."""
_STUCK_MOTION_S = 1.0
"""Kept clear, too: where robots that get no further may be so soon. Most are carried about by the
current."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class PassingOrder:
    """Of the robots of one world."""

    time_s: jax.Array
    """[K] of the places that are compared, on the clocks of all plans."""
    half_s: jax.Array
    """[] time [s] before and after its own for which a position stands."""
    needs_s: jax.Array
    """[b, K, a] time that the clock of a must have passed before b may be there; -inf: none."""
    position_m: jax.Array
    """[b, K, 3] the places."""
    reach_m: jax.Array
    """[b, K, a] distance of a's centre from the position below which they block each other."""


def build_order(plan: Plan, reach_m: jax.Array, samples: int = SAMPLES) -> PassingOrder:
    """Build the passing order of a team's plans.

    Args:
        plan: [R] leading.
        reach_m: [R, R] between centres; nearer ones are in each other's way.
        samples: places of each plan that are compared.
    """
    end = jnp.maximum(jnp.max(plan.time_s), 1e-3)
    time = jnp.linspace(0.0, 1.0, samples) * end
    half = 0.5 * end / (samples - 1)
    position_m = jax.vmap(
        lambda robot_plan: jax.vmap(lambda t: plans.position_at(robot_plan, t))(time)
    )(plan)
    leg = jnp.sqrt(jnp.sum((position_m[:, 1:] - position_m[:, :-1]) ** 2, axis=-1))
    # A place stands for its neighbourhood: half of the longer leg beside it.
    before, after = jnp.pad(leg, ((0, 0), (1, 0))), jnp.pad(leg, ((0, 0), (0, 1)))
    width = 0.5 * jnp.maximum(before, after)
    earlier = time[None, :] < time[:, None]
    level = time - half - _ROUNDING * half

    def of_robot(_: None, b: jax.Array) -> tuple[None, jax.Array]:
        gap = jnp.sqrt(jnp.sum((position_m[b][None, :, None] - position_m[:, None]) ** 2, axis=-1))
        is_near = gap < reach_m[b][:, None, None] + width[b][None, :, None] + width[:, None]
        passed = jnp.max(jnp.where(is_near & earlier, time + half, -jnp.inf), axis=-1)
        return None, jnp.minimum(passed, level).T

    robots = jnp.arange(reach_m.shape[0])
    _, needs = jax.lax.scan(of_robot, None, robots)
    is_self = jnp.eye(reach_m.shape[0], dtype=bool)
    return PassingOrder(
        time_s=time,
        half_s=half,
        needs_s=jnp.where(is_self[:, None], -jnp.inf, needs),
        position_m=position_m,
        reach_m=jnp.where(is_self[:, None], -jnp.inf, reach_m[:, None] + width[:, :, None]),
    )


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class ObservedTeam:
    """Each robot's picture of the others; [observer, observed] leads."""

    clock_s: jax.Array
    """[R, R]"""
    stands: jax.Array
    """bool [R, R]"""
    at_m: jax.Array
    """[R, R, 3]"""
    speed_mps: jax.Array
    """[R, R]"""


def clock_limits(
    order: PassingOrder,
    clock_s: jax.Array,
    stands: jax.Array | None = None,
    at_m: jax.Array | None = None,
    speed_mps: jax.Array | None = None,
    observed: ObservedTeam | None = None,
) -> tuple[jax.Array, jax.Array]:
    """Return the limit of the clock of each robot.

    Args:
        order: of the world.
        clock_s: [R] how far each robot is along its plan.
        stands: bool [R] robots for which no other waits: others only keep clear of their position.
        at_m: [R, 3] where the robots are.
        speed_mps: [R] how fast they are.
        observed: each robot's picture of the others; None: their true states.

    Returns:
        [R], inf where nothing is in its way; and bool [R] whether a standing robot blocks it.
    """
    entry = order.time_s - order.half_s
    # Who is there, or was, is not kept from it any more.
    is_ahead_of_entry = (entry >= clock_s[:, None] - _ROUNDING * order.half_s)[..., None]
    theirs_s, others_m = clock_s, at_m
    if observed is not None:
        theirs_s, others_m = observed.clock_s[:, None], observed.at_m[:, None]
        stands, speed_mps = observed.stands[:, None], observed.speed_mps[:, None]
    must_wait = (theirs_s < order.needs_s) & is_ahead_of_entry
    is_barred = jnp.zeros_like(must_wait)
    if stands is not None and at_m is not None and others_m is not None and speed_mps is not None:
        gap = _point_distance(order.position_m[:, :, None], others_m)
        # Who is near already may go away.
        apart = _point_distance(at_m[:, None], at_m if observed is None else observed.at_m)
        is_nearer = gap < apart[:, None]
        ahead = (order.time_s + order.half_s > clock_s[:, None])[..., None]
        is_barred = stands & (gap < order.reach_m + _STUCK_MOTION_S * speed_mps) & is_nearer & ahead
        must_wait &= ~stands
    late, barred = (
        jnp.min(jnp.where(jnp.any(held, axis=-1), entry, jnp.inf), axis=-1)
        for held in (must_wait, is_barred)
    )
    return jnp.minimum(late, barred), (barred <= late) & jnp.isfinite(barred)


def _point_distance(a: jax.Array, b: jax.Array) -> jax.Array:
    return jnp.sqrt(jnp.sum((a - b) ** 2, axis=-1))
