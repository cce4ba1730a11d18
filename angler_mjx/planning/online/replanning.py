"""Plans made anew while robots fly, from what they are told then.

Every so many control steps the team is planned for again, from where its plans take it by the time
that the new ones are taken up. A robot for which there is no plan keeps its old one where that is
clear of what is known and of the others' new plans; otherwise it stops and holds.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from angler_mjx.planning import build_problem
from angler_mjx.planning.online.joining import joined, padded, remainder
from angler_mjx.planning.online.motion import is_clear, later, plan_rows
from angler_mjx.planning.path_search.bodies import bodies_traffic
from angler_mjx.planning.path_search.traffic import GridTraffic, beside
from angler_mjx.planning.problem import Problem
from angler_mjx.robot.control.laws.follow import FollowCarry
from angler_mjx.robot.control.trajectory import Trajectory, sample
from angler_mjx.sim.information import CurrentInformation, Information, ObstacleInformation
from angler_mjx.sim.policy import OF_RESET, PolicyInput


@dataclass(frozen=True, kw_only=True)
class Replanning:
    """How a team is planned for anew; hashable, static under jit."""

    planner: Callable[[Problem], Trajectory]
    """Of one problem, traced."""
    every: int
    """Control steps from one observation to the next."""
    delay: int
    """Control steps from an observation until its plans are taken up; at most ``every``."""
    dt_s: float
    """Control period."""
    points: int
    """Rows of the plans that it gives."""
    margin_m: float
    """Kept beside the radii."""
    knows: Information
    horizon_s: float
    goal_tolerance_m: float
    deadline_s: float

    @property
    def delay_s(self) -> float:
        """Time from an observation until its plans are taken up."""
        return self.delay * self.dt_s


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class FleetPlans:
    """Of the robots of one world."""

    now: Trajectory
    """[R] that they fly along, by their clocks."""
    soon: Trajectory
    """[R] made last; begin where the robots will be when they are taken up."""
    take: jax.Array
    """bool [R] who is to take ``soon`` up; the others go on with what is left of ``now``."""
    failed_s: jax.Array
    """[R, n] when no new plan was found for a robot that had not arrived; inf where one was, or
    nothing was made yet. Of the n times in the horizon; later ones are not counted."""

    def failed(self, until_s: jax.Array) -> jax.Array:
        """Int32 [R]: how often no new plan was found before a time [R] of each robot."""
        return jnp.sum(self.failed_s < until_s[..., None], axis=-1, dtype=jnp.int32)


def begin(settings: Replanning, known: PolicyInput) -> FleetPlans:
    """Plans at t = 0: those that were made before the start.

    Args:
        settings: of the replanning.
        known: what the robots know then; its path is a Trajectory.
    """
    path: Any = known.path
    now = padded(path, settings.points + 1)
    rows = path.time_s.shape[0]
    soon = jax.tree.map(lambda leaf: leaf, padded(path, settings.points))
    soon = replace(
        soon,
        time_s=soon.time_s[:, : settings.points],
        position_m=soon.position_m[:, : settings.points],
    )
    nobody = jnp.zeros(rows, bool)
    times = max(round(settings.horizon_s / settings.dt_s) - 1, 0) // settings.every
    never = jnp.full((rows, times), jnp.inf, known.goal_m.dtype)
    return FleetPlans(now=now, soon=soon, take=nobody, failed_s=never)


def due(settings: Replanning, step: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Whether plans are to be made in a control step, and whether they are to be taken up."""
    since = step - settings.delay
    makes = (step > 0) & (step % settings.every == 0)
    return makes, (since > 0) & (since % settings.every == 0)


def make(
    settings: Replanning, plans: FleetPlans, clocks: FollowCarry, known: PolicyInput, key: jax.Array
) -> FleetPlans:
    """Plan anew.

    Args:
        settings: of the replanning.
        plans: that the robots have.
        clocks: along them.
        known: what may be known now.
        key: of this world and step.
    """
    if known.grid is None or known.obstacles is None or known.current is None:
        raise RuntimeError("plans are made anew by a policy that is told of no scenery")
    soon_s = clocks.clock_s + settings.delay_s
    start, _ = jax.vmap(sample)(plans.now, soon_s)
    obstacles = later(known.obstacles, settings.delay_s)
    problem = Problem(
        grid=known.grid,
        floor_z_m=known.floor_z_m,
        team=build_problem.team(known.params, start, clocks.yaw_rad, known.goal_m),
        obstacles=obstacles,
        current=_later(known.current, settings.delay_s),
        seed=jax.random.bits(jax.random.fold_in(key, OF_RESET), dtype=jnp.uint32),
        horizon_s=settings.horizon_s,
        goal_tolerance_m=settings.goal_tolerance_m,
        knows=settings.knows,
        deadline_s=settings.deadline_s,
    )
    new = settings.planner(problem)
    radius = problem.team.radius_m
    old = jax.vmap(remainder)(plans.now, soon_s)
    clear = _clear(settings, old, new, radius, obstacles)
    way = jnp.sqrt(jnp.sum((known.goal_m - known.belief.p) ** 2, axis=-1))
    missing = ~new.found & (way > settings.goal_tolerance_m)
    at = jnp.round(known.time_s / (settings.every * settings.dt_s)).astype(jnp.int32) - 1
    failed_s = plans.failed_s.at[:, at].set(jnp.where(missing, known.time_s, jnp.inf), mode="drop")
    held = replace(new, time_s=jnp.zeros_like(new.time_s), position_m=_at(start, new))
    soon = jax.tree.map(partial(_choose, new.found), new, held)
    return replace(plans, soon=soon, take=new.found | ~clear, failed_s=failed_s)


def take_up(
    plans: FleetPlans, clocks: FollowCarry, cruise_mps: jax.Array
) -> tuple[FleetPlans, FollowCarry]:
    """Go over to the plans that were made; all clocks begin anew, headings go on."""
    here, _ = jax.vmap(sample)(plans.now, clocks.clock_s)
    new = jax.vmap(joined)(here, plans.soon, cruise_mps)
    old = jax.vmap(remainder)(plans.now, clocks.clock_s)
    rows = max(new.time_s.shape[1], old.time_s.shape[1])
    now = jax.tree.map(partial(_choose, plans.take), padded(new, rows), padded(old, rows))
    return (
        replace(plans, now=now, take=jnp.zeros_like(plans.take)),
        replace(clocks, clock_s=jnp.zeros_like(clocks.clock_s)),
    )


def _clear(
    settings: Replanning,
    old: Trajectory,
    new: Trajectory,
    radius_m: jax.Array,
    obstacles: ObstacleInformation,
) -> jax.Array:
    """Whether what is left of each robot's plan is clear of obstacles and new plans, bool [R]."""
    bodies = bodies_traffic(obstacles, settings.horizon_s)
    traffic = beside(bodies, plan_rows(new, radius_m, new.found))

    def one(path: Trajectory, radius: jax.Array) -> jax.Array:
        grown: GridTraffic = replace(traffic, reach_m=traffic.reach_m + radius + settings.margin_m)
        return is_clear(path, grown, settings.horizon_s)

    return jax.vmap(one)(old, radius_m)


def _later(known: CurrentInformation, delay_s: float) -> CurrentInformation:
    if known.stays or known.begin_s is None:
        return known
    return replace(known, begin_s=known.begin_s + delay_s)


def _at(start_m: jax.Array, like: Trajectory) -> jax.Array:
    """Points of plans that stay at ``start_m`` [R, 3]."""
    return jnp.broadcast_to(start_m[:, None], like.position_m.shape)


def _choose(which: jax.Array, a: jax.Array, b: jax.Array) -> jax.Array:
    return jnp.where(which.reshape((-1,) + (1,) * (a.ndim - 1)), a, b)
