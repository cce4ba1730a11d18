"""The grid planner: way-points for a whole fleet, one world, on the device.

Robots are planned in the order of their index. Each searches space and time on a lattice (see
`search`), keeping clear of the paths of the robots before it, which stand at their goals once they
have arrived, and of the starts of those after it during the first ``start_hold_s``. Then its way is
pulled straight (see `pulling`). A robot for which no way is found is told to hold its start; a
robot whose path runs over such a start holds too, so the plans that are handed out never meet.

It knows cells, faces of the cube, sea floor and static obstacles. It does not know currents or
obstacles that move: it is the base line that other planners are compared with.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from angler_mjx.control.trajectory import Trajectory, hold
from angler_mjx.planning.lattice import Terrain, free_space, terrain
from angler_mjx.planning.pulling import pull
from angler_mjx.planning.search import reachable
from angler_mjx.planning.tracing import Route, trace_back
from angler_mjx.planning.traffic import Balls, Traffic, balls, beside, clear_of
from angler_mjx.world.environment import Environment


@dataclass(frozen=True, kw_only=True)
class GridSettings:
    """What a scenario can choose of it, in [planner.grid]."""

    start_hold_s: float = 30.0
    """How long the start of a robot that is not planned yet is kept clear."""

    def __post_init__(self) -> None:
        """Refuse what is none."""
        if not 0.0 <= self.start_hold_s <= 86400.0:
            raise ValueError(f"start_hold_s = {self.start_hold_s:g}: must be 0 to 86400 s")


class GridPlanner:
    """What scenarios call grid; `plan` is part of the program that draws the worlds."""

    Settings = GridSettings


@dataclass(frozen=True, kw_only=True)
class GridPlannerConfig:
    """Settings of the grid planner; hashable, static under jit."""

    horizon_s: float = 120.0
    """A goal reached later is not found."""
    margin_m: float = 0.1
    """Kept beyond the radii, from rock and between robots."""
    n_point: int = 32
    """Way-points of a path; a path that needs more is not found."""
    n_layer: int = 96
    """Layers of the search. A layer is half a step along an axis, but at least
    horizon_s / n_layer: with fewer layers than 2 horizon_s speed / cell the search moves slower
    than the robot can, and finds less. Diagonal steps are up to 16 % slow: allow that much more."""
    start_hold_s: float = GridSettings.start_hold_s
    """How long the start of a robot that is not planned yet is kept clear."""


def plan(
    environment: Environment,
    radius_m: jax.Array,
    speed_mps: jax.Array,
    config: GridPlannerConfig,
    others: Traffic | None = None,
) -> Trajectory:
    """Plan the fleet of one world.

    Args:
        environment: one world.
        radius_m: [R] radius of the sphere about each robot's centre of mass that holds its hull.
        speed_mps: [R] cruise speed, positive.
        config: static.
        others: bodies that move and are no robots, ``reach_m`` their own radii.

    Returns:
        Trajectory with a leading axis R on every leaf: from start_m at time 0 to goal_m, never
        faster than the cruise speed; where ``found`` is False every row is the start.
    """
    land = terrain(environment)
    n_robot = radius_m.shape[0]
    held = hold(environment.start_m, config.n_point)

    def one(plans: Trajectory, index: jax.Array) -> tuple[Trajectory, None]:
        planned = jnp.arange(n_robot) < index
        traffic = Traffic(
            time_s=plans.time_s,
            position_m=plans.position_m,
            reach_m=radius_m + radius_m[index] + config.margin_m,
            until_s=jnp.where(planned, jnp.inf, config.start_hold_s).at[index].set(-1.0),
        )
        if others is not None:
            reach = others.reach_m + radius_m[index] + config.margin_m
            traffic = beside(traffic, replace(others, reach_m=reach))
        new = _plan_one(
            land,
            traffic,
            environment.start_m[index],
            environment.goal_m[index],
            radius_m[index] + config.margin_m,
            speed_mps[index],
            config,
        )
        return jax.tree.map(lambda all_, row: all_.at[index].set(row), plans, new), None

    plans, _ = jax.lax.scan(one, held, jnp.arange(n_robot))
    return _withdraw(plans, held, radius_m, config)


def _plan_one(
    land: Terrain,
    traffic: Traffic,
    start_m: jax.Array,
    goal_m: jax.Array,
    clearance_m: jax.Array,
    speed_mps: jax.Array,
    config: GridPlannerConfig,
) -> Trajectory:
    """Plan one robot among the traffic; holds its start where there is no way."""
    layer_s = jnp.maximum(0.5 * land.grid.cell_m / speed_mps, config.horizon_s / config.n_layer)
    start, lead_in = _cell_of(land, start_m, speed_mps * layer_s)
    goal, lead_out = _cell_of(land, goal_m, speed_mps * layer_s)
    free = free_space(land, clearance_m)
    around = balls(traffic, layer_s, config.n_layer)
    history, last, reached = reachable(
        land, free, around, _bit(land, start), lead_in, goal, _free_from_now(around, goal_m)
    )
    route = trace_back(land, free, around, history, layer_s, (goal, last), (start, lead_in))
    arrive = (last + lead_out) * layer_s
    timetable = Route(
        position_m=jnp.concatenate([start_m[None], route.position_m, goal_m[None]]),
        arrive_s=jnp.concatenate([jnp.zeros_like(arrive)[None], route.arrive_s, arrive[None]]),
        # Nobody moves after the horizon: who can stand there until then can stand there for ever.
        leave_s=jnp.concatenate(
            [
                jnp.zeros_like(arrive)[None],
                route.leave_s,
                jnp.maximum(arrive, config.horizon_s)[None],
            ]
        ),
        begin=route.begin + 1,
        whole=route.whole,
    )
    # 0.1 mm: a way along cells' centres must not fail by rounding where it just fits.
    path = pull(land, traffic, timetable, clearance_m - 1e-4, speed_mps, config.n_point)
    found = reached & path.found & (path.time_s[-1] <= config.horizon_s)
    stay = jax.tree.map(lambda leaf: leaf[0], hold(start_m[None], config.n_point))
    chosen: Trajectory = jax.tree.map(lambda a, b: jnp.where(found, a, b), path, stay)
    return replace(chosen, found=found)


def _cell_of(land: Terrain, p: jax.Array, step_m: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Cell [3] that holds p [3], and the layers [] from p to its centre at ``step_m`` a layer."""
    grid = land.grid
    shape = jnp.array(land.layout.shape)
    cell = jnp.clip(jnp.floor((p - grid.origin_m) / grid.cell_m).astype(jnp.int32), 0, shape - 1)
    off = p - (grid.origin_m + (cell + 0.5) * grid.cell_m)
    # A start at a centre must not cost a layer by rounding.
    layers = jnp.ceil(jnp.sqrt(jnp.sum(off * off)) / step_m - 1e-3)
    return cell, jnp.maximum(layers, 0.0).astype(jnp.int32)


def _bit(land: Terrain, cell: jax.Array) -> jax.Array:
    """Words [total] with one cell [3] set."""
    layout = land.layout
    at = layout.guard + cell[0] * layout.row + cell[1]
    bit = jnp.uint32(1) << cell[2].astype(jnp.uint32)
    return jnp.where(jnp.arange(layout.total) == at, bit, jnp.uint32(0))


def _free_from_now(around: Balls, p: jax.Array) -> jax.Array:
    """Whether a robot that stands at p [3] from each layer on is never met, bool [L]."""
    gap = around.centre_m - p
    inside = (around.radius_m >= 0.0) & (jnp.sum(gap * gap, axis=-1) < around.radius_m**2)
    met = jnp.any(inside, axis=1)
    return ~jax.lax.cummax(met.astype(jnp.int32), reverse=True).astype(bool)


def _withdraw(
    plans: Trajectory, held: Trajectory, radius_m: jax.Array, config: GridPlannerConfig
) -> Trajectory:
    """Take back every path that comes too near to the start of a robot without one.

    Only robots planned later can be met so: the others' paths were made with that start in view. A
    path that is taken back is one more robot at its start, hence the rounds.
    """
    n_robot = radius_m.shape[0]
    reach = radius_m[:, None] + radius_m + config.margin_m

    def meets(row: jax.Array) -> jax.Array:
        """Bool [R]: whether path ``row`` comes too near to each robot's start."""
        path = jax.tree.map(lambda leaf: leaf[row][None], plans)

        def start_meets(other: jax.Array) -> jax.Array:
            alone = Traffic(
                time_s=path.time_s,
                position_m=path.position_m,
                # 1 mm: rounding must not take back a path that just fits.
                reach_m=reach[row, other][None] - 1e-3,
                until_s=jnp.full((1,), jnp.inf, radius_m.dtype),
            )
            place = held.position_m[other, 0]
            zero = jnp.zeros((), radius_m.dtype)
            return ~clear_of(alone, place, zero, place, zero + config.horizon_s)

        return jax.vmap(start_meets)(jnp.arange(n_robot))

    met = jax.vmap(meets)(jnp.arange(n_robot)) & ~jnp.eye(n_robot, dtype=bool)

    def again(_: int, found: jax.Array) -> jax.Array:
        return found & ~jnp.any(met & ~found, axis=1)

    found = jax.lax.fori_loop(0, n_robot, again, plans.found)

    def choose(a: jax.Array, b: jax.Array) -> jax.Array:
        return jnp.where(found.reshape((-1,) + (1,) * (a.ndim - 1)), a, b)

    chosen: Trajectory = jax.tree.map(choose, plans, held)
    return replace(chosen, found=found)
