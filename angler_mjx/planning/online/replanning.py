"""Replanning in flight, from the information of that time.

At a fixed period the team is planned again, from the positions on its present plans at which the
new ones are taken up. A robot without a new plan keeps its old one if that is clear of known
obstacles and of the others' new plans; otherwise it stops and holds.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp

from angler_mjx.planning import build_problem
from angler_mjx.planning.online.motion import advance_obstacles, is_clear, plans_as_traffic
from angler_mjx.planning.online.plan_joining import join_plan, pad_plan, remaining_plan
from angler_mjx.planning.path_search.bodies import bodies_traffic
from angler_mjx.planning.path_search.traffic import GridTraffic, concatenate_traffic
from angler_mjx.planning.problem import Problem, ProblemSettings
from angler_mjx.robot.control.commands.trajectory import Trajectory, sample_reference
from angler_mjx.robot.control.laws.follow import FollowCarry
from angler_mjx.sim.information import CurrentInformation, ObstacleInformation
from angler_mjx.sim.policy import RESET_STEP, PolicyInput


@dataclass(frozen=True, kw_only=True)
class Replanning:
    """Settings of replanning; hashable, static under jit."""

    planner: Callable[[Problem], Trajectory]
    """Planner of one problem, traced."""
    every: int
    """Control steps from one observation to the next."""
    delay: int
    """Control steps from an observation until its plans are taken up; at most ``every``."""
    dt_s: float
    """Control period."""
    problem: ProblemSettings
    """Settings of the problems that it plans."""

    @property
    def delay_s(self) -> float:
        """Time [s] from an observation until its plans are taken up."""
        return self.delay * self.dt_s


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class FleetPlans:
    """Plans of the robots of one world."""

    now: Trajectory
    """[R] plans that robots follow by their clocks."""
    soon: Trajectory
    """[R] plans made last; they begin where the robots will be when they are taken up."""
    take: jax.Array
    """bool [R] robots that take ``soon`` up; the others go on with the rest of ``now``."""
    failed_s: jax.Array
    """[R, n] time [s] of each of the n replans in the horizon without a plan for a robot that had
    not arrived; inf with a plan, or before."""

    def failed(self, until_s: jax.Array) -> jax.Array:
        """Return the number of failures before a time [R] of each robot, int32 [R]."""
        return jnp.sum(self.failed_s < until_s[..., None], axis=-1, dtype=jnp.int32)


def initial_plans(settings: Replanning, inputs: PolicyInput) -> FleetPlans:
    """Return the plans at t = 0: those made before the start.

    Args:
        settings: of the replanning.
        inputs: at t = 0; its path is a Trajectory.
    """
    path = inputs.path
    if not isinstance(path, Trajectory):
        raise TypeError(f"a {type(path).__name__} cannot be replanned")
    points = settings.problem.points
    now = pad_plan(path, points + 1)
    rows = path.time_s.shape[0]
    soon = jax.tree.map(lambda leaf: leaf, pad_plan(path, points))
    soon = replace(
        soon,
        time_s=soon.time_s[:, :points],
        position_m=soon.position_m[:, :points],
    )
    nobody = jnp.zeros(rows, bool)
    times = max(round(settings.problem.horizon_s / settings.dt_s) - 1, 0) // settings.every
    never = jnp.full((rows, times), jnp.inf, inputs.goal_m.dtype)
    return FleetPlans(now=now, soon=soon, take=nobody, failed_s=never)


def check_schedule(settings: Replanning, step: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return whether plans are made in a control step, and whether they are taken up."""
    since = step - settings.delay
    makes = (step > 0) & (step % settings.every == 0)
    return makes, (since > 0) & (since % settings.every == 0)


def replan(
    settings: Replanning,
    plans: FleetPlans,
    clocks: FollowCarry,
    inputs: PolicyInput,
    key: jax.Array,
) -> FleetPlans:
    """Plan anew.

    Args:
        settings: of the replanning.
        plans: present ones.
        clocks: along them.
        inputs: of this time.
        key: of this world and step.
    """
    if (
        inputs.grid is None
        or inputs.floor_z_m is None
        or inputs.obstacles is None
        or inputs.current is None
    ):
        raise RuntimeError("plans are made anew by a policy that is told of no scenery")
    soon_s = clocks.clock_s + settings.delay_s
    start, _ = jax.vmap(sample_reference)(plans.now, soon_s)
    obstacles = advance_obstacles(inputs.obstacles, settings.delay_s)
    problem = Problem(
        grid=inputs.grid,
        floor_z_m=inputs.floor_z_m,
        team=build_problem.build_team(
            inputs.params, start, clocks.yaw_rad, inputs.goal_m, inputs.joint_position
        ),
        obstacles=obstacles,
        current=_advance_current(inputs.current, settings.delay_s),
        seed=jax.random.bits(jax.random.fold_in(key, RESET_STEP), dtype=jnp.uint32),
        **settings.problem.static_fields(),
    )
    new = settings.planner(problem)
    radius = problem.team.radius_m
    old = jax.vmap(remaining_plan)(plans.now, soon_s)
    is_clear = _is_remainder_clear(settings, old, new, radius, obstacles)
    distance_m = jnp.sqrt(jnp.sum((inputs.goal_m - inputs.belief.p) ** 2, axis=-1))
    is_missing = ~new.found & (distance_m > problem.goal_tolerance_m)
    at = jnp.round(inputs.time_s / (settings.every * settings.dt_s)).astype(jnp.int32) - 1
    failed_s = plans.failed_s.at[:, at].set(
        jnp.where(is_missing, inputs.time_s, jnp.inf), mode="drop"
    )
    held = replace(new, time_s=jnp.zeros_like(new.time_s), position_m=_stay_at(start, new))
    soon = jax.tree.map(partial(_select_plans, new.found), new, held)
    return replace(plans, soon=soon, take=new.found | ~is_clear, failed_s=failed_s)


def take_up(
    plans: FleetPlans, clocks: FollowCarry, cruise_mps: jax.Array
) -> tuple[FleetPlans, FollowCarry]:
    """Replace plans by the new ones; all clocks begin at 0, headings go on."""
    position_m, _ = jax.vmap(sample_reference)(plans.now, clocks.clock_s)
    new = jax.vmap(join_plan)(position_m, plans.soon, cruise_mps)
    old = jax.vmap(remaining_plan)(plans.now, clocks.clock_s)
    rows = max(new.time_s.shape[1], old.time_s.shape[1])
    now = jax.tree.map(partial(_select_plans, plans.take), pad_plan(new, rows), pad_plan(old, rows))
    return (
        replace(plans, now=now, take=jnp.zeros_like(plans.take)),
        replace(clocks, clock_s=jnp.zeros_like(clocks.clock_s)),
    )


def _is_remainder_clear(
    settings: Replanning,
    old: Trajectory,
    new: Trajectory,
    radius_m: jax.Array,
    obstacles: ObstacleInformation,
) -> jax.Array:
    """Return whether the rest of each plan is clear of obstacles and new plans, bool [R]."""
    horizon_s, margin_m = settings.problem.horizon_s, settings.problem.margin_m
    bodies = bodies_traffic(obstacles, horizon_s)
    traffic = concatenate_traffic(bodies, plans_as_traffic(new, radius_m, new.found))

    def is_path_clear(path: Trajectory, radius: jax.Array) -> jax.Array:
        grown: GridTraffic = replace(traffic, reach_m=traffic.reach_m + radius + margin_m)
        return is_clear(path, grown, horizon_s)

    return jax.vmap(is_path_clear)(old, radius_m)


def _advance_current(current: CurrentInformation, delay_s: float) -> CurrentInformation:
    if current.stays or current.begin_s is None:
        return current
    return replace(current, begin_s=current.begin_s + delay_s)


def _stay_at(start_m: jax.Array, like: Trajectory) -> jax.Array:
    """Return points of plans that stay at ``start_m`` [R, 3]."""
    return jnp.broadcast_to(start_m[:, None], like.position_m.shape)


def _select_plans(which: jax.Array, a: jax.Array, b: jax.Array) -> jax.Array:
    return jnp.where(which.reshape((-1,) + (1,) * (a.ndim - 1)), a, b)
