"""Search of one team, robot by robot: a robot without a path displaces some of the others.

The path of a robot is searched clear of all planned robots (`planning.path_search`). If there is
none, the search is repeated while some of these, at random and more at each try, are ignored; a
robot that the new path meets loses its own and waits for its next turn. So robots that are hard to
plan come first, and only robots that block them are planned again. The result is the largest set of
robots that was planned at a time.

The paths of planned robots never meet: each new one is proved against those that it was searched
among, and displaces those of the rest that it meets.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from angler_kernels.threefry import seed_key
from angler_mjx.planning.path_search.lattice import Terrain
from angler_mjx.planning.path_search.robot_search import PathSearchConfig, grow_bodies, plan_robot
from angler_mjx.planning.path_search.starts import meets_starts, select_flyable, select_paths
from angler_mjx.planning.path_search.traffic import GridTraffic, PlannedTraffic, meets_traffic
from angler_mjx.robot.control.commands.trajectory import Trajectory, hold_position

_NEVER = 2**31 - 1

_IGNORED_FRACTION = 0.25
"""Fraction of the planned robots that is ignored, for each earlier failure."""

_STAGES = 2
"""Searches of a robot among all that are planned: with all the room beyond the margin, then with
half of it."""

_MIN_ROOM_FRACTION = 0.25
"""Fraction of the room that every search keeps."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class PriorityTask:
    """One team to plan; [R] leads but for the land."""

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
    """[R] paths that are planned already and do not meet; None without."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class TeamSearch:
    """State of the search of one team."""

    plans: Trajectory
    """[R]; ``found`` marks planned robots, the others hold their starts."""
    best: Trajectory
    """[R] paths of the largest set that was planned at a time."""
    tries: jax.Array
    """int32 [R] searches that failed since the robot had a path."""
    turn: jax.Array
    """int32 [R] turn; the robot with the least is searched first."""
    hopeless: jax.Array
    """bool [R] no path even without the other robots."""
    used: jax.Array
    """int32 [] searches so far."""


def begin_search(task: PriorityTask, config: PathSearchConfig) -> TeamSearch:
    """Return the search at its start; the robot with the longest flight has the first turn."""
    n_robot = task.radius_m.shape[0]
    hold_paths = hold_position(task.start_m, config.n_point)
    first = (
        hold_paths if task.first is None else select_paths(task.first.found, task.first, hold_paths)
    )
    gap = task.goal_m - task.start_m
    needed_s = jnp.sqrt(jnp.sum(gap * gap, axis=-1)) / task.speed_mps
    zeros = jnp.zeros((n_robot,), jnp.int32)
    return TeamSearch(
        plans=first,
        best=first,
        tries=zeros,
        # Below all numbers of searches, which are the turns of those that are taken out.
        turn=jnp.argsort(jnp.argsort(-needed_s)).astype(jnp.int32) - n_robot,
        hopeless=jnp.zeros((n_robot,), bool),
        used=jnp.zeros((), jnp.int32),
    )


def is_finished(search: TeamSearch, budget: int) -> jax.Array:
    """Return whether all robots are settled or the budget (per robot) is used up; bool []."""
    settled = jnp.all(search.plans.found | search.hopeless)
    return settled | (search.used >= budget * search.tries.shape[0])


def search_next_robot(
    task: PriorityTask, search: TeamSearch, config: PathSearchConfig
) -> TeamSearch:
    """Search the path of one robot."""
    planned = search.plans.found
    is_waiting = ~planned & ~search.hopeless
    i = jnp.argmin(jnp.where(is_waiting, search.turn, _NEVER))
    tries = search.tries[i]
    stages = _STAGES if config.room_m > 0.0 else 0
    chance = jnp.clip(_IGNORED_FRACTION * (tries - stages), 0.0, 1.0)
    room = config.room_m * jnp.clip(1.0 - tries / _STAGES, _MIN_ROOM_FRACTION, 1.0)
    key = jax.random.fold_in(seed_key(task.seed), search.used)
    is_seen = planned & (jax.random.uniform(key, planned.shape) >= chance)
    hold_paths = hold_position(task.start_m, config.n_point)
    reach = task.radius_m + task.radius_m[i] + config.margin_m + room
    # Who is not looked at is taken to stand at its start for a while, less at each try; who has no
    # hope stands there for ever.
    stays = jnp.where(search.hopeless, jnp.inf, config.start_hold_s * (1.0 - chance))
    until = jnp.where(is_seen, jnp.inf, jnp.where(chance < 1.0, stays, -1.0)).at[i].set(-1.0)
    visible_traffic = _build_traffic(select_paths(is_seen, search.plans, hold_paths), reach, until)
    clearance = task.radius_m[i] + config.margin_m
    path = plan_robot(
        task.land,
        PlannedTraffic(robots=visible_traffic, bodies=grow_bodies(task.bodies, clearance)),
        task.start_m[i],
        task.goal_m[i],
        clearance,
        task.speed_mps[i],
        config,
    )
    all_planned = _build_traffic(search.plans, reach, jnp.where(planned, jnp.inf, -1.0))
    # Those it was proved against are not asked again: rounding must not take them out.
    displaced = path.found & planned & ~is_seen & meets_traffic(path, all_planned)
    kept_plans = select_paths(planned & ~displaced, search.plans, hold_paths)
    plans: Trajectory = jax.tree.map(
        lambda rows, new_row: rows.at[i].set(new_row), kept_plans, path
    )
    is_better = jnp.sum(plans.found) > jnp.sum(search.best.found)
    return TeamSearch(
        plans=plans,
        best=jax.tree.map(lambda a, b: jnp.where(is_better, a, b), plans, search.best),
        tries=search.tries.at[i].set(jnp.where(path.found, 0, search.tries[i] + 1)),
        turn=jnp.where(displaced, search.used, search.turn),
        hopeless=search.hopeless.at[i].set(~path.found & (chance >= 1.0)),
        used=search.used + 1,
    )


def select_flyable_paths(
    task: PriorityTask, best: Trajectory, config: PathSearchConfig
) -> Trajectory:
    """Select of the best paths [R] those that meet no start of a robot that stays there."""
    reach = task.radius_m[:, None] + task.radius_m + config.margin_m

    def meets(path: Trajectory, reach_m: jax.Array) -> jax.Array:
        return meets_starts(path, task.start_m, reach_m, config.horizon_s)

    is_met = jax.vmap(meets)(best, reach) & ~jnp.eye(reach.shape[0], dtype=bool)
    is_found = select_flyable(best.found, is_met)
    return replace(
        select_paths(is_found, best, hold_position(task.start_m, config.n_point)), found=is_found
    )


def _build_traffic(plans: Trajectory, reach_m: jax.Array, until_s: jax.Array) -> GridTraffic:
    return GridTraffic(
        time_s=plans.time_s,
        position_m=plans.position_m,
        reach_m=reach_m,
        until_s=until_s.astype(reach_m.dtype),
    )
