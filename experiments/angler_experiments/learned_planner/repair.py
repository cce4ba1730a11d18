"""Repair of sampled paths: pushes out of rock, and a choice of collision-free ones, robot by robot.

All in closed form. Way-points are moved up the gradient of the distance to rock; then every leg is
checked against rock, faces and floor, and against the known motion of obstacles. From the remaining
candidates of a team paths are chosen robot by robot, each the candidate that arrives first among
those that meet none of the robots chosen before. A robot without a candidate is first in the next
round, and if it finds none then, the others avoid it.
"""

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp

from angler_experiments.learned_planner import path_encoding, rock_distance
from angler_experiments.learned_planner.frames import StraightFrame
from angler_mjx.planning.path_search.bodies import GOAL_CLEAR_S, bodies_traffic
from angler_mjx.planning.path_search.lattice import column_bits
from angler_mjx.planning.path_search.starts import meets_starts, select_flyable, select_paths
from angler_mjx.planning.path_search.traffic import (
    GridTraffic,
    concatenate_traffic,
    is_motion_clear,
    meets_traffic,
)
from angler_mjx.planning.problem import Problem
from angler_mjx.robot.control.commands.trajectory import Trajectory, hold_position
from angler_mjx.sim.information import ObstacleInformation

_ROUNDING_M = 1e-3
_PUSH_FRACTION = 0.5
"""Fraction of the missing distance that a push adds."""
_SMOOTHING_FRACTION = 0.02
"""Fraction by which a push moves a way-point to the middle of its neighbours."""
_PUSH_MARGIN_M = 0.8
"""Margin of pushes beyond the required distance: distances are interpolated between cells' centres,
and the check requires more at the edges of rock."""


@dataclass(frozen=True, kw_only=True)
class RepairConfig:
    """Settings of the repair; static."""

    margin_m: float
    pushes: int
    hold_s: tuple[float, ...]
    """Start times of a robot."""
    rounds: int


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Candidates:
    """Possible paths of robots: [R, C] leads."""

    paths: Trajectory
    """Paths; ``found`` is whether the path is clear of all but the other robots."""


def push_out_of_rock(
    problem: Problem, field: jax.Array, position_m: jax.Array, need_m: jax.Array, pushes: int
) -> jax.Array:
    """Push points [n, 3] of one path between its ends out of rock.

    Args:
        problem: problem of the world.
        field: distances of `rock_distance.compute_depth_field`.
        position_m: points of the path.
        need_m: [] distance to keep.
        pushes: number of moves of each point.
    """
    depth = partial(rock_distance.interpolate_field, problem.grid, field)
    slope = jax.vmap(jax.value_and_grad(depth))

    def push_once(_: int, position_m: jax.Array) -> jax.Array:
        # Middles of legs are pushed too, and move both their ends.
        middle = 0.5 * (position_m[1:] + position_m[:-1])
        gap, gradient = slope(jnp.concatenate([position_m[1:-1], middle]))
        gradient_norm = jnp.sqrt(jnp.sum(gradient**2, axis=-1, keepdims=True))
        missing = jnp.maximum(need_m + _PUSH_MARGIN_M - gap, 0.0)[:, None]
        move = _PUSH_FRACTION * missing * gradient / jnp.maximum(gradient_norm, 0.3)
        inner = position_m.shape[0] - 2
        point_move, leg_move = move[:inner], move[inner:]
        smoothing = 0.5 * (position_m[2:] + position_m[:-2]) - position_m[1:-1]
        step = point_move + 0.5 * (leg_move[1:] + leg_move[:-1]) + _SMOOTHING_FRACTION * smoothing
        return position_m.at[1:-1].add(step)

    moved: jax.Array = jax.lax.fori_loop(0, pushes, push_once, position_m)
    return moved


def build_candidates(
    problem: Problem, frames: StraightFrame, samples: jax.Array, config: RepairConfig
) -> Candidates:
    """Build all candidate paths of the robots of one world.

    Args:
        problem: problem of the world.
        frames: straight frames [R].
        samples: [samples, R, inner, 4] encoded paths.
        config: static.
    """
    team = problem.team
    field = rock_distance.compute_depth_field(problem.grid, problem.floor_z_m)
    columns = column_bits(problem.grid.occupied)
    bodies = _obstacle_traffic(problem.obstacles, problem.horizon_s)
    holds = jnp.array(config.hold_s)

    def build_robot_paths(
        encoded_paths: jax.Array,
        frame: StraightFrame,
        goal: jax.Array,
        radius: jax.Array,
        speed: jax.Array,
    ) -> Trajectory:
        need = radius + config.margin_m

        def build_paths(encoded: jax.Array) -> Trajectory:
            position_m = path_encoding.decode_points(encoded, frame, goal)
            is_sample_clear = _is_path_clear(problem, columns, position_m, need)
            pushed_m = push_out_of_rock(problem, field, position_m, need, config.pushes)
            is_clear = is_sample_clear | _is_path_clear(problem, columns, pushed_m, need)
            position_m = jnp.where(is_sample_clear, position_m, pushed_m)
            delays_s = path_encoding.decode_delays_s(encoded)
            time, position_m = jax.vmap(path_encoding.time_path, in_axes=(None, None, 0, None))(
                position_m, delays_s, holds, speed
            )
            paths = Trajectory(
                time_s=time,
                position_m=position_m,
                found=is_clear & (time[:, -1] <= problem.horizon_s),
            )
            if bodies is None:
                return paths
            grown_bodies = replace(bodies, reach_m=bodies.reach_m + need)
            return replace(
                paths, found=paths.found & jax.vmap(partial(_avoids_bodies, grown_bodies))(paths)
            )

        robot_paths = jax.vmap(build_paths)(encoded_paths)
        flat_paths: Trajectory = jax.tree.map(
            lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), robot_paths
        )
        return flat_paths

    straight_path = jnp.zeros_like(samples[:1])
    all_encoded = jnp.swapaxes(jnp.concatenate([straight_path, samples]), 0, 1)
    robot_inputs = (all_encoded, frames, team.goal_m, team.radius_m, team.cruise_speed_mps)
    return Candidates(paths=jax.lax.map(lambda inputs: build_robot_paths(*inputs), robot_inputs))


def _is_path_clear(
    problem: Problem, columns: jax.Array, position_m: jax.Array, need_m: jax.Array
) -> jax.Array:
    legs = jax.vmap(rock_distance.is_segment_clear, in_axes=(None, None, 0, 0, None))(
        problem.grid, columns, position_m[:-1], position_m[1:], need_m - _ROUNDING_M
    )
    return jnp.all(legs) & rock_distance.is_within_bounds(
        problem.grid, problem.floor_z_m, position_m, need_m
    )


def _obstacle_traffic(obstacles: ObstacleInformation, horizon_s: float) -> GridTraffic | None:
    """Return all known obstacles, fixed ones included, as spheres along timed paths."""
    if obstacles.radius_m.shape[-1] == 0:
        return None
    moving = bodies_traffic(obstacles, horizon_s)
    if not obstacles.some_stand:
        return moving
    still = GridTraffic(
        time_s=jnp.zeros_like(obstacles.radius_m)[:, None],
        position_m=obstacles.p_m[:, :1],
        reach_m=obstacles.radius_m,
        until_s=jnp.where(obstacles.exists & ~obstacles.moves, jnp.inf, -1.0).astype(
            moving.reach_m.dtype
        ),
    )
    return concatenate_traffic(moving, still)


def _avoids_bodies(bodies: GridTraffic, path: Trajectory) -> jax.Array:
    """Return whether a path meets no body until shortly after its end; bool []."""
    position_m = jnp.concatenate([path.position_m, path.position_m[-1:]])
    time = jnp.append(path.time_s, path.time_s[-1] + GOAL_CLEAR_S)
    legs = jax.vmap(is_motion_clear, in_axes=(None, 0, 0, 0, 0))(
        bodies, position_m[:-1], time[:-1], position_m[1:], time[1:]
    )
    return jnp.all(legs)


def choose_team_paths(
    problem: Problem,
    candidates: Candidates,
    config: RepairConfig,
    cost_factors: jax.Array | None = None,
) -> Trajectory:
    """Choose paths [R] of one team, no two of which meet; ``found`` is False without one.

    Args:
        problem: problem of the world.
        candidates: candidate paths of its robots.
        config: static.
        cost_factors: [R, C] factors on arrival times in the choice of the first arrival; 1 if left
            out.
    """
    team = problem.team
    robots, _, count = candidates.paths.time_s.shape
    reach = team.radius_m[:, None] + team.radius_m + config.margin_m
    holding = hold_position(team.start_m, count)
    length = jnp.sqrt(jnp.sum((team.goal_m - team.start_m) ** 2, axis=-1))
    needs = length / team.cruise_speed_mps
    meets_start = partial(meets_starts, horizon_s=problem.horizon_s)
    is_other = ~jnp.eye(robots, dtype=bool)
    cost = candidates.paths.time_s[..., -1] * (1.0 if cost_factors is None else cost_factors)

    def choose_path(
        number: int, state: tuple[Trajectory, jax.Array, jax.Array]
    ) -> tuple[Trajectory, jax.Array, jax.Array]:
        plans, settled, order = state
        i = order[number]
        robot_paths: Trajectory = jax.tree.map(lambda leaf: leaf[i], candidates.paths)
        traffic = GridTraffic(
            time_s=plans.time_s,
            position_m=plans.position_m,
            reach_m=reach[i],
            until_s=jnp.where(settled, jnp.inf, -1.0).at[i].set(-1.0).astype(reach.dtype),
        )
        is_met = jax.vmap(lambda path: jnp.any(meets_traffic(path, traffic)))(robot_paths)
        is_free = robot_paths.found & ~is_met
        best = jnp.argmin(jnp.where(is_free, cost[i], jnp.inf))
        path = jax.tree.map(lambda leaf: leaf[best], robot_paths)
        hold = jax.tree.map(lambda leaf: leaf[i], holding)
        path = jax.tree.map(lambda a, b: jnp.where(is_free[best], a, b), path, hold)
        plans = jax.tree.map(lambda values, value: values.at[i].set(value), plans, path)
        return plans, settled.at[i].set(True), order

    def run_round(
        state: tuple[Trajectory, jax.Array], _: None
    ) -> tuple[tuple[Trajectory, jax.Array], None]:
        best, n_failed = state
        order = jnp.argsort(-(n_failed * 1e6 + needs))
        initial = (holding, jnp.zeros((robots,), bool), order)
        plans, _, _ = jax.lax.fori_loop(0, robots, choose_path, initial)
        is_met = (
            jax.vmap(meets_start)(plans, team.start_m[None].repeat(robots, 0), reach) & is_other
        )
        is_kept = select_flyable(plans.found, is_met)
        flown = replace(select_paths(is_kept, plans, holding), found=is_kept)
        is_better = jnp.sum(is_kept) > jnp.sum(best.found)
        best = jax.tree.map(lambda a, b: jnp.where(is_better, a, b), flown, best)
        return (best, n_failed + ~is_kept), None

    (best, _), _ = jax.lax.scan(
        run_round, (holding, jnp.zeros((robots,), needs.dtype)), None, length=config.rounds
    )
    return best
