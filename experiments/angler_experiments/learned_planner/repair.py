"""What makes drawn ways fit to fly: pushed out of rock, and checked, one robot after the other.

All in closed form. Way-points are moved up the slope of the distance to rock; then every leg is
held against rock, faces and floor, and against what is known of obstacles over time. What is left
of a team is chosen robot by robot, each the candidate that arrives first among those that meet
none of the robots chosen before. Who finds none goes first in the next round, and if it finds none
then, the others go around it.
"""

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp

from angler_experiments.learned_planner import path_encoding, rock
from angler_experiments.learned_planner.frames import StraightFrame
from angler_mjx.planning.path_search.bodies import STANDS_S, bodies_traffic
from angler_mjx.planning.path_search.lattice import column_words
from angler_mjx.planning.path_search.starts import meets_starts, only, standing
from angler_mjx.planning.path_search.traffic import GridTraffic, beside, clear_of, met_by
from angler_mjx.planning.problem import Problem
from angler_mjx.robot.control.trajectory import Trajectory, hold
from angler_mjx.sim.information import ObstacleInformation

_ROUNDING_M = 1e-3
_STEP = 0.5
"""Share of what is missing that a push gives."""
_SMOOTH = 0.02
"""Share by which a push draws a way-point to the middle of its neighbours."""
_BEYOND_M = 0.8
"""Pushes aim at so much more than must be kept: distances are read between cells' centres, and the
check asks for more at the edges of rock."""


@dataclass(frozen=True, kw_only=True)
class RepairConfig:
    """How ways are repaired; static."""

    margin_m: float
    pushes: int
    hold_s: tuple[float, ...]
    """Times after which a robot may set off."""
    rounds: int


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Candidates:
    """Paths that robots may take: [R, C] leads."""

    paths: Trajectory
    """``found`` is whether it is clear of all but the other robots."""


def pushed(
    problem: Problem, field: jax.Array, place: jax.Array, need_m: jax.Array, pushes: int
) -> jax.Array:
    """Points [n, 3] of one way with those between its ends moved out of rock.

    Args:
        problem: of the world.
        field: of `rock.depth_field`.
        place: the way.
        need_m: [] distance to keep.
        pushes: how often each is moved.
    """
    depth = partial(rock.read_field, problem.grid, field)
    slope = jax.vmap(jax.value_and_grad(depth))

    def push(_: int, place: jax.Array) -> jax.Array:
        # Middles of legs are pushed too, and take both their ends along.
        middle = 0.5 * (place[1:] + place[:-1])
        gap, up = slope(jnp.concatenate([place[1:-1], middle]))
        steep = jnp.sqrt(jnp.sum(up**2, axis=-1, keepdims=True))
        missing = jnp.maximum(need_m + _BEYOND_M - gap, 0.0)[:, None]
        move = _STEP * missing * up / jnp.maximum(steep, 0.3)
        inner = place.shape[0] - 2
        own, both = move[:inner], move[inner:]
        between = 0.5 * (place[2:] + place[:-2]) - place[1:-1]
        step = own + 0.5 * (both[1:] + both[:-1]) + _SMOOTH * between
        return place.at[1:-1].add(step)

    done: jax.Array = jax.lax.fori_loop(0, pushes, push, place)
    return done


def candidates(
    problem: Problem, frames: StraightFrame, drawn: jax.Array, config: RepairConfig
) -> Candidates:
    """All paths that the robots of one world may take.

    Args:
        problem: of the world.
        frames: [R].
        drawn: [samples, R, inner, 4] ways.
        config: static.
    """
    team = problem.team
    field = rock.depth_field(problem.grid, problem.floor_z_m)
    columns = column_words(problem.grid.occupied)
    bodies = _bodies(problem.obstacles, problem.horizon_s)
    holds = jnp.array(config.hold_s)

    def of_robot(
        mine: jax.Array, frame: StraightFrame, goal: jax.Array, radius: jax.Array, speed: jax.Array
    ) -> Trajectory:
        need = radius + config.margin_m

        def of_way(way: jax.Array) -> Trajectory:
            place = path_encoding.points(way, frame, goal)
            drawn_clear = _stands_clear(problem, columns, place, need)
            moved = pushed(problem, field, place, need, config.pushes)
            clear = drawn_clear | _stands_clear(problem, columns, moved, need)
            place = jnp.where(drawn_clear, place, moved)
            added = path_encoding.delays_s(way)
            time, place = jax.vmap(path_encoding.timed, in_axes=(None, None, 0, None))(
                place, added, holds, speed
            )
            paths = Trajectory(
                time_s=time,
                position_m=place,
                found=clear & (time[:, -1] <= problem.horizon_s),
            )
            if bodies is None:
                return paths
            grown = replace(bodies, reach_m=bodies.reach_m + need)
            return replace(paths, found=paths.found & jax.vmap(partial(_passes, grown))(paths))

        found = jax.vmap(of_way)(mine)
        flat: Trajectory = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), found)
        return flat

    straight_on = jnp.zeros_like(drawn[:1])
    all_ways = jnp.swapaxes(jnp.concatenate([straight_on, drawn]), 0, 1)
    each = (all_ways, frames, team.goal_m, team.radius_m, team.cruise_speed_mps)
    return Candidates(paths=jax.lax.map(lambda one: of_robot(*one), each))


def _stands_clear(
    problem: Problem, columns: jax.Array, place: jax.Array, need_m: jax.Array
) -> jax.Array:
    legs = jax.vmap(rock.lines_clear, in_axes=(None, None, 0, 0, None))(
        problem.grid, columns, place[:-1], place[1:], need_m - _ROUNDING_M
    )
    return jnp.all(legs) & rock.within(problem.grid, problem.floor_z_m, place, need_m)


def _bodies(known: ObstacleInformation, horizon_s: float) -> GridTraffic | None:
    """All obstacles that are known, those that stand among them, as spheres along timed ways."""
    if known.radius_m.shape[-1] == 0:
        return None
    moving = bodies_traffic(known, horizon_s)
    if not known.some_stand:
        return moving
    still = GridTraffic(
        time_s=jnp.zeros_like(known.radius_m)[:, None],
        position_m=known.p_m[:, :1],
        reach_m=known.radius_m,
        until_s=jnp.where(known.exists & ~known.moves, jnp.inf, -1.0).astype(moving.reach_m.dtype),
    )
    return beside(moving, still)


def _passes(bodies: GridTraffic, path: Trajectory) -> jax.Array:
    """Whether a path meets no body until it is over and a little after; bool []."""
    place = jnp.concatenate([path.position_m, path.position_m[-1:]])
    time = jnp.append(path.time_s, path.time_s[-1] + STANDS_S)
    legs = jax.vmap(clear_of, in_axes=(None, 0, 0, 0, 0))(
        bodies, place[:-1], time[:-1], place[1:], time[1:]
    )
    return jnp.all(legs)


def choose(
    problem: Problem, given: Candidates, config: RepairConfig, worse: jax.Array | None = None
) -> Trajectory:
    """Paths [R] of one team, no two of which meet; ``found`` is who has one.

    Args:
        problem: of the world.
        given: what its robots may take.
        config: static.
        worse: [R, C] by which arrivals are multiplied before the first of them is taken; nothing
            if left out.
    """
    team = problem.team
    robots, _, count = given.paths.time_s.shape
    reach = team.radius_m[:, None] + team.radius_m + config.margin_m
    held = hold(team.start_m, count)
    length = jnp.sqrt(jnp.sum((team.goal_m - team.start_m) ** 2, axis=-1))
    needs = length / team.cruise_speed_mps
    meets = partial(meets_starts, horizon_s=problem.horizon_s)
    alone = ~jnp.eye(robots, dtype=bool)
    cost = given.paths.time_s[..., -1] * (1.0 if worse is None else worse)

    def place(
        number: int, state: tuple[Trajectory, jax.Array, jax.Array]
    ) -> tuple[Trajectory, jax.Array, jax.Array]:
        plans, settled, order = state
        i = order[number]
        mine: Trajectory = jax.tree.map(lambda leaf: leaf[i], given.paths)
        traffic = GridTraffic(
            time_s=plans.time_s,
            position_m=plans.position_m,
            reach_m=reach[i],
            until_s=jnp.where(settled, jnp.inf, -1.0).at[i].set(-1.0).astype(reach.dtype),
        )
        met = jax.vmap(lambda path: jnp.any(met_by(path, traffic)))(mine)
        fits = mine.found & ~met
        best = jnp.argmin(jnp.where(fits, cost[i], jnp.inf))
        path = jax.tree.map(lambda leaf: leaf[best], mine)
        none = jax.tree.map(lambda leaf: leaf[i], held)
        path = jax.tree.map(lambda a, b: jnp.where(fits[best], a, b), path, none)
        plans = jax.tree.map(lambda many, one: many.at[i].set(one), plans, path)
        return plans, settled.at[i].set(True), order

    def a_round(
        state: tuple[Trajectory, jax.Array], _: None
    ) -> tuple[tuple[Trajectory, jax.Array], None]:
        best, late = state
        order = jnp.argsort(-(late * 1e6 + needs))
        begun = (held, jnp.zeros((robots,), bool), order)
        plans, _, _ = jax.lax.fori_loop(0, robots, place, begun)
        met = jax.vmap(meets)(plans, team.start_m[None].repeat(robots, 0), reach) & alone
        kept = standing(plans.found, met)
        flown = replace(only(kept, plans, held), found=kept)
        more = jnp.sum(kept) > jnp.sum(best.found)
        best = jax.tree.map(lambda a, b: jnp.where(more, a, b), flown, best)
        return (best, late + ~kept), None

    (best, _), _ = jax.lax.scan(
        a_round, (held, jnp.zeros((robots,), needs.dtype)), None, length=config.rounds
    )
    return best
