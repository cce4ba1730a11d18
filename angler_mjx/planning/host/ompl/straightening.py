"""Compiled: a team's path made straighter, and told by fewer points."""

import math
from typing import NamedTuple

import numpy as np

from angler_mjx.planning.host.compiled.compiling import compiled
from angler_mjx.planning.host.compiled.packed import Fields, fields
from angler_mjx.planning.host.compiled.sweeping import one_clear, way_clear
from angler_mjx.planning.host.ompl.still import SAFE
from angler_mjx.planning.host.timed import timed_edge

PIECES = 24
"""Into which a path is cut, at least; more where it has more points."""

FLOW = 0.1
"""Weight of all robots' ways beside the slowest one's."""

ROUNDING = 1e-9
"""Share of a cost that adding up may take away."""

SAME = 1e-9
SAME_SHARE = 1e-5
"""By how much, and by what share of a coordinate, places on a line may lie beside it."""


class SmoothingProblem(NamedTuple):
    """What edges are looked at among: those of a team, or one robot's in space and time."""

    head: np.ndarray
    reals: np.ndarray
    cells: np.ndarray
    """These of `compiled.packed.Packed`."""
    time_s: np.ndarray
    position_m: np.ndarray
    radius_m: np.ndarray
    """These of `timed.Traffic`."""
    clock_mps: float
    """Over which the fourth number of a place is its time; 0: places have no time."""


@compiled
def _goes(ways: SmoothingProblem, world: Fields, a: np.ndarray, b: np.ndarray) -> bool:
    """Whether all can go from a [R, d] to b, where they can be."""
    if ways.clock_mps > 0.0:
        gone = b[0, 3] - a[0, 3]
        if not (gone > 0.0 and _length(a, b, 0) <= SAFE * gone):
            return False
        begin, end = a[0, 3] / ways.clock_mps, b[0, 3] / ways.clock_mps
        return timed_edge(
            ways.head, ways.reals, ways.cells, ways.time_s, ways.position_m, ways.radius_m,
            0, a[0, :3], begin, b[0, :3], end,
        )  # fmt: skip
    return way_clear(world, ways.cells, _flat(a), _flat(b))


@compiled
def _flat(p: np.ndarray) -> np.ndarray:
    """Places [3 R] of [R, d]."""
    if p.shape[1] == 3:
        return p.reshape(p.size)
    return p[:, :3].copy().reshape(3 * p.shape[0])


@compiled
def _length(a: np.ndarray, b: np.ndarray, robot: int) -> float:
    x, y, z = b[robot, 0] - a[robot, 0], b[robot, 1] - a[robot, 1], b[robot, 2] - a[robot, 2]
    return math.sqrt(x * x + y * y + z * z)


@compiled
def _cost(a: np.ndarray, b: np.ndarray, speed: np.ndarray) -> float:
    """Of an edge: time of the slowest robot, s, and a little of all robots'."""
    robots = a.shape[0]
    most, total = 0.0, 0.0
    for robot in range(robots):
        took = _length(a, b, robot) / speed[robot]
        most = max(most, took)
        total += took
    slowest: float = most + FLOW * (total / robots)
    return slowest


@compiled
def cost(path: np.ndarray, speed: np.ndarray) -> float:
    """Of a path [k, R, d]."""
    total = 0.0
    for k in range(path.shape[0] - 1):
        total += _cost(path[k], path[k + 1], speed)
    return total


@compiled
def _picked(path: np.ndarray, before: np.ndarray) -> np.ndarray:
    """The points of a way from the first to the last, of each of which is known which is before."""
    count, at = 1, path.shape[0] - 1
    while at != 0:
        at = before[at]
        count += 1
    found, at = np.empty((count, path.shape[1], path.shape[2])), path.shape[0] - 1
    for n in range(count - 1, -1, -1):
        found[n] = path[at]
        at = before[at]
    return found


@compiled
def _through(
    ways: SmoothingProblem, world: Fields, path: np.ndarray, ends: np.ndarray, speed: np.ndarray
) -> np.ndarray:
    """The quickest way through the points, in their order, from the first to the last.

    An edge is looked at only where it would be quicker, and where the way through it, straight on
    to the last point, would be no slower than the quickest that is known. Points to ``ends`` [k] of
    each lie on one edge that is free. From the first straight to the last there is no way.
    """
    last = path.shape[0] - 1
    before, least = np.zeros(last + 1, np.int64), np.zeros(last + 1)
    if last == 1:
        return path
    left = np.zeros(last + 1)
    for k in range(last - 1, -1, -1):
        left[k] = left[k + 1] + _cost(path[k], path[k + 1], speed)
    known = left[0]
    for k in range(1, last + 1):
        best, at = least[k - 1] + _cost(path[k - 1], path[k], speed), k - 1
        most = known * (1.0 + ROUNDING) - _cost(path[k], path[last], speed)
        for i in range(k - 1):
            taken = least[i] + _cost(path[i], path[k], speed)
            quicker = taken < best or (taken == best and at == k - 1)
            if not quicker or taken > most or (i == 0 and k == last):
                continue
            if ends[i] >= k or _goes(ways, world, path[i], path[k]):
                best, at = taken, i
        least[k], before[k] = best, at
        known = min(known, best + left[k])
    return _picked(path, before)


@compiled
def _own_ends(count: int) -> np.ndarray:
    """Of points that each begin an edge of their own."""
    return np.minimum(np.arange(count) + 1, count - 1)


@compiled
def _cut(path: np.ndarray, speed: np.ndarray, pieces: int) -> tuple[np.ndarray, np.ndarray]:
    """The path with points between its own, evenly in time; and to which each one's edge goes."""
    edges = path.shape[0] - 1
    total = max(cost(path, speed), 1e-9)
    parts = np.empty(edges, np.int64)
    for k in range(edges):
        parts[k] = max(1, round(pieces * _cost(path[k], path[k + 1], speed) / total))
    count = parts.sum() + 1
    found, ends = np.empty((count, path.shape[1], path.shape[2])), np.empty(count, np.int64)
    at = 0
    for k in range(edges):
        for n in range(parts[k]):
            found[at + n] = path[k] + (path[k + 1] - path[k]) * (n / parts[k])
            ends[at + n] = at + parts[k]
        at += parts[k]
    found[at], ends[at] = path[edges], at
    return found, ends


@compiled
def _lined_up(path: np.ndarray, begin: int, end: int, robot: int, tried: np.ndarray) -> bool:
    """Puts one robot on a line from begin to end in ``tried``; whether that changes anything."""
    last, moved = end - begin, False
    step = 1.0 / last
    for n in range(last + 1):
        share = 1.0 if n == last else n * step
        for c in range(path.shape[2]):
            first = path[begin, robot, c]
            x, was = first + share * (path[end, robot, c] - first), path[begin + n, robot, c]
            tried[n, robot, c] = x
            moved = moved or not abs(x - was) <= SAME + SAME_SHARE * abs(was)
    return moved


@compiled
def _straight_for_one(
    ways: SmoothingProblem, world: Fields, path: np.ndarray, begin: int, end: int, robot: int
) -> None:
    """Puts one robot on a line from begin to end where it may go there, as the others go."""
    tried = path[begin : end + 1].copy()
    if not _lined_up(path, begin, end, robot, tried):
        return
    for n in range(end - begin):
        if not one_clear(world, ways.cells, _flat(tried[n]), _flat(tried[n + 1]), robot):
            return
    path[begin : end + 1] = tried


@compiled
def _one_by_one(ways: SmoothingProblem, world: Fields, path: np.ndarray) -> None:
    """Each robot straight over as much of the path as can be, the others as they go.

    Tried are the whole, its halves, quarters and eighths, each with those between.
    """
    last = path.shape[0] - 1
    for robot in range(path.shape[1]):
        for parts in (1, 2, 4, 8):
            size = last // parts
            if size < 2:
                break
            for begin in range(0, last - size + 1, max(1, size // 2)):
                _straight_for_one(ways, world, path, begin, begin + size, robot)


@compiled
def through(ways: SmoothingProblem, path: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """The quickest way through the points of a path [k, R, d], of speeds [R] m/s."""
    world = fields(ways.head, ways.reals)
    last = path.shape[0] - 1
    if last > 1 and _goes(ways, world, path[0], path[last]):
        return _picked(path, np.zeros(last + 1, np.int64))
    return _through(ways, world, path, _own_ends(path.shape[0]), speed)


@compiled
def straighter(
    ways: SmoothingProblem, path: np.ndarray, speed: np.ndarray
) -> tuple[np.ndarray, float, float]:
    """A round, where no way goes straight to the goal: the path, and its cost before and after."""
    world = fields(ways.head, ways.reals)
    before = cost(path, speed)
    path, ends = _cut(path, speed, PIECES)
    path = _through(ways, world, path, ends, speed)
    if path.shape[1] > 1:
        _one_by_one(ways, world, path)
        path = _through(ways, world, path, _own_ends(path.shape[0]), speed)
    return path, before, cost(path, speed)


@compiled
def fewer(
    ways: SmoothingProblem, path: np.ndarray, speed: np.ndarray, most: int, pieces: int
) -> np.ndarray:
    """The quickest way through points of a path with at most ``most`` of them; none: no rows.

    Args:
        ways: what edges are looked at among.
        path: [k, R, d]; its own edges are free.
        speed: [R] m/s.
        most: points of the way; 2 or more.
        pieces: into which the path is cut before, at least; 0: not at all.
    """
    world = fields(ways.head, ways.reals)
    ends = _own_ends(path.shape[0])
    if pieces > 0:
        path, ends = _cut(path, speed, pieces)
    count = path.shape[0]
    least = np.full((most, count), np.inf)
    before = np.zeros((most, count), np.int64)
    least[0, 0] = 0.0
    for k in range(1, count):
        for i in range(k):
            if not (ends[i] >= k or _goes(ways, world, path[i], path[k])):
                continue
            more = _cost(path[i], path[k], speed)
            for n in range(1, most):
                if least[n - 1, i] + more < least[n, k]:
                    least[n, k], before[n, k] = least[n - 1, i] + more, i
    n = int(np.argmin(least[:, count - 1]))
    if not least[n, count - 1] < np.inf:
        return path[:0].copy()
    found, at = np.empty((n + 1, path.shape[1], path.shape[2])), count - 1
    for row in range(n, -1, -1):
        found[row] = path[at]
        at = before[row, at]
    return found
