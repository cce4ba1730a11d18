"""The search of one team, robot by robot: who finds no way drives some of the others out.

A robot that is to be planned is searched a way clear of all that are (see `planning.path_search`).
If there is none, it is tried again with some of those, drawn by lot and more at each try, not
looked at; whom the new path then meets loses its own and waits for its next turn. So robots that
are hard to plan come to be first, and only what stands in their way is planned again. The most
robots that were ever planned at a time are handed out.

The paths of the robots that are planned never meet: each new one is proved against those that it
was searched among, and takes out those of the rest that it meets.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from angler_mjx.planning.path_search.lattice import Terrain
from angler_mjx.planning.path_search.robot import WayConfig, grown, plan_one
from angler_mjx.planning.path_search.starts import meets_starts, only, standing
from angler_mjx.planning.path_search.traffic import GridTraffic, PlannedTraffic, met_by
from angler_mjx.robot.control.trajectory import Trajectory, hold

_NEVER = 2**31 - 1

_LEFT_OUT = 0.25
"""Fraction of the planned robots that is not looked at, for each try that failed before."""

_STAGES = 2
"""Searches of a robot among all that are planned: with all the room beyond the margin, then with
half of it."""

_LEAST_ROOM = 0.25
"""Fraction of the room that every search keeps."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class PriorityTask:
    """One team to be planned; [R] leads but for the land."""

    land: Terrain
    start_m: jax.Array
    goal_m: jax.Array
    radius_m: jax.Array
    speed_mps: jax.Array
    bodies: GridTraffic | None
    """Obstacles that move, as far as they are known."""
    seed: jax.Array
    """uint32 []."""
    first: Trajectory | None = None
    """[R] what is planned already: paths that do not meet; None for nothing."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Search:
    """Where the search of one team stands."""

    plans: Trajectory
    """[R]; ``found`` is who is planned, the others hold their starts."""
    best: Trajectory
    """[R] the most that were planned at a time."""
    tries: jax.Array
    """int32 [R] searches that failed since the robot had a path."""
    turn: jax.Array
    """int32 [R] who has the least is searched first."""
    hopeless: jax.Array
    """bool [R] no way even where no other robot is looked at."""
    used: jax.Array
    """int32 [] searches so far."""


def begin(task: PriorityTask, config: WayConfig) -> Search:
    """Who has no path yet and needs longest is first."""
    n_robot = task.radius_m.shape[0]
    held = hold(task.start_m, config.n_point)
    first = held if task.first is None else only(task.first.found, task.first, held)
    gap = task.goal_m - task.start_m
    needs = jnp.sqrt(jnp.sum(gap * gap, axis=-1)) / task.speed_mps
    none = jnp.zeros((n_robot,), jnp.int32)
    return Search(
        plans=first,
        best=first,
        tries=none,
        # Below all numbers of searches, which are the turns of those that are taken out.
        turn=jnp.argsort(jnp.argsort(-needs)).astype(jnp.int32) - n_robot,
        hopeless=jnp.zeros((n_robot,), bool),
        used=jnp.zeros((), jnp.int32),
    )


def ended(search: Search, budget: int) -> jax.Array:
    """Whether nothing is left to be searched, or the budget (a robot) is used up; bool []."""
    settled = jnp.all(search.plans.found | search.hopeless)
    return settled | (search.used >= budget * search.tries.shape[0])


def step(task: PriorityTask, search: Search, config: WayConfig) -> Search:
    """Search one robot a way."""
    planned = search.plans.found
    waits = ~planned & ~search.hopeless
    i = jnp.argmin(jnp.where(waits, search.turn, _NEVER))
    tries = search.tries[i]
    stages = _STAGES if config.room_m > 0.0 else 0
    chance = jnp.clip(_LEFT_OUT * (tries - stages), 0.0, 1.0)
    room = config.room_m * jnp.clip(1.0 - tries / _STAGES, _LEAST_ROOM, 1.0)
    key = jax.random.fold_in(jax.random.key(task.seed), search.used)
    seen = planned & (jax.random.uniform(key, planned.shape) >= chance)
    held = hold(task.start_m, config.n_point)
    reach = task.radius_m + task.radius_m[i] + config.margin_m + room
    # Who is not looked at is taken to stand at its start for a while, less at each try; who has no
    # hope stands there for ever.
    stays = jnp.where(search.hopeless, jnp.inf, config.start_hold_s * (1.0 - chance))
    until = jnp.where(seen, jnp.inf, jnp.where(chance < 1.0, stays, -1.0)).at[i].set(-1.0)
    shown = _traffic(only(seen, search.plans, held), reach, until)
    clearance = task.radius_m[i] + config.margin_m
    path = plan_one(
        task.land,
        PlannedTraffic(robots=shown, bodies=grown(task.bodies, clearance)),
        task.start_m[i],
        task.goal_m[i],
        clearance,
        task.speed_mps[i],
        config,
    )
    all_planned = _traffic(search.plans, reach, jnp.where(planned, jnp.inf, -1.0))
    # Those it was proved against are not asked again: rounding must not take them out.
    out = path.found & planned & ~seen & met_by(path, all_planned)
    kept = only(planned & ~out, search.plans, held)
    plans: Trajectory = jax.tree.map(lambda many, one: many.at[i].set(one), kept, path)
    better = jnp.sum(plans.found) > jnp.sum(search.best.found)
    return Search(
        plans=plans,
        best=jax.tree.map(lambda a, b: jnp.where(better, a, b), plans, search.best),
        tries=search.tries.at[i].set(jnp.where(path.found, 0, search.tries[i] + 1)),
        turn=jnp.where(out, search.used, search.turn),
        hopeless=search.hopeless.at[i].set(~path.found & (chance >= 1.0)),
        used=search.used + 1,
    )


def to_fly(task: PriorityTask, best: Trajectory, config: WayConfig) -> Trajectory:
    """Of the best paths [R] those that meet no start of a robot that stays there."""
    reach = task.radius_m[:, None] + task.radius_m + config.margin_m

    def meets(path: Trajectory, reach_m: jax.Array) -> jax.Array:
        return meets_starts(path, task.start_m, reach_m, config.horizon_s)

    met = jax.vmap(meets)(best, reach) & ~jnp.eye(reach.shape[0], dtype=bool)
    found = standing(best.found, met)
    return replace(only(found, best, hold(task.start_m, config.n_point)), found=found)


def _traffic(plans: Trajectory, reach_m: jax.Array, until_s: jax.Array) -> GridTraffic:
    return GridTraffic(
        time_s=plans.time_s,
        position_m=plans.position_m,
        reach_m=reach_m,
        until_s=until_s.astype(reach_m.dtype),
    )
