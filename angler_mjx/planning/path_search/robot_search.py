"""Path search of one robot among traffic: on the lattice, then pulled straight."""

import math
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from angler_kernels.programs import MAX_LANES, use_kernels
from angler_mjx.errors import ConfigError
from angler_mjx.planning.path_search import search, search_kernel
from angler_mjx.planning.path_search.bodies import GOAL_CLEAR_S
from angler_mjx.planning.path_search.lattice import FreeSpace, Terrain, free_space
from angler_mjx.planning.path_search.string_pulling import pull_string
from angler_mjx.planning.path_search.tracing import Route, trace_back
from angler_mjx.planning.path_search.traffic import Balls, GridTraffic, PlannedTraffic, build_balls
from angler_mjx.planning.problem import ProblemSettings
from angler_mjx.robot.control.commands.trajectory import Trajectory, hold_position

MAX_LAYERS = 1024
"""More memory than any search needs."""


@dataclass(frozen=True, kw_only=True)
class PathSearchConfig:
    """Settings of the path search; hashable, static under jit."""

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
    start_hold_s: float = 30.0
    """Time [s] for which the start of a robot that is not planned yet is kept clear."""
    room_m: float = 0.0
    """Distance [m] between robots beyond the margin, where a path allows it; for priority."""


def path_search_config(problem: ProblemSettings) -> PathSearchConfig:
    """Return the search settings of a problem, with the layers that its fastest robot needs."""
    speed_mps, cell_m = problem.max_cruise_speed_mps, problem.cell_m
    n_layer = MAX_LAYERS
    if speed_mps is not None and cell_m is not None:
        n_layer = required_layers(problem.horizon_s, speed_mps, cell_m)
    return PathSearchConfig(
        horizon_s=problem.horizon_s,
        margin_m=problem.margin_m,
        n_point=problem.points,
        n_layer=n_layer,
    )


def require_still_water(problem: ProblemSettings, name: str) -> None:
    """Refuse information on the current that a planner in still water cannot use.

    Args:
        problem: settings of the problem.
        name: of the planner.

    Raises:
        ConfigError: the current may be known, and obstacles are not predicted in it.
    """
    information = problem.information
    if information.current != "nothing" and information.obstacles != "predicted":
        raise ConfigError(
            f'planner.information.current = "{information.current}": the planner {name} plans in '
            "still water, where the current can only help to predict obstacles; take "
            'planner.information.obstacles = "predicted", or "nothing" here, or another planner'
        )


def required_layers(horizon_s: float, speed_mps: float, cell_m: float) -> int:
    """Return the layers by which a search reaches the horizon at the full speed of a robot.

    A layer is half a step along an axis; diagonal steps are rounded up by up to 16 %.
    """
    n_layers = math.ceil(2.0 * 1.16 * horizon_s * speed_mps / cell_m)
    return min(max(n_layers, PathSearchConfig.n_layer), MAX_LAYERS)


def grow_bodies(bodies: GridTraffic | None, by_m: jax.Array) -> GridTraffic | None:
    """Return bodies with ``by_m`` [] more reach."""
    return None if bodies is None else replace(bodies, reach_m=bodies.reach_m + by_m)


def plan_robot(
    land: Terrain,
    others: PlannedTraffic,
    start_m: jax.Array,
    goal_m: jax.Array,
    clearance_m: jax.Array,
    speed_mps: jax.Array,
    config: PathSearchConfig,
) -> Trajectory:
    """Plan one robot among the traffic; holds its start where there is no way."""
    layer_s = jnp.maximum(0.5 * land.grid.cell_m / speed_mps, config.horizon_s / config.n_layer)
    start, lead_in = _cell_of(land, start_m, speed_mps * layer_s)
    goal, lead_out = _cell_of(land, goal_m, speed_mps * layer_s)
    free = free_space(land, clearance_m)
    around = build_balls(others.robots, layer_s, config.n_layer)
    may_stay = _free_from_now(around, goal_m)
    if others.bodies is not None:
        drifting = build_balls(others.bodies, layer_s, config.n_layer)
        may_stay &= _free_for(drifting, goal_m, GOAL_CLEAR_S / layer_s)
        around = jax.tree.map(lambda a, b: jnp.concatenate([a, b], axis=1), around, drifting)
    history, last, reached = _search_reachable(land, free, around, (start, lead_in), goal, may_stay)
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
    path = pull_string(land, others, timetable, clearance_m - 1e-4, speed_mps, config.n_point)
    is_found = reached & path.found & (path.time_s[-1] <= config.horizon_s)
    stay = jax.tree.map(lambda leaf: leaf[0], hold_position(start_m[None], config.n_point))
    chosen: Trajectory = jax.tree.map(lambda a, b: jnp.where(is_found, a, b), path, stay)
    return replace(chosen, found=is_found)


def _search_reachable(
    land: Terrain,
    free: FreeSpace,
    around: Balls,
    start: tuple[jax.Array, jax.Array],
    goal: jax.Array,
    may_stay: jax.Array,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Run `search.search_reachable` from a cell [3] at a layer []; on a GPU by its kernel."""
    nx, ny, _ = land.layout.shape
    if use_kernels() and nx * ny <= MAX_LANES:
        return search_kernel.search_reachable(land, free, around, start, goal, may_stay)
    return search.search_reachable(
        land, free, around, _cell_bit(land, start[0]), start[1], goal, may_stay
    )


def _cell_of(land: Terrain, p: jax.Array, step_m: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the cell [3] that holds p [3], and the layers [] to its centre at ``step_m`` each."""
    grid = land.grid
    shape = jnp.array(land.layout.shape)
    cell = jnp.clip(jnp.floor((p - grid.origin_m) / grid.cell_m).astype(jnp.int32), 0, shape - 1)
    off = p - (grid.origin_m + (cell + 0.5) * grid.cell_m)
    # A start at a centre must not cost a layer by rounding.
    n_layers = jnp.ceil(jnp.sqrt(jnp.sum(off * off)) / step_m - 1e-3)
    return cell, jnp.maximum(n_layers, 0.0).astype(jnp.int32)


def _cell_bit(land: Terrain, cell: jax.Array) -> jax.Array:
    """Return words [total] with one cell [3] set."""
    layout = land.layout
    at = layout.guard_size + cell[0] * layout.row + cell[1]
    bit = jnp.uint32(1) << cell[2].astype(jnp.uint32)
    return jnp.where(jnp.arange(layout.total) == at, bit, jnp.uint32(0))


def _is_met(around: Balls, p: jax.Array) -> jax.Array:
    """Return whether a robot that stands at p [3] is met in each layer, int32 [L]."""
    gap = around.centre_m - p
    inside = (around.radius_m >= 0.0) & (jnp.sum(gap * gap, axis=-1) < around.radius_m**2)
    return jnp.any(inside, axis=1).astype(jnp.int32)


def _free_from_now(around: Balls, p: jax.Array) -> jax.Array:
    """Return whether a robot at p [3] is never met from each layer on, bool [L]."""
    return ~jax.lax.cummax(_is_met(around, p), reverse=True).astype(bool)


def _free_for(around: Balls, p: jax.Array, layers: jax.Array) -> jax.Array:
    """Return from which layers a robot may stand at p [3] for ``required_layers`` [] unmet."""
    met = _is_met(around, p)
    until = jnp.arange(met.size) + jnp.ceil(layers).astype(jnp.int32)
    count = jnp.cumsum(met)
    return count[jnp.minimum(until, met.size - 1)] - count + met == 0
