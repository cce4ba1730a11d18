"""The search of one team, robot by robot: orders of priority, and repair of neighbourhoods.

A pass plans some robots in an order, each among the paths of all that were planned before it (see
`angler_mjx.planning.ways`). The first pass plans all in the order of their index, as `grid` does.
While robots are left without a way, further passes plan all again, those first who had none; then
large neighbourhood search takes over (Shaw 1998; for robots: Li et al., MAPF-LNS2, AAAI 2022): a
robot without a way and those nearest to the line from its start to its goal are taken out and
planned anew, that robot first. What a pass comes to is kept if as many robots have ways as before.

A step plans one robot, so that teams which need very different effort can be stepped side by side.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from angler_mjx.control.trajectory import Trajectory, hold
from angler_mjx.planning.ways.lattice import Terrain
from angler_mjx.planning.ways.robot import WayConfig, grown, plan_one
from angler_mjx.planning.ways.starts import meets_starts, only, standing
from angler_mjx.planning.ways.traffic import Others, Traffic

_ON_LINE = 9
"""Places on the line from start to goal that others' distances are taken from."""


@dataclass(frozen=True, kw_only=True)
class Effort:
    """How much is searched; static."""

    budget: int = 64
    """Searches of single robots, for each robot of the team."""
    orders: int = 3
    """Passes that plan the whole team; repair of neighbourhoods comes after them."""
    neighbours: int = 7
    """Robots that are taken out beside the one that has no way, at most."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Task:
    """One team to be planned; [R] leads but for the land."""

    land: Terrain
    start_m: jax.Array
    goal_m: jax.Array
    radius_m: jax.Array
    speed_mps: jax.Array
    bodies: Traffic | None
    """Obstacles that move, as far as they are known."""
    seed: jax.Array
    """uint32 []."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Search:
    """Where the search of one team stands."""

    plans: Trajectory
    """[R] paths of the pass under way; robots that are not planned yet hold their starts."""
    met: jax.Array
    """bool [R, R] whether the path of a robot (row) comes too near to another's start."""
    placed: jax.Array
    """bool [R] not to be planned in this pass, or planned already."""
    order: jax.Array
    """int32 [R] who is planned, in this order."""
    length: jax.Array
    """int32 [] how many of ``order`` are."""
    at: jax.Array
    """int32 [] how many of them have been."""
    number: jax.Array
    """int32 [] passes before this one."""
    used: jax.Array
    """int32 [] searches of single robots so far."""
    best: Trajectory
    """[R] the paths that are handed out: none of them meet."""
    best_met: jax.Array
    """bool [R, R] of the best."""


def begin(task: Task, n_point: int) -> Search:
    """Before the first pass."""
    n_robot = task.radius_m.shape[0]
    held = hold(task.start_m, n_point)
    none = jnp.zeros((n_robot, n_robot), bool)
    zero = jnp.zeros((), jnp.int32)
    return Search(
        plans=held,
        met=none,
        placed=jnp.zeros((n_robot,), bool),
        order=jnp.arange(n_robot),
        length=zero + n_robot,
        at=zero,
        number=zero,
        used=zero,
        best=held,
        best_met=none,
    )


def ended(search: Search, effort: Effort) -> jax.Array:
    """Whether all robots have ways, or the budget is used up; bool []."""
    whole = jnp.all(search.best.found)
    return whole | (search.used >= effort.budget * search.order.shape[0])


def step(task: Task, search: Search, config: WayConfig, effort: Effort) -> Search:
    """Plan one robot; at the end of a pass, choose those of the next."""
    after = _plan_next(task, search, config)
    passed = _end_pass(task, after, config, effort)
    over = after.at == after.length
    chosen: Search = jax.tree.map(lambda a, b: jnp.where(over, a, b), passed, after)
    return chosen


def _plan_next(task: Task, search: Search, config: WayConfig) -> Search:
    """The next robot of the pass."""
    i = search.order[search.at]
    reach = task.radius_m + task.radius_m[i] + config.margin_m
    until = jnp.where(search.placed, jnp.inf, config.start_hold_s).at[i].set(-1.0)
    robots = Traffic(
        time_s=search.plans.time_s,
        position_m=search.plans.position_m,
        reach_m=reach,
        until_s=until.astype(reach.dtype),
    )
    clearance = task.radius_m[i] + config.margin_m
    path = plan_one(
        task.land,
        Others(robots=robots, bodies=grown(task.bodies, clearance)),
        task.start_m[i],
        task.goal_m[i],
        clearance,
        task.speed_mps[i],
        config,
    )
    met = meets_starts(path, task.start_m, reach, config.horizon_s)
    return replace(
        search,
        plans=jax.tree.map(lambda many, one: many.at[i].set(one), search.plans, path),
        met=search.met.at[i].set(met.at[i].set(False)),
        placed=search.placed.at[i].set(True),
        at=search.at + 1,
        used=search.used + 1,
    )


def _end_pass(task: Task, search: Search, config: WayConfig, effort: Effort) -> Search:
    """Keep what the pass came to, if it is no worse, and choose who is planned next."""
    held = hold(task.start_m, config.n_point)  # none of them found
    found = standing(search.plans.found, search.met)
    better = jnp.sum(found) >= jnp.sum(search.best.found)
    came_to = only(found, search.plans, held)
    best: Trajectory = jax.tree.map(lambda a, b: jnp.where(better, a, b), came_to, search.best)
    met = jnp.where(better, search.met & found[:, None], search.best_met)
    number = search.number + 1
    order, length = _next(task, best, number, effort)
    rank = jnp.zeros_like(order).at[order].set(jnp.arange(order.shape[0]))
    out = rank < length
    return replace(
        search,
        plans=only(~out, best, held),
        met=met & ~out[:, None],
        placed=~out,
        order=order,
        length=length,
        at=jnp.zeros_like(search.at),
        number=number,
        best=best,
        best_met=met,
    )


def _next(
    task: Task, best: Trajectory, number: jax.Array, effort: Effort
) -> tuple[jax.Array, jax.Array]:
    """Robots [R] in the order of the next pass, and how many of them [] are planned."""
    n_robot = best.found.shape[0]
    key = jax.random.fold_in(jax.random.key(task.seed), number)
    draws = jax.random.uniform(key, (2, n_robot))
    missing = ~best.found
    # All of them, those without a way first: their order is drawn, the others keep to it too.
    again = jnp.argsort(draws[0] - 2.0 * missing)
    chosen = jnp.argmax(jnp.where(missing, draws[0], -1.0))
    order = jnp.argsort(_off_line(task, best, chosen) * (0.5 + draws[1]))
    # Of those that are taken out, the one without a way goes first, the others as they come.
    near = min(effort.neighbours + 1, n_robot)
    repair = number >= effort.orders
    return jnp.where(repair, order, again), jnp.where(repair, near, n_robot)


def _off_line(task: Task, best: Trajectory, i: jax.Array) -> jax.Array:
    """Distance [R] of each robot's path and ends from robot i's straight line; of i itself -1."""
    share = jnp.linspace(0.0, 1.0, _ON_LINE)[:, None]
    line = task.start_m[i] + share * (task.goal_m[i] - task.start_m[i])
    middle = 0.5 * (best.position_m[:, 1:] + best.position_m[:, :-1])
    places = jnp.concatenate([best.position_m, middle, task.goal_m[:, None]], axis=1)
    gap = places[:, :, None, :] - line
    return jnp.sqrt(jnp.min(jnp.sum(gap * gap, axis=-1), axis=(1, 2))).at[i].set(-1.0)
