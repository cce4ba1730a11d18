"""Contact pairs of a world: distances of all pairs that can have been the nearest.

Bounding spheres come first. They select the pairs that can be nearer than the known ones, or can
touch; only those are computed, capsule by capsule.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from angler_mjx.testing.referee.geometry import (
    Floats,
    rotate,
    rotate_back,
    segment_box,
    segment_point,
    segment_segment,
)
from angler_mjx.testing.referee.record import RefereeWorld
from angler_mjx.testing.referee.vehicles import RefereeHull

CELL, FLOOR, OBSTACLE, ROBOT = 0, 1, 2, 3
"""Kinds of objects, in order of priority at equal distance."""

SEPARATION_M = 1.0
"""Limit of known separations of robots; also the value where no robot is nearer."""

SPHERE, BOX, CAPSULE = 0, 1, 2
STILL = 0
"""Motion kind of a still obstacle."""

_BATCH_SIZE = 50_000
_NARROW_BATCH_SIZE = 20_000

type Ints = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class ContactPairs:
    """Pairs of a robot's state and an object; [n] leads."""

    state: Ints
    robot: Ints
    kind: Ints
    index: Ints
    """Index of the cell (flat), obstacle or robot; 0 for the floor."""
    gap_m: Floats
    """Distance of the hulls, or a lower bound of the distance."""

    def take(self, chosen: NDArray[np.bool_] | Ints) -> "ContactPairs":
        """Return a selection of the pairs."""
        return ContactPairs(
            state=self.state[chosen],
            robot=self.robot[chosen],
            kind=self.kind[chosen],
            index=self.index[chosen],
            gap_m=self.gap_m[chosen],
        )

    @staticmethod
    def join(parts: "list[ContactPairs]") -> "ContactPairs":
        """Return the concatenation of pairs."""
        names = ("state", "robot", "kind", "index")
        whole = {
            n: np.concatenate([np.zeros(0, int), *(getattr(p, n) for p in parts)]) for n in names
        }
        return ContactPairs(gap_m=np.concatenate([np.zeros(0), *(p.gap_m for p in parts)]), **whole)


@dataclass(frozen=True, kw_only=True)
class NearbyPairs:
    """Nearby pairs of one world."""

    pairs: ContactPairs
    """All pairs that can have been nearest or can have touched, with their distances."""
    cap_m: Floats
    """[R] limit of known distances to cells, and of the clearance."""

    def clearance_m(self, robot: int, last: int) -> float:
        """Return the min distance to cells, floor and obstacles in the states up to ``last``."""
        selected = self._select_pairs(robot, last) & (self.pairs.kind != ROBOT)
        return float(min(self.cap_m[robot], np.min(self.pairs.gap_m[selected], initial=np.inf)))

    def separation_m(self, robot: int, last: int) -> float:
        """Return the min distance to another robot, up to `SEPARATION_M`; inf without others."""
        if self.cap_m.size == 1:
            return float("inf")
        selected = self._select_pairs(robot, last) & (self.pairs.kind == ROBOT)
        return float(min(SEPARATION_M, np.min(self.pairs.gap_m[selected], initial=np.inf)))

    def of(self, robot: int) -> ContactPairs:
        """Return all pairs of a robot."""
        return self.pairs.take(self.pairs.robot == robot)

    def _select_pairs(self, robot: int, last: int) -> NDArray[np.bool_]:
        selected: NDArray[np.bool_] = (self.pairs.robot == robot) & (self.pairs.state <= last)
        return selected


def find_nearby(
    world: RefereeWorld, hulls: tuple[RefereeHull, ...], last: Ints, slack_m: float
) -> NearbyPairs:
    """Compute the nearby pairs.

    Args:
        world: its record.
        hulls: [R] of the robots.
        last: [R] last relevant state of each.
        slack_m: pairs farther than the nearest by no more than this are kept as well.
    """
    narrow = _NarrowPhase(world, hulls)
    reach = narrow.reach_m(last)
    cap = float(world.environment["grid/cell_m"]) - reach
    candidates = ContactPairs.join(list(_find_candidates(world, reach, last, cap)))
    robots = candidates.kind == ROBOT
    parts = []
    for pairs, limit in (
        (candidates.take(~robots), cap),
        (candidates.take(robots), np.full(cap.size, SEPARATION_M)),
    ):
        # The pair with the min bound of each robot limits the distance from below.
        order = np.argsort(pairs.gap_m, kind="stable")
        first = order[np.unique(pairs.robot[order], return_index=True)[1]]
        nearest = narrow.gaps(pairs.take(first))
        min_gap_m = limit.copy()
        np.minimum.at(min_gap_m, nearest.robot, nearest.gap_m)
        is_candidate = pairs.gap_m <= np.maximum(min_gap_m, 0.0)[pairs.robot] + slack_m
        parts.append(narrow.gaps(pairs.take(is_candidate)))
    return NearbyPairs(pairs=ContactPairs.join(parts), cap_m=cap)


def _find_candidates(
    world: RefereeWorld, reach: Floats, last: Ints, cap: Floats
) -> Iterator[ContactPairs]:
    """Yield the pairs whose bounding spheres are near enough to be known at all."""
    is_judged = np.arange(len(world.step))[:, None] <= last[None, :]
    state, robot = (axis.astype(np.int64) for axis in np.nonzero(is_judged))
    for begin in range(0, state.size, _BATCH_SIZE):
        s, r = state[begin : begin + _BATCH_SIZE], robot[begin : begin + _BATCH_SIZE]
        p = world.p[s, r]
        yield from _find_cells(world, s, r, p, reach[r], cap[r])
        floor = p[:, 2] - reach[r] - float(world.environment["floor_z_m"])
        is_near = floor <= cap[r]
        yield _build_pairs(
            s[is_near], r[is_near], FLOOR, np.zeros(int(is_near.sum()), int), floor[is_near]
        )
        if world.obstacle_p.shape[1]:
            bound = np.linalg.norm(p[:, None] - world.obstacle_p[s], axis=2)
            bound -= reach[r][:, None] + _obstacle_reach(world)[None, :]
            row, index = np.nonzero(
                (bound <= cap[r][:, None]) & world.environment["obstacles/exists"]
            )
            yield _build_pairs(s[row], r[row], OBSTACLE, index, bound[row, index])
    yield from _find_robots(world, reach, last)


def _build_pairs(state: Ints, robot: Ints, kind: int, index: Ints, gap_m: Floats) -> ContactPairs:
    kinds = np.full(state.size, kind, np.int64)
    return ContactPairs(
        state=state, robot=robot, kind=kinds, index=index.astype(np.int64), gap_m=gap_m
    )


def _find_cells(
    world: RefereeWorld, state: Ints, robot: Ints, p: Floats, reach: Floats, cap: Floats
) -> Iterator[ContactPairs]:
    """Yield occupied cells among the 27 around each centre: no other is nearer than the cap."""
    occupied = world.environment["grid/occupied"]
    edge = float(world.environment["grid/cell_m"])
    cell_index = np.floor((p - world.low_m) / edge).astype(np.int64)
    inside = np.all((cell_index >= -1) & (cell_index <= np.array(occupied.shape)), axis=1)
    if not inside.any() or not occupied.any():
        return
    state, robot, cell_index = state[inside], robot[inside], cell_index[inside]
    reach, cap = reach[inside], cap[inside]
    rest = p[inside] - world.low_m - edge * cell_index
    padded = np.pad(occupied, 2)
    neighbours = cell_index[:, :, None] + np.arange(3) + 1
    is_occupied = padded[
        neighbours[:, 0, :, None, None],
        neighbours[:, 1, None, :, None],
        neighbours[:, 2, None, None, :],
    ]
    offset_sq = np.stack([rest, np.zeros_like(rest), edge - rest], axis=2) ** 2
    square = (
        offset_sq[:, 0, :, None, None]
        + offset_sq[:, 1, None, :, None]
        + offset_sq[:, 2, None, None, :]
    )
    bound = np.sqrt(square) - reach[:, None, None, None]
    row, i, j, k = np.nonzero(is_occupied & (bound <= cap[:, None, None, None]))
    cell = cell_index[row] + np.stack([i, j, k], axis=1) - 1
    flat = np.ravel_multi_index(tuple(cell.T), occupied.shape)
    yield _build_pairs(state[row], robot[row], CELL, flat, bound[row, i, j, k])


def _obstacle_reach(world: RefereeWorld) -> Floats:
    kind, size = (
        world.environment["obstacles/kind"],
        np.asarray(world.environment["obstacles/size_m"], float),
    )
    box = np.linalg.norm(size, axis=1)
    reach: Floats = np.select(
        [kind == BOX, kind == CAPSULE], [box, size[:, 0] + size[:, 1]], size[:, 0]
    )
    return reach


def _find_robots(world: RefereeWorld, reach: Floats, last: Ints) -> Iterator[ContactPairs]:
    """Yield both directions: each robot with each other robot near it."""
    for robot in range(reach.size):
        others = np.delete(np.arange(reach.size), robot)
        for begin in range(0, int(last[robot]) + 1, _BATCH_SIZE):
            states = slice(begin, min(begin + _BATCH_SIZE, int(last[robot]) + 1))
            bound = np.linalg.norm(
                world.p[states, robot, None] - world.p[states][:, others], axis=2
            )
            bound -= reach[robot] + reach[others]
            row, column = np.nonzero(bound <= SEPARATION_M)
            robots = np.full(row.size, robot, np.int64)
            yield _build_pairs(row + begin, robots, ROBOT, others[column], bound[row, column])


class _NarrowPhase:
    """Narrow phase: distances of hulls, capsule by capsule."""

    def __init__(self, world: RefereeWorld, hulls: tuple[RefereeHull, ...]) -> None:
        self._world = world
        joints = world.joints
        capsules = [
            hull.locate_capsules(None if joints is None else joints[:, robot])
            for robot, hull in enumerate(hulls)
        ]
        # Hulls with fewer capsules repeat the last one; those without arms are the same in all
        # states.
        max_capsules = max(r.size for _, _, r in capsules)
        rows = [np.minimum(np.arange(max_capsules), r.size - 1) for _, _, r in capsules]
        self._states = max(len(a) for a, _, _ in capsules)
        shape = (self._states, max_capsules, 3)
        self._a, self._b = (
            np.stack(
                [
                    np.broadcast_to(hull[end][:, row], shape)
                    for hull, row in zip(capsules, rows, strict=True)
                ],
                axis=1,
            )
            for end in (0, 1)
        )
        self._r = np.stack([r[row] for (_, _, r), row in zip(capsules, rows, strict=True)])

    def reach_m(self, last: Ints) -> Floats:
        """Return the radius [R] of the sphere about each centre that holds the hull.

        Args:
            last: [R] last state that counts; the first one counts always.
        """
        ends = [np.linalg.norm(end, axis=3) for end in (self._a, self._b)]
        reach = np.max(np.maximum(*ends) + self._r, axis=2)
        states = np.arange(self._states)[:, None] <= np.maximum(last, 0)
        largest: Floats = np.max(np.where(states, reach, 0.0), axis=0)
        return largest

    def gaps(self, pairs: ContactPairs) -> ContactPairs:
        """Return the same pairs with their distances; negative where the shapes overlap."""
        gap_functions: tuple[Callable[[ContactPairs], Floats], ...] = (
            self._to_cells,
            self._to_floor,
            self._to_obstacles,
            self._to_robots,
        )
        gap = np.array(pairs.gap_m)
        for kind, gap_function in enumerate(gap_functions):
            rows = np.flatnonzero(pairs.kind == kind)
            for begin in range(0, rows.size, _NARROW_BATCH_SIZE):
                batch = rows[begin : begin + _NARROW_BATCH_SIZE]
                gap[batch] = gap_function(pairs.take(batch))
        return ContactPairs(
            state=pairs.state, robot=pairs.robot, kind=pairs.kind, index=pairs.index, gap_m=gap
        )

    def _capsule_axes(self, state: Ints, robot: Ints) -> tuple[Floats, Floats, Floats]:
        """Return the ends [n, c, 3] of the capsules' axes in the world, and radii [n, c]."""
        p, q = self._world.p[state, robot], self._world.q[state, robot]
        row = np.minimum(state, self._states - 1)
        a, b = (p[:, None] + rotate(q[:, None], x[row, robot]) for x in (self._a, self._b))
        return a, b, self._r[robot]

    def _to_cells(self, pairs: ContactPairs) -> Floats:
        world, edge = self._world, float(self._world.environment["grid/cell_m"])
        a, b, r = self._capsule_axes(pairs.state, pairs.robot)
        cell = np.stack(
            np.unravel_index(pairs.index, world.environment["grid/occupied"].shape), axis=1
        )
        centre = (world.low_m + edge * (cell + 0.5))[:, None]
        return _min_over_capsules(segment_box(a - centre, b - centre, np.full(3, 0.5 * edge)) - r)

    def _to_floor(self, pairs: ContactPairs) -> Floats:
        a, b, r = self._capsule_axes(pairs.state, pairs.robot)
        return _min_over_capsules(
            np.minimum(a[..., 2], b[..., 2]) - r - float(self._world.environment["floor_z_m"])
        )

    def _to_obstacles(self, pairs: ContactPairs) -> Floats:
        world = self._world
        a, b, r = self._capsule_axes(pairs.state, pairs.robot)
        kind = world.environment["obstacles/kind"][pairs.index]
        size = np.asarray(world.environment["obstacles/size_m"], float)[pairs.index][:, None]
        p = world.obstacle_p[pairs.state, pairs.index][:, None]
        q = world.obstacle_q[pairs.state, pairs.index][:, None]
        axis = rotate(q, size[..., 1:2] * np.array([0.0, 0.0, 1.0]))
        gap = np.select(
            [kind[:, None] == SPHERE, kind[:, None] == BOX],
            [
                segment_point(a, b, p) - size[..., 0],
                segment_box(rotate_back(q, a - p), rotate_back(q, b - p), size),
            ],
            segment_segment(a, b, p - axis, p + axis) - size[..., 0],
        )
        return _min_over_capsules(gap - r)

    def _to_robots(self, pairs: ContactPairs) -> Floats:
        a, b, r = self._capsule_axes(pairs.state, pairs.robot)
        c, d, s = self._capsule_axes(pairs.state, pairs.index)
        gap = segment_segment(a[:, :, None], b[:, :, None], c[:, None, :], d[:, None, :]) - (
            r[:, :, None] + s[:, None, :]
        )
        return _min_over_capsules(gap.reshape(len(gap), -1))


def _min_over_capsules(gaps: Floats) -> Floats:
    smallest: Floats = np.min(gaps, axis=1)
    return smallest
