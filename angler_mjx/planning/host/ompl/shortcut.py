"""Straightening a team's path, by whole batches of edges.

All points of the path and some between them are tried against each other, and the quickest way
through those that can be joined is taken; then single robots are straightened while the others
keep their ways. Nothing is drawn, so the same path becomes the same.
"""

import time
from collections.abc import Callable

import numpy as np

ROUNDS = 4
"""Of straightening, each from the path of the one before."""

PIECES = 24
"""Into which a path is cut, at least; more where it has more points."""

BETTER = 1e-3
"""Share of its cost by which a round has to shorten a path for another."""

FLOW = 0.1
"""Weight of all robots' ways beside the slowest one's."""

type Edges = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Whether the team can go from each of a to each of b [n, R, 3]; bool [n]."""


def shortened(
    points: np.ndarray, edges: Edges, speed: np.ndarray, looked_at: int, end: float
) -> np.ndarray:
    """A path that is quicker, or as it was.

    Args:
        points: [k, R, d] of the team; x, y, z first.
        edges: looks at the first ``looked_at`` of the d.
        speed: [R] m/s of each robot.
        looked_at: 3.
        end: of `time.perf_counter`; no round begins after it.
    """

    def free(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return edges(a[..., :looked_at], b[..., :looked_at])

    path = _through(points, free, speed)
    for _ in range(ROUNDS):
        if time.perf_counter() > end or len(path) == 2:
            break
        before = cost(path, speed).sum()
        path = _through(_cut(path, speed), free, speed)
        path = _one_by_one(path, free)
        path = _through(path, free, speed)
        if cost(path, speed).sum() > (1.0 - BETTER) * before:
            break
    return path


def cost(path: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Of each edge [k - 1]: time of the slowest robot, s, and a little of all robots'."""
    return _cost(path[:-1], path[1:], speed)


def _cost(a: np.ndarray, b: np.ndarray, speed: np.ndarray) -> np.ndarray:
    took = np.linalg.norm((b - a)[..., :3], axis=-1) / speed
    return np.asarray(took.max(axis=-1) + FLOW * took.mean(axis=-1))


def _through(path: np.ndarray, free: Edges, speed: np.ndarray) -> np.ndarray:
    """The quickest way through the points, in their order, from the first to the last."""
    count = len(path)
    if count == 2:
        return path
    if free(path[:1], path[-1:])[0]:
        return path[[0, -1]]
    i, j = np.triu_indices(count, 2)
    joined = free(path[i], path[j])
    price = np.full((count, count), np.inf)
    price[i, j] = np.where(joined, _cost(path[i], path[j], speed), np.inf)
    steps = np.arange(count - 1)
    price[steps, steps + 1] = cost(path, speed)
    least, before = np.full(count, np.inf), np.zeros(count, int)
    least[0] = 0.0
    for k in range(1, count):
        through = least[:k] + price[:k, k]
        before[k] = int(np.argmin(through))
        least[k] = through[before[k]]
    kept = [count - 1]
    while kept[-1] != 0:
        kept.append(int(before[kept[-1]]))
    return path[kept[::-1]]


def _cut(path: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """The path with points between its own, evenly in time."""
    spent = cost(path, speed)
    total = spent.sum()
    pieces = np.maximum(1, np.round(PIECES * spent / max(total, 1e-9))).astype(int)
    parts = [
        a + (b - a) * (np.arange(n) / n)[:, None, None]
        for a, b, n in zip(path[:-1], path[1:], pieces, strict=True)
    ]
    return np.concatenate([*parts, path[-1:]])


def _one_by_one(path: np.ndarray, free: Edges) -> np.ndarray:
    """Each robot straight over as much of the path as can be, the others as they go."""
    count, robots = path.shape[:2]
    if robots == 1:
        return path
    path = path.copy()
    for robot in range(robots):
        for begin, end in _spans(count - 1):
            tried = path[begin : end + 1].copy()
            share = np.linspace(0.0, 1.0, end - begin + 1)[:, None]
            line = tried[0, robot] + share * (tried[-1, robot] - tried[0, robot])
            if np.allclose(line, tried[:, robot], atol=1e-9):
                continue
            tried[:, robot] = line
            if free(tried[:-1], tried[1:]).all():
                path[begin : end + 1] = tried
    return path


def _spans(last: int) -> list[tuple[int, int]]:
    """The whole, its halves, quarters and eighths, each with those between."""
    found = []
    for parts in (1, 2, 4, 8):
        size = last // parts
        if size < 2:
            break
        step = max(1, size // 2)
        found += [(begin, begin + size) for begin in range(0, last - size + 1, step)]
    return found
