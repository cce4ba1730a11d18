"""Compiled: straightening of a team's path, and reduction of its points."""

import math
from typing import NamedTuple

import numpy as np

from angler_mjx.planning.host.compiled.compiling import compile_function
from angler_mjx.planning.host.compiled.packed import PackedFields, unpack_fields
from angler_mjx.planning.host.compiled.sweeping import is_motion_clear, is_robot_clear
from angler_mjx.planning.host.ompl.still_water_timing import SPEED_FACTOR
from angler_mjx.planning.host.timed import timed_edge

PIECES = 24
"""Into which a path is cut, at least; more where it has more points."""

TOTAL_TIME_WEIGHT = 0.1
"""Weight of the time of all robots beside that of the slowest one."""

ROUNDING = 1e-9
"""Share of a cost that adding up may take away."""

SAME = 1e-9
SAME_FRACTION = 1e-5
"""Tolerance of positions on a line, in m and as a fraction of a coordinate."""


class SmoothingProblem(NamedTuple):
    """Problem against which edges are checked: of a team, or of one robot in space and time."""

    head: np.ndarray
    reals: np.ndarray
    cells: np.ndarray
    """These of `compiled.packed.PackedProblem`."""
    time_s: np.ndarray
    position_m: np.ndarray
    radius_m: np.ndarray
    """These of `timed.Traffic`."""
    clock_mps: float
    """Over which the fourth number of a place is its time; 0: places have no time."""


@compile_function
def _is_edge_free(
    smoothing: SmoothingProblem, world: PackedFields, a: np.ndarray, b: np.ndarray
) -> bool:
    """Return whether all can go from a [R, d] to b, both of which are valid."""
    if smoothing.clock_mps > 0.0:
        clock_m = b[0, 3] - a[0, 3]
        if not (clock_m > 0.0 and _edge_length(a, b, 0) <= SPEED_FACTOR * clock_m):
            return False
        begin, end = a[0, 3] / smoothing.clock_mps, b[0, 3] / smoothing.clock_mps
        return timed_edge(
            smoothing.head, smoothing.reals, smoothing.cells,
            smoothing.time_s, smoothing.position_m, smoothing.radius_m,
            0, a[0, :3], begin, b[0, :3], end,
        )  # fmt: skip
    return is_motion_clear(world, smoothing.cells, _flatten_positions(a), _flatten_positions(b))


@compile_function
def _flatten_positions(p: np.ndarray) -> np.ndarray:
    """Return the positions [3 R] of states [R, d]."""
    if p.shape[1] == 3:
        return p.reshape(p.size)
    return p[:, :3].copy().reshape(3 * p.shape[0])


@compile_function
def _edge_length(a: np.ndarray, b: np.ndarray, robot: int) -> float:
    x, y, z = b[robot, 0] - a[robot, 0], b[robot, 1] - a[robot, 1], b[robot, 2] - a[robot, 2]
    return math.sqrt(x * x + y * y + z * z)


@compile_function
def _edge_cost(a: np.ndarray, b: np.ndarray, speed: np.ndarray) -> float:
    """Return the time of the slowest robot, s, and a little of that of all robots."""
    robots = a.shape[0]
    slowest_s, total = 0.0, 0.0
    for robot in range(robots):
        robot_s = _edge_length(a, b, robot) / speed[robot]
        slowest_s = max(slowest_s, robot_s)
        total += robot_s
    slowest: float = slowest_s + TOTAL_TIME_WEIGHT * (total / robots)
    return slowest


@compile_function
def path_cost(path: np.ndarray, speed: np.ndarray) -> float:
    """Return the cost of a path [k, R, d]."""
    total = 0.0
    for k in range(path.shape[0] - 1):
        total += _edge_cost(path[k], path[k + 1], speed)
    return total


@compile_function
def _backtrack(path: np.ndarray, predecessors: np.ndarray) -> np.ndarray:
    """Return the points of a path from first to last by the predecessor of each."""
    count, at = 1, path.shape[0] - 1
    while at != 0:
        at = predecessors[at]
        count += 1
    points, at = np.empty((count, path.shape[1], path.shape[2])), path.shape[0] - 1
    for n in range(count - 1, -1, -1):
        points[n] = path[at]
        at = predecessors[at]
    return points


@compile_function
def _shortest_through(
    smoothing: SmoothingProblem,
    world: PackedFields,
    path: np.ndarray,
    ends: np.ndarray,
    speed: np.ndarray,
) -> np.ndarray:
    """Return the quickest path through points in their order, from the first to the last.

    An edge is looked at only where it would be quicker, and where the way through it, straight on
    to the last point, would be no slower than the quickest that is known. Points to ``ends`` [k] of
    each lie on one edge that is free. From the first straight to the last there is no way.
    """
    last = path.shape[0] - 1
    predecessors, best_costs = np.zeros(last + 1, np.int64), np.zeros(last + 1)
    if last == 1:
        return path
    remaining_costs = np.zeros(last + 1)
    for k in range(last - 1, -1, -1):
        remaining_costs[k] = remaining_costs[k + 1] + _edge_cost(path[k], path[k + 1], speed)
    upper_bound = remaining_costs[0]
    for k in range(1, last + 1):
        best, at = best_costs[k - 1] + _edge_cost(path[k - 1], path[k], speed), k - 1
        max_cost = upper_bound * (1.0 + ROUNDING) - _edge_cost(path[k], path[last], speed)
        for i in range(k - 1):
            new_cost = best_costs[i] + _edge_cost(path[i], path[k], speed)
            quicker = new_cost < best or (new_cost == best and at == k - 1)
            if not quicker or new_cost > max_cost or (i == 0 and k == last):
                continue
            if ends[i] >= k or _is_edge_free(smoothing, world, path[i], path[k]):
                best, at = new_cost, i
        best_costs[k], predecessors[k] = best, at
        upper_bound = min(upper_bound, best + remaining_costs[k])
    return _backtrack(path, predecessors)


@compile_function
def _next_indices(count: int) -> np.ndarray:
    """Return the next indices of points that each begin an edge of their own."""
    return np.minimum(np.arange(count) + 1, count - 1)


@compile_function
def _subdivide(path: np.ndarray, speed: np.ndarray, pieces: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the path with further points, evenly in time, and the end of each point's edge."""
    edges = path.shape[0] - 1
    total = max(path_cost(path, speed), 1e-9)
    parts = np.empty(edges, np.int64)
    for k in range(edges):
        parts[k] = max(1, round(pieces * _edge_cost(path[k], path[k + 1], speed) / total))
    count = parts.sum() + 1
    points, ends = np.empty((count, path.shape[1], path.shape[2])), np.empty(count, np.int64)
    at = 0
    for k in range(edges):
        for n in range(parts[k]):
            points[at + n] = path[k] + (path[k + 1] - path[k]) * (n / parts[k])
            ends[at + n] = at + parts[k]
        at += parts[k]
    points[at], ends[at] = path[edges], at
    return points, ends


@compile_function
def _straighten_robot(
    path: np.ndarray, begin: int, end: int, robot: int, tried: np.ndarray
) -> bool:
    """Put one robot on a line from begin to end in ``tried``; return whether it changes it."""
    last, has_moved = end - begin, False
    step = 1.0 / last
    for n in range(last + 1):
        fraction = 1.0 if n == last else n * step
        for c in range(path.shape[2]):
            first = path[begin, robot, c]
            x, old_x = first + fraction * (path[end, robot, c] - first), path[begin + n, robot, c]
            tried[n, robot, c] = x
            has_moved = has_moved or not abs(x - old_x) <= SAME + SAME_FRACTION * abs(old_x)
    return has_moved


@compile_function
def _straighten_if_free(
    smoothing: SmoothingProblem,
    world: PackedFields,
    path: np.ndarray,
    begin: int,
    end: int,
    robot: int,
) -> None:
    """Put one robot on a line from begin to end if it is free while the others move."""
    tried = path[begin : end + 1].copy()
    if not _straighten_robot(path, begin, end, robot, tried):
        return
    for n in range(end - begin):
        if not is_robot_clear(
            world,
            smoothing.cells,
            _flatten_positions(tried[n]),
            _flatten_positions(tried[n + 1]),
            robot,
        ):
            return
    path[begin : end + 1] = tried


@compile_function
def _straighten_each(smoothing: SmoothingProblem, world: PackedFields, path: np.ndarray) -> None:
    """Straighten each robot over as much of the path as is free, the others unchanged.

    Tried are the whole, its halves, quarters and eighths, each with those between.
    """
    last = path.shape[0] - 1
    for robot in range(path.shape[1]):
        for parts in (1, 2, 4, 8):
            size = last // parts
            if size < 2:
                break
            for begin in range(0, last - size + 1, max(1, size // 2)):
                _straighten_if_free(smoothing, world, path, begin, begin + size, robot)


@compile_function
def shortest_through_points(
    smoothing: SmoothingProblem, path: np.ndarray, speed: np.ndarray
) -> np.ndarray:
    """Return the quickest path through the points of a path [k, R, d], at speeds [R] m/s."""
    world = unpack_fields(smoothing.head, smoothing.reals)
    last = path.shape[0] - 1
    if last > 1 and _is_edge_free(smoothing, world, path[0], path[last]):
        return _backtrack(path, np.zeros(last + 1, np.int64))
    return _shortest_through(smoothing, world, path, _next_indices(path.shape[0]), speed)


@compile_function
def straighten_path(
    smoothing: SmoothingProblem, path: np.ndarray, speed: np.ndarray
) -> tuple[np.ndarray, float, float]:
    """Straighten a path without a free line to the goal; return it, its cost before and after."""
    world = unpack_fields(smoothing.head, smoothing.reals)
    before = path_cost(path, speed)
    path, ends = _subdivide(path, speed, PIECES)
    path = _shortest_through(smoothing, world, path, ends, speed)
    if path.shape[1] > 1:
        _straighten_each(smoothing, world, path)
        path = _shortest_through(smoothing, world, path, _next_indices(path.shape[0]), speed)
    return path, before, path_cost(path, speed)


@compile_function
def reduce_points(
    smoothing: SmoothingProblem, path: np.ndarray, speed: np.ndarray, max_points: int, pieces: int
) -> np.ndarray:
    """Return the quickest path over at most ``max_points`` points of a path; no rows if none.

    Args:
        smoothing: problem of the edge checks.
        path: [k, R, d]; its own edges are free.
        speed: [R] m/s.
        max_points: points of the path; 2 or more.
        pieces: into which the path is cut before, at least; 0: not at all.
    """
    world = unpack_fields(smoothing.head, smoothing.reals)
    ends = _next_indices(path.shape[0])
    if pieces > 0:
        path, ends = _subdivide(path, speed, pieces)
    count = path.shape[0]
    best_costs = np.full((max_points, count), np.inf)
    predecessors = np.zeros((max_points, count), np.int64)
    best_costs[0, 0] = 0.0
    for k in range(1, count):
        for i in range(k):
            if not (ends[i] >= k or _is_edge_free(smoothing, world, path[i], path[k])):
                continue
            edge_cost = _edge_cost(path[i], path[k], speed)
            for n in range(1, max_points):
                if best_costs[n - 1, i] + edge_cost < best_costs[n, k]:
                    best_costs[n, k], predecessors[n, k] = best_costs[n - 1, i] + edge_cost, i
    n = int(np.argmin(best_costs[:, count - 1]))
    if not best_costs[n, count - 1] < np.inf:
        return path[:0].copy()
    points, at = np.empty((n + 1, path.shape[1], path.shape[2])), count - 1
    for row in range(n, -1, -1):
        points[row] = path[at]
        at = predecessors[row, at]
    return points
