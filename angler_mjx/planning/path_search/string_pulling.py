"""String-pulling: from a path over cells to few way-points, at cruise speed where that is clear.

The path over cells is a clear timetable. The pulled path goes ahead of it: a straight segment is
taken only if it is clear of rock and, at its new times, of all that moves, and if the robot can
stand at its end until the timetable leaves there. So the timetable can be resumed at every
way-point, and necessary waits remain.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from angler_kernels.rows import write_row
from angler_mjx.planning.path_search.batching import min_of_batch
from angler_mjx.planning.path_search.bodies import GOAL_CLEAR_S
from angler_mjx.planning.path_search.lattice import Terrain, line_of_sight
from angler_mjx.planning.path_search.tracing import Route
from angler_mjx.planning.path_search.traffic import GridTraffic, PlannedTraffic, is_motion_clear
from angler_mjx.robot.control.commands.trajectory import Trajectory


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _String:
    """A segment from ``from_m``, left at ``from_s``, to ``to_m``, reached at ``to_s``."""

    from_m: jax.Array
    from_s: jax.Array
    to_m: jax.Array
    to_s: jax.Array
    leave_s: jax.Array
    """When the timetable leaves ``to_m``."""


@dataclass(frozen=True, kw_only=True)
class _RouteRow:
    """Of a route."""

    position_m: jax.Array
    arrive_s: jax.Array
    leave_s: jax.Array
    leave_to_bodies_s: jax.Array
    """Until then bodies must not meet the robot there."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class _Knot:
    """An end of a segment that stays in the path."""

    keep: jax.Array
    position_m: jax.Array
    arrive_s: jax.Array
    leave_s: jax.Array


def pull_string(
    land: Terrain,
    others: PlannedTraffic,
    route: Route,
    clearance_m: jax.Array,
    speed_mps: jax.Array,
    n_point: int,
) -> Trajectory:
    """Pull one robot's route straight.

    Args:
        land: the world.
        others: traffic.
        route: K rows, a timetable no faster than the cruise speed, ending with the time up to which
            the robot must be able to stand at its goal.
        clearance_m: [] to keep from cells and obstacles.
        speed_mps: [] cruise speed.
        n_point: way-points of the result.

    Returns:
        Trajectory of ``n_point`` rows; ``found`` is False where they are too few or the route is
        not clear.
    """
    begin = _String(
        from_m=route.position_m[0],
        from_s=jnp.zeros_like(speed_mps),
        to_m=route.position_m[0],
        to_s=jnp.zeros_like(speed_mps),
        leave_s=route.leave_s[0],
    )
    size = route.arrive_s.shape[0]
    empty = _Knot(
        keep=jnp.zeros((size,), bool),
        position_m=jnp.zeros_like(route.position_m),
        arrive_s=jnp.zeros_like(route.arrive_s),
        leave_s=jnp.zeros_like(route.leave_s),
    )

    # Bodies pass by a robot that has long arrived; other robots must not meet it for ever.
    leave_to_bodies = jnp.append(route.leave_s[:-1], route.arrive_s[-1] + GOAL_CLEAR_S)

    def lengthen(k: jax.Array, state: tuple[_String, _Knot]) -> tuple[_String, _Knot]:
        string, knots = state
        row = _RouteRow(
            position_m=route.position_m[k],
            arrive_s=route.arrive_s[k],
            leave_s=route.leave_s[k],
            leave_to_bodies_s=leave_to_bodies[k],
        )
        string, knot = _extend_string(land, others, clearance_m, speed_mps, string, row)
        return string, write_row(knots, knot, k - 1)

    first = min_of_batch(jnp.maximum(route.begin, 1))
    string, knots = jax.lax.fori_loop(first, size, lengthen, (begin, empty))
    end = _Knot(
        keep=jnp.array(True), position_m=string.to_m, arrive_s=string.to_s, leave_s=string.to_s
    )
    knots = write_row(knots, end, size - 1)
    path = _collect_waypoints(route.position_m[0], knots, n_point)
    is_clear = is_path_clear(others.robots, path, route.leave_s[-1])
    if others.bodies is not None:
        is_clear &= is_path_clear(others.bodies, path, path.time_s[-1] + GOAL_CLEAR_S)
    return replace(path, found=path.found & route.whole & is_clear)


def is_path_clear(traffic: GridTraffic, path: Trajectory, until_s: jax.Array) -> jax.Array:
    """Return whether a whole path keeps clear, and then its end until ``until_s``.

    The timetable's own legs were proved by the search; this proves all of them once more, exactly.
    """
    position_m = jnp.concatenate([path.position_m, path.position_m[-1:]])
    time = jnp.concatenate([path.time_s, jnp.maximum(path.time_s[-1:], until_s)])
    legs = jax.vmap(is_motion_clear, in_axes=(None, 0, 0, 0, 0))(
        traffic, position_m[:-1], time[:-1], position_m[1:], time[1:]
    )
    return jnp.all(legs)


def _extend_string(
    land: Terrain,
    others: PlannedTraffic,
    clearance_m: jax.Array,
    speed_mps: jax.Array,
    string: _String,
    row: _RouteRow,
) -> tuple[_String, _Knot]:
    """Draw the string on to the route's next row, or knot it at its present end first."""
    goal, arrive, leave = row.position_m, row.arrive_s, row.leave_s
    starts = jnp.stack([string.from_m, string.to_m])
    departs = jnp.stack([string.from_s, string.to_s])
    gap = goal - starts
    arrives = departs + jnp.sqrt(jnp.sum(gap * gap, axis=-1)) / speed_mps
    # Each way is a motion followed by standing at its end: four motions in one test.
    goals = jnp.broadcast_to(goal, (2, 3))

    def all_clear(traffic: GridTraffic, until: jax.Array) -> jax.Array:
        is_clear = jax.vmap(is_motion_clear, in_axes=(None, 0, 0, 0, 0))(
            traffic,
            jnp.concatenate([starts, goals]),
            jnp.concatenate([departs, arrives]),
            jnp.concatenate([goals, goals]),
            jnp.concatenate([arrives, jnp.maximum(arrives, until)]),
        )
        return is_clear[:2] & is_clear[2:]

    is_clear = all_clear(others.robots, leave)
    if others.bodies is not None:
        is_clear &= all_clear(others.bodies, row.leave_to_bodies_s)
    is_visible = jax.vmap(line_of_sight, in_axes=(None, 0, None, None))(
        land, starts, goal, clearance_m
    )
    straight, at_once = is_clear[0] & is_visible[0], is_clear[1] & is_visible[1]
    go = jnp.where(at_once, string.to_s, string.leave_s)
    knot = _Knot(keep=~straight, position_m=string.to_m, arrive_s=string.to_s, leave_s=go)
    return (
        _String(
            from_m=jnp.where(straight, string.from_m, string.to_m),
            from_s=jnp.where(straight, string.from_s, go),
            to_m=goal,
            to_s=jnp.where(straight, arrives[0], jnp.where(at_once, arrives[1], arrive)),
            leave_s=leave,
        ),
        knot,
    )


def _collect_waypoints(start: jax.Array, knots: _Knot, n_point: int) -> Trajectory:
    """Collect the kept knots with arrivals and departures into ``n_point`` rows."""
    time = jnp.stack([knots.arrive_s, knots.leave_s], axis=1).reshape(-1)
    position_m = jnp.repeat(knots.position_m, 2, axis=0)
    time = jnp.where(jnp.repeat(knots.keep, 2), time, 0.0)
    before = jnp.concatenate([jnp.zeros((1,), time.dtype), jax.lax.cummax(time)[:-1]])
    is_new = time > before
    rank = jnp.cumsum(is_new)
    count = rank[-1]
    row = jnp.minimum(jnp.arange(n_point), count)
    # One-hot rows: each sum has one term, so it is exact.
    is_picked = (rank == row[:, None]) & is_new
    times = jnp.sum(jnp.where(is_picked, time, 0.0), axis=1)
    positions_m = jnp.sum(jnp.where(is_picked[..., None], position_m, 0.0), axis=1)
    return Trajectory(
        time_s=times,
        position_m=jnp.where((row == 0)[:, None], start, positions_m),
        found=count < n_point,
    )
